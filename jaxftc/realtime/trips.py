"""What takes a loop to its stop: limits, and the counters that are held against them."""

from __future__ import annotations

import dataclasses
import math
import numbers
from collections import deque
from typing import NamedTuple

import numpy as np

from jaxftc import checks
from jaxftc.config import Config
from jaxftc.realtime.reaction import State as Reacted
from jaxftc.types import Verdict

AT_LIMIT = 1 - 1e-6  # of the torque limit: the command is rounded
MAY_TRIP = (Verdict.ACTUATOR, Verdict.SENSOR, Verdict.BOTH, Verdict.CONTACT)
ENOUGH = 1 - 1e-9  # of a time: times add up with rounding


class Trip(NamedTuple):
    """Why a loop stops."""

    cause: str  # deadlines, data, torque, verdict, error, asked or end
    text: str


@dataclasses.dataclass(frozen=True)
class Trips:
    """Limits of what a loop puts up with; infinite ones are off. A torque that is not finite always trips.

    Attributes:
        missed: 1, deadlines missed within ``window``. A command that the robot refuses counts as one.
        window: s.
        no_reading: s, that a joint may be without a finite reading.
        saturated: s, that a joint's torque may be at its limit without a break.
        verdicts: Confirmed verdicts that trip, such as ``(Verdict.SENSOR, Verdict.BOTH)``.

    Raises:
        ValueError: a value is not allowed; the message says which are.
    """

    missed: float = 20
    window: float = 1.0
    no_reading: float = 0.05
    saturated: float = 0.5
    verdicts: tuple[Verdict, ...] = ()

    def __post_init__(self) -> None:
        if self.missed != math.inf:
            checks.integer("trips.missed", self.missed, 1, "math.inf never trips", high=1_000_000)
        checks.positive("trips.window", self.window, "seconds")
        for name in ("no_reading", "saturated"):
            checks.span(f"trips.{name}", getattr(self, name))
        wrong = [v for v in self.verdicts if not (isinstance(v, numbers.Integral) and v in MAY_TRIP)]
        if wrong:
            raise ValueError(f"trips.verdicts must be of Verdict.ACTUATOR, SENSOR, BOTH and CONTACT, got {wrong[0]!r}")


class Watch:
    """Counters of one run. Every method takes what has happened and says whether that trips."""

    def __init__(self, trips: Trips, config: Config) -> None:
        self._trips, self._robot = trips, config.robot
        self._limit = AT_LIMIT * np.asarray(config.robot.torque_limit)
        self._missed: deque[float] = deque(maxlen=None if math.isinf(trips.missed) else int(trips.missed))
        self._no_reading, self._most = (max(x, 0.5 * config.dt) for x in (trips.no_reading, trips.saturated))
        self._unread, self._saturated = np.zeros(config.n), np.zeros(config.n)

    def deadlines(self, t: float, count: int) -> Trip | None:
        """``count`` of them were missed by t s."""
        if self._missed.maxlen is None:
            return None
        self._missed.extend([t] * min(count, self._missed.maxlen))
        full = len(self._missed) == self._missed.maxlen
        if not full or t - self._missed[0] > self._trips.window:
            return None
        return Trip("deadlines", f"{self._missed.maxlen} deadlines missed within {self._trips.window:g} s")

    def reading(self, missing: np.ndarray, elapsed: float) -> Trip | None:
        """Joints [n] bool without a finite reading for another ``elapsed`` s."""
        self._unread = np.where(missing, self._unread + elapsed, 0.0)
        if not (self._unread >= ENOUGH * self._no_reading).any():
            return None
        return Trip("data", f"no finite reading of {self._longest(self._unread)}")

    def command(self, tau: np.ndarray, elapsed: float) -> Trip | None:
        """The controller's torque [n] N m for another ``elapsed`` s."""
        if not np.isfinite(tau).all():
            return Trip("data", f"the controller's torque is not finite: {tau.tolist()}")
        self._saturated = np.where(np.abs(tau) >= self._limit, self._saturated + elapsed, 0.0)
        if not (self._saturated >= ENOUGH * self._most).any():
            return None
        return Trip("torque", f"the torque limit was reached by {self._longest(self._saturated)}")

    def verdicts(self, reacted: Reacted) -> Trip | None:
        """What the reaction has confirmed."""
        if not (self._trips.verdicts and reacted.verdict.any()):
            return None
        hit = np.flatnonzero(np.isin(reacted.verdict, self._trips.verdicts))
        if not len(hit):
            return None
        verdict, names = Verdict(reacted.verdict[hit[0]]), self._robot.joint_names
        if verdict == Verdict.CONTACT:
            link = np.flatnonzero(reacted.verdict == Verdict.CONTACT)[-1]
            return Trip("verdict", f"contact on the link of {names[link]}")
        return Trip("verdict", f"{verdict.label} fault of {names[hit[0]]}")

    def _longest(self, times: np.ndarray) -> str:
        j = int(times.argmax())
        return f"{self._robot.joint_names[j]} for {times[j]:.3g} s"
