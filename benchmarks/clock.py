"""How things are timed: in turns, warm, the least of several; compilation apart."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple


class Timing(NamedTuple):
    """One side of a race."""

    best: float  # s, the least of the warm calls
    first: float  # s, the first call, compilation included
    result: Any  # of the last timed call: what is checked is what was timed


def race(sides: dict[str, Callable[[], Any]], rounds: int, done: Callable[[], object] = lambda: None) -> dict[str, Timing]:
    """Call every side once to warm up, then all in turn for some rounds, so that a slow spell of the machine hits all."""
    first, best, result = {}, dict.fromkeys(sides, float("inf")), {}
    for name, side in sides.items():
        first[name], result[name] = timed(side)
        done()
    for _ in range(rounds):
        for name, side in sides.items():
            result[name] = None  # freed before the next is made
            seconds, result[name] = timed(side)
            best[name] = min(best[name], seconds)
            done()
    return {name: Timing(best[name], first[name], result[name]) for name in sides}


def timed(call: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds that a call takes, and its result."""
    began = time.perf_counter()
    result = call()
    return time.perf_counter() - began, result
