"""Time and waiting, apart from all else, so that a loop runs in tests without either."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """What a loop asks of time."""

    def now(self) -> float:
        """Seconds from any moment on; it never goes back."""
        ...

    def wait_until(self, moment: float) -> None:
        """Return at ``moment`` s, at once if that is past."""
        ...


class SystemClock:
    """The computer's monotonic clock: it sleeps for most of a wait and polls at its end, as a sleep ends late."""

    def __init__(self, poll: float = 2e-4) -> None:
        self.poll = poll  # s before the moment at which it wakes

    def now(self) -> float:
        """Seconds; setting the computer's date does not change it."""
        return time.perf_counter()

    def wait_until(self, moment: float) -> None:
        """Sleep, then poll."""
        pause = moment - time.perf_counter() - self.poll
        if pause > 0:
            time.sleep(pause)
        while time.perf_counter() < moment:
            pass


class SimulatedClock:
    """A clock that stands still until it is waited for or advanced: for tests of a loop and of a driver."""

    def __init__(self) -> None:
        self.time = 0.0  # s

    def now(self) -> float:
        """Seconds since it was made."""
        return self.time

    def wait_until(self, moment: float) -> None:
        """It is ``moment`` now, unless it was later."""
        self.time = max(self.time, moment)

    def advance(self, seconds: float) -> None:
        """Let time go by, as a slow driver would."""
        self.time += seconds
