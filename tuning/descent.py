"""Gradient descent through the closed loop. The one file that imports optax."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxftc.compile import jit
from jaxftc.faults.scenario import Scenario
from jaxftc.types import Array
from tuning.problem import Problem
from tuning.transform import REACH, Space

OPTIMIZERS: dict[str, Callable[..., optax.GradientTransformation]] = {
    "adam": functools.partial(optax.adam, b2=0.99),
    "lion": optax.lion,
    "sgd": functools.partial(optax.sgd, momentum=0.9, nesterov=True),
}
WARM_UP = 0.05  # of the steps
LAST_RATE = 0.1  # of the learning rate


class State(NamedTuple):
    """What the next step needs."""

    theta: Array  # [size]
    optimizer: optax.OptState
    step: Array  # [] steps done, recoveries included: the schedule goes on after one
    rate: Array  # [] 1, factor on the learning rate; falls with every recovery


class Steps(NamedTuple):
    """A round of steps."""

    terms: Array  # [steps, terms] means over the batch
    gradient_norm: Array  # [steps]


class Descent:
    """Steps of an optax optimiser, a round at a time as one scan.

    Clipping is by scenario (``Problem.slope``), so that no gradient is longer than one scenario's; the learning rate
    warms up and decays as a cosine; theta stays within ``REACH``.
    """

    def __init__(self, problem: Problem, space: Space, *, mode: str, optimizer: str, rate: float, steps: int) -> None:
        warm = max(1, round(WARM_UP * steps))
        schedule = optax.warmup_cosine_decay_schedule(rate / 3, rate, warm, max(steps, warm + 1), LAST_RATE * rate)
        self.optimizer = OPTIMIZERS[optimizer](1.0)  # the rate comes after it: it must outlast a restart
        slope = problem.slope(space, mode)

        def one(key: Array, state: State, x: tuple[Array, Scenario, Array]) -> tuple[State, Steps]:
            terms, slopes = slope(key, state.theta, *x)
            gradient = slopes.mean(1)
            change, inner = self.optimizer.update(gradient, state.optimizer, state.theta)
            rate = state.rate * schedule(state.step)
            theta = jnp.clip(state.theta + rate * change, -REACH, REACH)  # pyright: ignore[reportOperatorIssue]
            return State(theta, inner, state.step + 1, state.rate), Steps(terms.mean(1), optax.global_norm(gradient))

        self._key = problem.key
        origin = None if problem.origin is None else f"{problem.origin} {space.origin} {mode} {optimizer} {rate} {steps}"
        self._round = jit(
            lambda key, state, xs: jax.lax.scan(functools.partial(one, key), state, xs), origin=origin, alone=problem.alone
        )

    def init(self, theta: np.ndarray, step: int = 0, rate: float = 1.0) -> State:
        """Start, or start again, from theta [size]."""
        point = jnp.asarray(theta, float)
        state = State(point, self.optimizer.init(point), jnp.asarray(step), jnp.asarray(rate, point.dtype))
        return jax.tree.map(np.asarray, state)

    def round(self, state: State, widen: np.ndarray, scenarios: Scenario, start: np.ndarray) -> tuple[State, Steps]:
        """``len(widen)`` steps; scenarios [steps, ..., B] and the terms of the starting gains on them [steps, terms, B]."""
        dtype = state.theta.dtype
        done = self._round(self._key, state, (jnp.asarray(widen, dtype), scenarios, jnp.asarray(start, dtype)))
        return jax.tree.map(np.asarray, done)  # off the devices: as it came, so that the next round is the same program
