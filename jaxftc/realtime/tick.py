"""One tick for a control loop that is written in Python: NumPy in, NumPy out, and as little between as can be.

A compiled program takes a microsecond for each array that it is given or gives back, and ``step`` has a hundred of them.
Here the gains are part of the program, the state is one array, and so is what comes back.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from jaxftc.compile.xla import ahead
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.schemes import registry
from jaxftc.types import Array, Measurement, Output, Reference

_NAMES = ("reference.q", "reference.qd", "reference.qdd", "measurement.q", "measurement.tau")


class Tick:
    """``init`` and ``step`` for one arm, compiled when made.

    The same numbers as ``jaxftc.step``, the state being one opaque array::

        tick = jaxftc.Tick(config, gains)
        state = tick.init(q)
        state, out = tick.step(state, reference, measurement)

    JAX hands CPU programs to a thread of its own, which costs more than this one takes. A control loop does without:
    ``jax.config.update("jax_cpu_enable_async_dispatch", False)`` before JAX is first used.
    """

    def __init__(self, config: Config, gains: Gains) -> None:
        self.config, self.gains = config, gains
        start = registry.init(config, gains, jnp.zeros(config.n))
        flat, unflatten = ravel_pytree(start)

        def step(flat: Array, signals: Array) -> tuple[Array, Array]:
            state, out = registry.step(config, gains, unflatten(flat), Reference(*signals[:3]), Measurement(*signals[3:]))
            rows = [jnp.broadcast_to(leaf, (config.n,)).astype(flat.dtype) for leaf in out]
            return ravel_pytree(state)[0], jnp.stack(rows)

        self._signals = np.zeros((5, config.n), flat.dtype)
        self._step = ahead(step, flat, self._signals)
        self._shape = flat.shape

    def init(self, q: np.ndarray) -> Array:
        """State [size] at rest in q [n] rad, holding the arm against gravity.

        Raises:
            ValueError: q has the wrong shape or is not finite.
        """
        self._one_arm("q", q)
        return ravel_pytree(registry.init(self.config, self.gains, jnp.asarray(q)))[0]

    def step(self, state: Array, reference: Reference, measurement: Measurement) -> tuple[Array, Output]:
        """One controller tick: the state and what ``jaxftc.step`` says, as NumPy arrays.

        Raises:
            ValueError: a shape is wrong, or the state is not that of this tick.
        """
        signals, shape = self._signals.copy(), self._signals.shape[1:]
        for k, signal in enumerate((*reference, *measurement)):
            if np.shape(signal) != shape:
                self._one_arm(_NAMES[k], signal)
            signals[k] = signal
        if state.shape != self._shape:
            raise ValueError(f"state must come from Tick.init, shape {list(self._shape)}, got {list(state.shape)}")
        state, rows = self._step(state, signals)
        out = Output(*np.asarray(rows))
        return state, out._replace(verdict=out.verdict.astype(np.int32), detected=out.detected[0] > 0)

    def _one_arm(self, name: str, value: Any) -> None:
        if np.shape(value) != (self.config.n,):
            raise ValueError(f"{name} must have shape [{self.config.n}], one arm's joints, got {list(np.shape(value))}")
