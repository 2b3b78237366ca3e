"""Gradient descent through the closed loop, by optax."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxftc.compile.jit import jit
from jaxftc.scenarios.scenario import Scenario
from jaxftc.types import Array
from tuning.problem import Problem, shared
from tuning.settings import Optimizer
from tuning.transform import REACH, Free, Space

OPTIMIZERS: dict[str, Callable[..., optax.GradientTransformation]] = {
    "adam": functools.partial(optax.adam, b2=0.99),
    "lion": optax.lion,
    "sgd": functools.partial(optax.sgd, momentum=0.9, nesterov=True),
}
WARM_UP = 0.05  # of the steps
LAST_RATE = 0.1  # of the learning rate


class State(NamedTuple):
    """What the next step needs."""

    theta: Array  # [layout.size] of the space; entries behind the space's size stay 0
    optimizer: optax.OptState
    step: Array  # [] steps done, recoveries included: the schedule goes on after one
    rate: Array  # [] 1, factor on the learning rate; falls with every recovery


class Steps(NamedTuple):
    """A round of steps."""

    terms: Array  # [steps, terms] means over the batch
    gradient_norm: Array  # [steps]


def behaviour(optimizer: Optimizer, steps: int) -> str:
    """What a checkpoint knows an optimiser by: its name, or what a user's own makes of a fixed series of gradients.

    The code of a transformation cannot be compared; what it does can, rates and schedules included.
    """
    if isinstance(optimizer, str):
        return optimizer
    point = jnp.asarray([0.5, -1.0, 0.0], float)
    gradients = jnp.sin(jnp.arange(3.0 * steps).reshape(steps, 3)).astype(point.dtype)

    def step(carry: Any, gradient: Array) -> tuple[Any, Array]:
        at, state = carry
        change, state = optimizer.update(gradient, state, at)
        return (optax.apply_updates(at, change), state), change

    _, changes = jax.lax.scan(step, (point, optimizer.init(point)), gradients)
    return f"own {hashlib.sha256(np.ascontiguousarray(changes).tobytes()).hexdigest()[:16]}"


class Descent:
    """Steps of an optax optimiser, a round at a time as one scan.

    Clipping is by scenario (``Problem.slope``), so that no gradient is longer than one scenario's; the learning rate
    warms up and decays as a cosine; theta stays within ``REACH``.
    """

    def __init__(self, problem: Problem, space: Space, *, mode: str, optimizer: Optimizer, rate: float, steps: int) -> None:
        warm = max(1, round(WARM_UP * steps))
        self._schedule = optax.warmup_cosine_decay_schedule(rate / 3, rate, warm, max(steps, warm + 1), LAST_RATE * rate)
        # The rate comes after it: it must outlast a restart.
        self.optimizer = OPTIMIZERS[optimizer](1.0) if isinstance(optimizer, str) else optimizer
        slope = problem.slope_of(space.layout, mode, space.size)

        def gradient_steps(key: Array, free: Free, state: State, xs: Any) -> tuple[State, Steps]:
            """A step for each of ``xs``: rates, widths, scenarios [..., B] and start [terms, B], with a leading axis."""

            def one(state: State, x: tuple[Array, Array, Scenario, Array]) -> tuple[State, Steps]:
                rate, *rest = x
                terms, slopes = slope(key, free, state.theta, *rest)
                gradient = slopes.mean(1)
                change, inner = self.optimizer.update(gradient, state.optimizer, state.theta)
                theta = jnp.clip(state.theta + state.rate * rate * change, -REACH, REACH)  # pyright: ignore[reportOperatorIssue]
                return State(theta, inner, state.step + 1, state.rate), Steps(terms.mean(1), optax.global_norm(gradient))

            return jax.lax.scan(one, state, xs)

        self._key, self._space = problem.key, space
        known = problem.cached_as is not None and isinstance(optimizer, str)
        name = None if not known else f"{problem.cached_as} {mode} {optimizer} {space.layout.leaves}"
        like: Any = self.init(np.zeros(space.size)), Steps(0, 0)  # pyright: ignore[reportArgumentType]
        kind = "steps", *problem.kind, len(space.layout.leaves), mode, optimizer, mode == "reverse" or space.size
        self._round = shared(
            kind,
            lambda: jit(
                gradient_steps,
                kind=problem.program_kind,
                cached_as=name if mode == "reverse" else None,
                like=like,
                sharding=problem.sharding,
            ),
        )

    def init(self, theta: np.ndarray, step: int = 0, rate: float = 1.0) -> State:
        """Start, or start again, from theta [size]."""
        point = self._space.padded(jnp.asarray(theta, float))
        state = State(point, self.optimizer.init(point), jnp.asarray(step), jnp.asarray(rate, point.dtype))
        return jax.tree.map(np.asarray, state)

    def round(self, state: State, widen: np.ndarray, scenarios: Scenario, start: np.ndarray) -> tuple[State, Steps]:
        """``len(widen)`` steps; scenarios [steps, ..., B] and the terms of the starting gains on them [steps, terms, B]."""
        dtype, step = state.theta.dtype, int(state.step)
        rates = np.array([self._schedule(step + k) for k in range(len(widen))])
        xs = (jnp.asarray(rates, dtype), jnp.asarray(widen, dtype), scenarios, jnp.asarray(start, dtype))
        done = self._round(self._key, self._space.free, state, xs)
        return jax.tree.map(np.asarray, done)  # off the devices: as it came, so that the next round is the same program
