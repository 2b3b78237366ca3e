"""Figures of a run: how late it was, how long a tick took, why it ended. Fixed in size however long it ran."""

from __future__ import annotations

import dataclasses
import math

from jaxftc.realtime.trips import Trip

BINS, RESOLUTION = 10_000, 1000  # bins of a histogram, and how many of them make a period


class Spread:
    """A histogram of times: bins of a thousandth of a period, up to ten periods, and the largest exactly."""

    def __init__(self, dt: float) -> None:
        self._width = dt / RESOLUTION
        self._counts = [0] * (BINS + 1)
        self.count, self.largest = 0, 0.0

    def add(self, seconds: float) -> None:
        """One more."""
        self._counts[min(max(int(seconds / self._width), 0), BINS)] += 1
        self.count += 1
        if seconds > self.largest:
            self.largest = seconds

    def quantile(self, share: float) -> float:
        """Seconds, the upper edge of the bin that this share of the times does not exceed."""
        wanted, seen = math.ceil(share * self.count), 0
        for k, count in enumerate(self._counts):
            seen += count
            if seen >= wanted and seen:
                return min((k + 1) * self._width, self.largest) if k < BINS else self.largest
        return math.nan


@dataclasses.dataclass
class Summary:
    """What a run was like; printing it gives the figures as text.

    Attributes:
        dt: s, sample time.
        ended: Why it stopped.
        duration: s, from the first tick to the last, the stop included.
        ticks: Ticks that were run with a reading asked for.
        late: Ticks whose command came after their deadline, or was refused by the robot.
        skipped: Ticks that were passed over, since their time had gone by.
        unread: Ticks in which a joint had no finite reading.
        lost: Events that could not be written.
        start: s, how late ticks began.
        work: s, from the reading to the command.
    """

    dt: float
    ended: Trip | None = None
    duration: float = 0.0
    ticks: int = 0
    late: int = 0
    skipped: int = 0
    unread: int = 0
    lost: int = 0
    start: Spread = dataclasses.field(init=False, repr=False)
    work: Spread = dataclasses.field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.start, self.work = Spread(self.dt), Spread(self.dt)

    @property
    def missed(self) -> int:
        """Deadlines missed: late ticks and those passed over."""
        return self.late + self.skipped

    def __str__(self) -> str:
        """A few lines."""
        total = max(self.ticks + self.skipped, 1)
        rows = [f"ended by {self.ended.cause}: {self.ended.text}" if self.ended else "not ended"]
        rows.append(f"{self.duration:.3f} s, {self.ticks} ticks of {self.dt * 1e3:g} ms")
        share = f"{100 * self.missed / total:.3g} %"
        rows.append(f"deadlines missed: {self.missed} ({share}), {self.late} late and {self.skipped} passed over")
        rows.append(f"ticks without a reading: {self.unread}")
        for name, spread in (("late start", self.start), ("reading to command", self.work)):
            figures = (spread.quantile(0.5), spread.quantile(0.99), spread.quantile(0.999), spread.largest)
            p50, p99, p999, most = (f"{1e6 * x:.0f}" for x in figures)
            rows.append(f"{name}, us: p50 {p50}, p99 {p99}, p99.9 {p999}, most {most}")
        if self.lost:
            rows.append(f"events that could not be written: {self.lost}")
        return "\n".join(rows)
