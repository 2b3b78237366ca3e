"""A folder with an exported tick, and its C code called from Python: to check it, and to time it."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxftc.compile import native
from jaxftc.export.tick import Leaf, Tick


class Native:
    """``ftc_init`` and ``ftc_step`` of a folder, compiled; many arms at once, structures as NumPy's records.

    Raises:
        ValueError: there is no C compiler, or it refuses the code.
    """

    def __init__(self, folder: Path, tick: Tick) -> None:
        self._library = native.library(folder / "ftc_step.c")
        leaves = tick.leaves()
        self.state, self.out = _record(leaves["state"]), _record(leaves["out"])
        self.signals = _record([*_renamed("reference", leaves), *_renamed("measurement", leaves)])
        self.real = np.dtype(np.float64 if tick.real == "double" else np.float32)
        gains = tick.at_run_time
        self._gains = [ctypes.addressof(ctypes.c_char.in_dll(self._library, "ftc_default_gains"))] if gains else []
        for function in (self._library.ftc_init, self._library.ftc_step):
            function.restype, function.argtypes = None, [ctypes.c_void_p] * (len(self._gains) + 2)
        self._library.ftc_step.argtypes = [ctypes.c_void_p] * (len(self._gains) + 3)

    def init(self, q: np.ndarray) -> np.ndarray:
        """States [B] of arms at rest in q [B, n] rad."""
        states, q = np.zeros(len(q), self.state), np.ascontiguousarray(q, self.real)
        for k in range(len(q)):
            self._library.ftc_init(_at(states, k), *self._gains, _at(q, k))
        return states

    def step(self, states: np.ndarray, signals: np.ndarray) -> np.ndarray:
        """What the tick says [B], of records; the states [B] change."""
        out = np.zeros(len(states), self.out)
        for k in range(len(states)):
            self._library.ftc_step(_at(states, k), *self._gains, _at(signals, k), _at(out, k))
        return out


def records(kind: np.dtype, leaves: Sequence[Any]) -> np.ndarray:
    """Leaves [..., B], in JAX's order, as records [B]."""
    arrays = [np.moveaxis(np.asarray(leaf), -1, 0) for leaf in leaves]
    made = np.zeros(len(arrays[0]), kind)
    for name, array in zip(kind.names or (), arrays, strict=True):
        made[name] = array
    return made


def _record(leaves: Sequence[Leaf]) -> np.dtype:
    return np.dtype([(leaf.name, leaf.dtype, leaf.shape) for leaf in leaves], align=True)


def _renamed(signal: str, leaves: dict[str, list[Leaf]]) -> list[Leaf]:
    return [leaf._replace(name=f"{signal}_{leaf.name}") for leaf in leaves[signal]]


def _at(records: np.ndarray, k: int) -> int:
    return records.ctypes.data + k * records.strides[0]
