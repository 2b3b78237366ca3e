"""What the diagnosis says of a recorded log: all at once, or piece by piece for recordings of any length."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.compile.jit import jit
from jaxftc.config import Config
from jaxftc.gains import Gains, align, specs
from jaxftc.logs.log import Log
from jaxftc.schemes import diagnoser
from jaxftc.schemes.diagnoser import Diagnoser, Diagnosis, Measurement

CHUNK = 4096  # ticks of one call of the compiled program: every recording runs on the same one


def diagnose(config: Config, gains: Gains, log: Log) -> Diagnosis:
    """What the diagnosis says of a log, [T, n, ...]; it starts anew in each of the log's segments.

    Args:
        config: Robot and sample time, the log's.
        gains: May have one scenario axis.
        log: With torques, or without: then readings alone are judged.

    Returns:
        The diagnosis of every tick.

    Raises:
        ValueError: a gain is not allowed, the observer is unstable, the log is of another arm or sample time, or its torques
            are not in N m.
    """
    parts = [said for _, said in Stream(config, gains).feed(log)]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


class Stream:
    """A diagnosis that goes on from piece to piece of a recording.

    Raises:
        ValueError: a gain is not allowed, or the observer is unstable.
    """

    def __init__(self, config: Config, gains: Gains) -> None:
        Diagnoser(config, gains)  # refuses what cannot be used
        leaves, ranks = jax.tree.leaves(gains), [len(spec.axes) for _, _, spec in specs(gains)]
        self.swept = np.broadcast_shapes(*(leaf.shape[rank:] for leaf, rank in zip(leaves, ranks, strict=True)))
        self.config, self.gains, self.dtype = config, align(gains, len(self.swept)), gains.arx.xi_a.dtype
        self.state: Any = None

    def feed(self, log: Log, *, goes_on: bool = False) -> Iterator[tuple[int, Diagnosis]]:
        """Diagnosis of at most CHUNK ticks at a time, and the tick of the log that it begins at.

        ``goes_on`` says that the log follows the last one without a gap.

        Raises:
            ValueError: the log is of another arm or sample time, or its torques are not in N m.
        """
        n, dt = self.config.n, self.config.dt
        if log.unit != "N m":
            raise ValueError(
                f"the log has torques in {log.unit}, and the N m for one are not known; give the arm.toml that identify "
                "wrote of such logs, or torque_per_ampere"
            )
        q, tau = np.asarray(log.q), np.asarray(log.tau)
        jitter = np.zeros(len(q)) if log.jitter is None else log.jitter
        for name, value in (("q", q), ("tau", tau)):
            if value.ndim != 2 or value.shape != (len(q), n):
                raise ValueError(f"log.{name} must be [T, {n}], ticks first, got shape {value.shape}")
        if log.dt is not None and abs(log.dt - dt) > 1e-6 * dt:
            raise ValueError(f"the log is at {log.dt:g} s, the config at {dt:g} s; give the log's: Config(robot, dt=log.dt)")
        for k, (start, stop) in enumerate(log.stretches):
            if k or not goes_on:
                self.state = None
            for first in range(start, stop, CHUNK):
                last = min(first + CHUNK, stop)
                yield first, self._advance(q[first:last], tau[first:last], jitter[first:last, None])

    def _advance(self, *rows: np.ndarray) -> Diagnosis:
        """Diagnosis of angles [T, n], torques [T, n] and jitter [T, 1]."""
        q = rows[0]
        signals = [np.full((CHUNK, part.shape[1]), np.nan, self.dtype) for part in rows]
        for signal, part in zip(signals, rows, strict=True):
            signal[: len(q)] = part
        if self.state is None:
            at = np.where(np.isfinite(signals[0][0]), signals[0][0], 0.0).astype(self.dtype)
            at = np.broadcast_to(at.reshape(-1, *[1] * len(self.swept)), (self.config.n, *self.swept))
            self.state = _init(self.config, self.gains, at)
        self.state, said = _run(self.config, self.gains, self.state, np.int32(len(q)), *signals)
        return jax.tree.map(lambda leaf: np.asarray(leaf[: len(q)]), said)


def _scan(config: Config, gains: Gains, state: Any, count: Any, *rows: Any) -> tuple[Any, Diagnosis]:
    """The first ``count`` of the rows; the state stays what it is in the others, which fill the program up."""

    def body(state: Any, row: Any) -> tuple[Any, Diagnosis]:
        k, *signals = row
        signals = [
            jnp.broadcast_to(x.reshape(-1, *[1] * (state.q.ndim - 1)), state.q.shape) for x in signals
        ]  # joints first
        after, said = diagnoser.step(config, gains, state, Measurement(*signals))
        return jax.tree.map(lambda new, old: jnp.where(k < count, new, old), after, state), said

    return jax.lax.scan(body, state, (jnp.arange(len(rows[0])), *rows))


_run = jit(_scan, static_argnums=0)
_init = jit(diagnoser.init, static_argnums=0)
