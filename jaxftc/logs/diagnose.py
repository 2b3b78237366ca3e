"""What the diagnosis says of a recorded log: all at once, or stretch by stretch for recordings of any length."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.compile.xla import jit
from jaxftc.config import Config
from jaxftc.gains import Gains, align
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

    Raises:
        ValueError: a gain is not allowed, the observer is unstable, or the log is of another arm or sample time.
    """
    parts = [said for _, said in stretches(config, gains, log)]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


def stretches(config: Config, gains: Gains, log: Log, state: Any = None) -> Iterator[tuple[int, Diagnosis]]:
    """Diagnosis of at most CHUNK ticks at a time, and the tick that it begins at.

    Raises:
        ValueError: as ``diagnose``.
    """
    Diagnoser(config, gains)  # refuses what cannot be used
    q, tau = np.asarray(log.q), np.asarray(log.tau)
    for name, value in (("q", q), ("tau", tau)):
        if value.ndim != 2 or value.shape != (len(q), config.n):
            raise ValueError(f"log.{name} must be [T, {config.n}], ticks first, got shape {value.shape}")
    if log.dt is not None and abs(log.dt - config.dt) > 1e-6 * config.dt:
        raise ValueError(f"the log is at {log.dt:g} s and the config at {config.dt:g} s; give the log's: Config(robot, dt=...)")
    axes = max(leaf.ndim - rank for leaf, rank in zip(jax.tree.leaves(gains), _ranks(), strict=True))
    gains, dtype = align(gains, axes), gains.arx.xi_a.dtype
    swept = np.broadcast_shapes(*(leaf.shape[rank:] for leaf, rank in zip(jax.tree.leaves(gains), _ranks(), strict=True)))
    for start, stop in log.stretches:
        state = None
        for first in range(start, stop, CHUNK):
            last = min(first + CHUNK, stop)
            signals = [np.full((CHUNK, config.n), np.nan, dtype) for _ in range(2)]
            for signal, whole in zip(signals, (q, tau), strict=True):
                signal[: last - first] = whole[first:last]
            if state is None:
                at = np.where(np.isfinite(signals[0][0]), signals[0][0], 0.0)
                state = _init(config, gains, np.broadcast_to(at.reshape(-1, *[1] * len(swept)), (config.n, *swept)))
            state, said = _run(config, gains, state, *signals)
            yield first, jax.tree.map(lambda leaf: np.asarray(leaf[: last - first]), said)  # noqa: B023


def _ranks() -> list[int]:
    from jaxftc.gains import specs

    return [len(spec.axes) for _, _, spec in specs()]


def _scan(config: Config, gains: Gains, state: Any, q: Any, tau: Any) -> tuple[Any, Diagnosis]:
    def body(state: Any, row: Any) -> tuple[Any, Diagnosis]:
        row = [jnp.broadcast_to(x.reshape(-1, *[1] * (state.q.ndim - 1)), state.q.shape) for x in row]
        return diagnoser.step(config, gains, state, Measurement(*row))

    return jax.lax.scan(body, state, (q, tau))


_run = jit(_scan, static_argnums=0)
_init = jit(diagnoser.init, static_argnums=0)
