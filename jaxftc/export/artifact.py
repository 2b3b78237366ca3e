"""What a folder holds, called from Python for many arms at once: to hold it against ``jaxftc.step``, and to time it.

Each artifact has ``init(q)`` and ``step(state, signals)``, lists of leaves [B, ...] as ``Tick.leaves`` names them.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import jax
import numpy as np

from jaxftc.compile import native
from jaxftc.export.stablehlo import load
from jaxftc.export.tick import DTYPES, Leaf, Real, Tick, precision

Leaves = list[np.ndarray]


class Artifact(Protocol):
    """An exported tick."""

    def init(self, q: np.ndarray) -> Leaves:
        """States of arms at rest in q [B, n] rad."""
        ...

    def step(self, state: Sequence[Any], signals: Sequence[Any]) -> tuple[Leaves, Leaves]:
        """Next states, and what the tick says."""
        ...


class Native:
    """``ftc_init`` and ``ftc_step`` of a folder, compiled here; a structure is a record of NumPy's.

    Raises:
        ValueError: there is no C compiler, or it refuses the code.
    """

    def __init__(self, folder: Path, tick: Tick) -> None:
        self._library = native.library(folder / "ftc_step.c")
        leaves = tick.leaves()
        self._state, self._out = _record(leaves["state"]), _record(leaves["out"])
        self._signals = _record(
            [
                leaf._replace(name=f"{signal}_{leaf.name}")
                for signal in ("reference", "measurement")
                for leaf in leaves[signal]
            ]
        )
        self._real = DTYPES[tick.real]
        found = [ctypes.c_char.in_dll(self._library, "ftc_default_gains")] if tick.at_run_time else []
        self._gains = [ctypes.addressof(symbol) for symbol in found]
        for function, pointers in ((self._library.ftc_init, 2), (self._library.ftc_step, 3)):
            function.restype, function.argtypes = None, [ctypes.c_void_p] * (len(self._gains) + pointers)

    def init(self, q: np.ndarray) -> Leaves:
        """States of arms at rest in q [B, n] rad."""
        states, q = np.zeros(len(q), self._state), np.ascontiguousarray(q, self._real)
        for k in range(len(q)):
            self._library.ftc_init(_at(states, k), *self._gains, _at(q, k))
        return _leaves(states)

    def step(self, state: Sequence[Any], signals: Sequence[Any]) -> tuple[Leaves, Leaves]:
        """Next states, and what the tick says."""
        states, told = _records(self._state, state), _records(self._signals, signals)
        out = np.zeros(len(states), self._out)
        for k in range(len(states)):
            self._library.ftc_step(_at(states, k), *self._gains, _at(told, k), _at(out, k))
        return _leaves(states), _leaves(out)


class StableHLO:
    """The StableHLO functions of a folder, by JAX, arm after arm."""

    def __init__(self, folder: Path, tick: Tick) -> None:
        loaded = load(folder)
        self._real: Real = tick.real
        self._states = len(tick.leaves()["state"])
        self._init = jax.jit(lambda q: jax.lax.map(lambda q: loaded.call_init(*loaded.gains, q), q))
        self._step = jax.jit(lambda args: jax.lax.map(lambda args: loaded.call_step(*loaded.gains, *args), args))

    def init(self, q: np.ndarray) -> Leaves:
        """States of arms at rest in q [B, n] rad."""
        with precision(self._real):
            return [np.asarray(leaf) for leaf in self._init(np.asarray(q, DTYPES[self._real]))]

    def step(self, state: Sequence[Any], signals: Sequence[Any]) -> tuple[Leaves, Leaves]:
        """Next states, and what the tick says."""
        with precision(self._real):
            made = [np.asarray(leaf) for leaf in self._step([*state, *signals])]
        return made[: self._states], made[self._states :]


def _record(leaves: Sequence[Leaf]) -> np.dtype:
    return np.dtype([(leaf.name, leaf.dtype, leaf.shape) for leaf in leaves], align=True)  # as C lays a struct out


def _records(kind: np.dtype, leaves: Sequence[Any]) -> np.ndarray:
    made = np.zeros(len(leaves[0]), kind)
    for name, leaf in zip(kind.names or (), leaves, strict=True):
        made[name] = leaf
    return made


def _leaves(records: np.ndarray) -> Leaves:
    return [records[name] for name in records.dtype.names or ()]


def _at(records: np.ndarray, k: int) -> int:
    return records.ctypes.data + k * records.strides[0]
