"""One tick for a control loop that is written in Python: NumPy in, NumPy out, and as little between as can be.

A compiled program takes a microsecond for each array that it is given or gives back, and ``step`` has a hundred of them.
Here the gains are part of the program, the state is one array, and so is what comes back.
"""

from __future__ import annotations

import os
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from jaxftc import checks
from jaxftc.compile import native
from jaxftc.compile.jit import ahead
from jaxftc.config import Config
from jaxftc.gains import Gains, check
from jaxftc.schemes import registry
from jaxftc.types import Array, Measurement, Output, Reference

_PROCESS = os.getpid()
_NAMES = ("reference.q", "reference.qd", "reference.qdd", "measurement.q", "measurement.tau")
_TAU = 4  # place of the one signal that may be None
_VERDICT, _DETECTED = (Output._fields.index(name) for name in ("verdict", "detected"))


class Tick:
    """``init`` and ``step`` for one arm, compiled when made.

    The same numbers as ``jaxftc.step``, the state being one opaque array::

        tick = jaxftc.Tick(config, gains)
        state = tick.init(q)
        state, out = tick.step(state, reference, measurement)

    JAX hands CPU programs to a thread of its own, which costs more than this one takes. A control loop does without:
    ``jax.config.update("jax_cpu_enable_async_dispatch", False)`` before JAX is first used. Where there is a C compiler,
    ``backend="c"`` does without JAX too: the tick is C code then, several times as fast, and the state a NumPy array.

    JAX does not survive a fork: start other processes with ``multiprocessing.get_context("spawn")``, and make a ``Tick`` in
    each.

    Args:
        config: Robot, scheme and sample time.
        gains: Constants of the program.
        backend: ``xla``, or ``c`` for the code that ``jaxftc export`` writes.

    Raises:
        ValueError: an argument is of another kind, a gain is not allowed, or no C compiler for ``backend="c"``.
        RuntimeError: this process was forked.
    """

    def __init__(self, config: Config, gains: Gains, *, backend: Literal["xla", "c"] = "xla") -> None:
        _not_forked()
        checks.one_of("backend", backend, ("xla", "c"))
        check(config, gains)
        self.config, self.gains = config, gains
        start = registry.init(config, gains, jnp.zeros(config.n))
        flat, unflatten = ravel_pytree(start)

        def step(flat: Array, signals: Array) -> tuple[Array, Array]:
            state, out = registry.step(config, gains, unflatten(flat), Reference(*signals[:3]), Measurement(*signals[3:]))
            rows = [jnp.broadcast_to(leaf, (config.n,)).astype(flat.dtype) for leaf in out]
            return ravel_pytree(state)[0], jnp.stack(rows)

        self._signals = np.zeros((5, config.n), flat.dtype)
        self._step = {"xla": ahead, "c": native.function}[backend](step, flat, self._signals)
        self._shape = flat.shape
        self._array = jnp.asarray if backend == "xla" else np.asarray

    def init(self, q: np.ndarray) -> Any:
        """State [size] at rest in q [n] rad, holding the arm against gravity.

        Raises:
            ValueError: q has the wrong shape or is not finite.
        """
        _not_forked()
        q = checks.filled(q)
        checks.one_arm("q", q, self.config.n)
        return self._array(ravel_pytree(registry.init(self.config, self.gains, jnp.asarray(q)))[0])

    def step(self, state: Any, reference: Reference, measurement: Measurement) -> tuple[Any, Output]:
        """One controller tick: the state and what ``jaxftc.step`` says, as NumPy arrays.

        Raises:
            ValueError: an argument is of another kind, a shape is wrong, or the state is not that of this tick.
            RuntimeError: this process was forked.
        """
        _not_forked()
        checks.instance("reference", reference, Reference)
        checks.instance("measurement", measurement, Measurement)
        signals, shape = self._signals.copy(), self._signals.shape[1:]
        for k, signal in enumerate((*reference, *measurement)):
            if signal is None and k == _TAU:
                signals[k] = np.nan
                continue
            if np.shape(signal) != shape:
                checks.one_arm(_NAMES[k], signal, self.config.n)
            signals[k] = checks.filled(signal)
        if getattr(state, "shape", None) != self._shape:
            came = list(np.shape(state)) if isinstance(state, jax.Array | np.ndarray) else f"a {type(state).__name__}"
            raise ValueError(f"state must come from Tick.init, shape {list(self._shape)}, got {came}")
        state, rows = self._step(state, signals)
        out = list(np.asarray(rows))
        out[_VERDICT], out[_DETECTED] = out[_VERDICT].astype(np.int32), out[_DETECTED][0] > 0
        return state, Output(*out)


def _not_forked() -> None:
    """Refuse a forked child at once: JAX's threads did not come along, and the first program that runs would hang."""
    if os.getpid() != _PROCESS:
        raise RuntimeError(
            'this process was forked, and JAX does not survive that; start it with multiprocessing.get_context("spawn") '
            "and make the Tick there"
        )
