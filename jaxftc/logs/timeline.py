"""From verdicts, tick by tick, to events: one a fault, in memory that does not grow with the recording."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from jaxftc.schemes.diagnoser import Diagnosis
from jaxftc.types import Verdict

GAP = 0.5  # s; a shorter pause of a joint's alarm is part of its event
GLITCH = 0.1  # s; a shorter alarm is no event
SHARE = 0.5  # of an event's alarm in which a kind must be named to be part of it
UNITS = ("N m", "deg")


class Event(NamedTuple):
    """One fault, as it was seen."""

    start_s: float  # s from the recording's first row
    end_s: float  # s
    joint: int  # from 1
    joint_name: str
    kind: str  # actuator, sensor or both
    size: float  # mean torque in N m, or largest error of the reading in deg; of both kinds the torque
    unit: str


class _Open:
    """An alarm of one joint that has not ended yet."""

    def __init__(self, start: int) -> None:
        self.start = self.end = start
        self.up = self.actuator = self.sensor = 0  # ticks
        self.torque = self.angle = 0.0  # sum over the actuator's ticks; largest

    def add(self, at: np.ndarray, verdict: np.ndarray, torque: np.ndarray, angle: np.ndarray) -> None:
        """Ticks of alarm, in order."""
        self.end = int(at[-1]) + 1
        actuator, sensor = (verdict & int(kind) > 0 for kind in (Verdict.ACTUATOR, Verdict.SENSOR))
        self.up += len(at)
        self.actuator, self.sensor = self.actuator + int(actuator.sum()), self.sensor + int(sensor.sum())
        self.torque += float(torque[actuator].sum())
        if sensor.any():
            largest = float(angle[sensor][np.abs(angle[sensor]).argmax()])
            self.angle = max(self.angle, largest, key=abs)

    def event(self, dt: float, times: tuple[float, float], joint: int, name: str) -> Event:
        """What is said of it."""
        least = SHARE * self.up
        kind = Verdict(int(self.actuator >= least) * Verdict.ACTUATOR + int(self.sensor >= least) * Verdict.SENSOR)
        torque = self.torque / max(self.actuator, 1)
        size = np.rad2deg(self.angle) if kind == Verdict.SENSOR else torque
        return Event(*times, joint + 1, name, kind.label, float(size), UNITS[kind == Verdict.SENSOR])


class Timeline:
    """Events of a recording, from its stretches of diagnosis in order."""

    def __init__(self, joints: tuple[str, ...], dt: float) -> None:
        self.joints, self.dt = joints, dt
        self.ticks = self.alarmed = self.glitches = 0
        self.events: list[Event] = []
        self._open: dict[int, _Open] = {}

    def add(self, said: Diagnosis, time: float) -> None:
        """Ticks [T, n] that begin ``time`` s after the recording's first row."""
        verdict = np.asarray(said.verdict)
        torque, angle = np.asarray(said.fault_tau_hat, float), np.asarray(said.fault_q_hat, float)
        first = round(time / self.dt)
        for j in range(len(self.joints)):
            self._close(j, first)
            at = np.flatnonzero(verdict[:, j])
            for part in np.split(at, np.flatnonzero(np.diff(at) > GAP / self.dt) + 1):
                if len(part):
                    self._close(j, first + int(part[0]))
                    self._open.setdefault(j, _Open(first + int(part[0])))
                    self._open[j].add(first + part, verdict[part, j], torque[part, j], angle[part, j])
        self.ticks += len(verdict)
        self.alarmed += int((verdict > 0).any(1).sum())

    def _close(self, joint: int, now: int) -> None:
        """End the joint's event if its last alarm is too long ago."""
        event = self._open.get(joint)
        if event is None or now - event.end <= GAP / self.dt:
            return
        del self._open[joint]
        if event.up * self.dt < GLITCH:
            self.glitches += 1
        else:
            times = event.start * self.dt, event.end * self.dt
            self.events.append(event.event(self.dt, times, joint, self.joints[joint]))

    def finish(self) -> list[Event]:
        """All events, by their start."""
        for joint in list(self._open):
            self._close(joint, self._open[joint].end + int(2 * GAP / self.dt) + 1)
        self.events.sort(key=lambda event: (event.start_s, event.joint))
        return self.events

    @property
    def alarm_share(self) -> float:
        """Share of the ticks with an alarm of any joint."""
        return self.alarmed / max(self.ticks, 1)


def as_record(timeline: Timeline, duration: float) -> dict[str, Any]:
    """The timeline as JSON has it; ``duration`` in s, from the first row to the last."""
    events = [event._asdict() for event in timeline.finish()]
    return {
        "sample_time_s": timeline.dt,
        "duration_s": duration,
        "alarm_share": timeline.alarm_share,
        "glitches": timeline.glitches,
        "events": events,
    }
