"""Which commands came in time, and which torque was in effect meanwhile."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxftc.realtime.events import Events
from jaxftc.realtime.summary import Summary


class Deadlines:
    """Of one run. A tick that was skipped has missed its deadline, and so has a command that is late or refused.

    Misses one after another are a streak, which is one event when it ends.
    """

    def __init__(self, n: int, summary: Summary, events: Events) -> None:
        self._dt, self._summary, self._events = summary.dt, summary, events
        self.streak = 0  # deadlines missed one after another
        self._worst = 0.0  # s, by which the latest command among them was late
        nan = np.full(n, np.nan)
        self._held: tuple[Any, Any, int] = (nan, nan, 0)  # torque before, torque now, tick from which on that is held

    def in_effect(self, k: int) -> Any:
        """Torque [n] N m that was held in the period before tick k; nan before the first command."""
        before, now, since = self._held
        return now if since < k else before

    def took(self, tau: np.ndarray, k: int, late: float) -> None:
        """The robot took the command [n] N m of tick k, ``late`` s behind it; in time it counts for the whole period."""
        self._held = (self._held[1], tau, k + max(0, round(late / self._dt)) if late > self._dt else k)

    def command(self, k: int, late: float, *, taken: bool) -> int:
        """Note a command by how late it was, s; how many deadlines that missed."""
        if taken and late <= self._dt:
            self.end_streak(k + 1)
            return 0
        self._summary.late += 1
        self._worst = max(self._worst, late - self._dt)
        self.streak += 1
        return 1

    def skipped(self, count: int) -> int:
        """Note ticks that were skipped; how many deadlines that missed."""
        self._summary.skipped += count
        self.streak += count
        return count

    def end_streak(self, k: int) -> None:
        """The misses in a row, if there were any, end before tick k."""
        if self.streak:
            self._events.add(k * self._dt, "deadlines", missed=self.streak, latest_s=round(self._worst, 6))
            self.streak, self._worst = 0, 0.0
