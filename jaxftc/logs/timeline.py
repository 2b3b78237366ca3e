"""From verdicts, tick by tick, to events: one a fault, in memory that does not grow with the recording.

A joint's alarm that is part of a contact is no event of its own: the contact is one, of the link that it is on, from the
first of these alarms to the last.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from jaxftc.schemes.diagnoser import Diagnosis
from jaxftc.types import Verdict

GAP = 0.5  # s; a shorter pause of a joint's alarm is part of its event
GLITCH = 0.1  # s; a shorter alarm is no event
SHARE = 0.5  # of an event's alarm in which a kind must be named to be part of it
UNITS = ("N m", "deg", "N")


class Event(NamedTuple):
    """One fault, as it was seen."""

    start_s: float  # s from the recording's first row
    end_s: float  # s
    joint: int  # from 1; of a contact the joint that moves the link
    joint_name: str
    kind: str  # actuator, sensor, both or contact
    size: (
        float  # torque (also of both): mean size in N m, with its mean's sign; reading: largest error in deg; force: mean, N
    )
    unit: str


class _Open:
    """An alarm of one joint that has not ended yet."""

    def __init__(self, start: int) -> None:
        self.start = self.end = start
        self.up = self.actuator = self.sensor = self.contact = 0  # ticks
        self.torque = self.size = self.angle = 0.0  # sums over the actuator's ticks, with and without sign; largest

    def add(self, at: np.ndarray, verdict: np.ndarray, torque: np.ndarray, angle: np.ndarray) -> None:
        """Ticks of alarm, in order."""
        self.end = int(at[-1]) + 1
        actuator, sensor = (verdict & int(kind) > 0 for kind in (Verdict.ACTUATOR, Verdict.SENSOR))
        self.up += len(at)
        self.contact += int((verdict & int(Verdict.CONTACT) > 0).sum())
        self.actuator, self.sensor = self.actuator + int(actuator.sum()), self.sensor + int(sensor.sum())
        self.torque += float(torque[actuator].sum())
        self.size += float(np.abs(torque[actuator]).sum())
        if sensor.any():
            largest = float(angle[sensor][np.abs(angle[sensor]).argmax()])
            self.angle = max(self.angle, largest, key=abs)

    def touched(self, least: float) -> bool:
        """Whether it is part of a contact, which lasts for at least so many ticks."""
        return self.contact >= max(SHARE * self.up, least)

    def event(self, dt: float, times: tuple[float, float], joint: int, name: str) -> Event:
        """What is said of it."""
        least = SHARE * (self.up - self.contact)
        kind = Verdict(int(self.actuator >= least) * Verdict.ACTUATOR + int(self.sensor >= least) * Verdict.SENSOR)
        torque = np.copysign(self.size / max(self.actuator, 1), self.torque)
        size = np.rad2deg(self.angle) if kind == Verdict.SENSOR else torque
        return Event(*times, joint + 1, name, kind.label, float(size), UNITS[kind == Verdict.SENSOR])


class _Touch:
    """A contact that has not ended yet."""

    def __init__(self, start: int, joints: int) -> None:
        self.start = self.end = start
        self.up = 0  # ticks
        self.ticks, self.force = np.zeros(joints, int), np.zeros(joints)  # by link: how often it was named, sum of forces

    def add(self, at: np.ndarray, link: np.ndarray, force: np.ndarray) -> None:
        """Ticks of contact, in order: link from 0, size in N."""
        self.end = int(at[-1]) + 1
        self.up += len(at)
        np.add.at(self.ticks, link, 1)
        np.add.at(self.force, link, force)

    def event(self, times: tuple[float, float], names: tuple[str, ...]) -> Event:
        """What is said of it: the link that was named most, and the mean force on that."""
        link = int(self.ticks.argmax())
        size = float(self.force[link] / self.ticks[link])
        return Event(*times, link + 1, names[link], Verdict.CONTACT.label, size, UNITS[2])


class Timeline:
    """Events of a recording, from its stretches of diagnosis in order."""

    def __init__(self, joints: tuple[str, ...], dt: float) -> None:
        self.joints, self.dt = joints, dt
        self.ticks = self.alarmed = self.glitches = 0
        self.events: list[Event] = []
        self._open: dict[int, _Open] = {}
        self._touch: _Touch | None = None
        self._parts: list[tuple[float, float]] = []  # s, start and end of alarms that are part of a contact

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
        self._add_contact(verdict, np.asarray(said.force, float), first)
        self.ticks += len(verdict)
        self.alarmed += int((verdict > 0).any(1).sum())

    def _add_contact(self, verdict: np.ndarray, force: np.ndarray, first: int) -> None:
        """Contacts in ticks [T, n], from tick ``first`` of the recording."""
        bears = (verdict & int(Verdict.CONTACT)) > 0
        self._close_contact(first)
        at = np.flatnonzero(bears.any(1))
        for part in np.split(at, np.flatnonzero(np.diff(at) > GAP / self.dt) + 1):
            if len(part):
                self._close_contact(first + int(part[0]))
                self._touch = self._touch or _Touch(first + int(part[0]), len(self.joints))
                self._touch.add(first + part, bears[part].sum(1) - 1, force[part].max(1))

    def _close_contact(self, now: int) -> None:
        """End the contact if it was last seen too long ago."""
        event = self._touch
        if event is None or now - event.end <= GAP / self.dt:
            return
        self._touch = None
        if event.up * self.dt < GLITCH:
            self.glitches += 1
        else:
            self.events.append(event.event((event.start * self.dt, event.end * self.dt), self.joints))

    def _close(self, joint: int, now: int) -> None:
        """End the joint's event if its last alarm is too long ago."""
        event = self._open.get(joint)
        if event is None or now - event.end <= GAP / self.dt:
            return
        del self._open[joint]
        times = event.start * self.dt, event.end * self.dt
        if event.touched(GLITCH / self.dt):
            self._parts.append(times)
        elif event.up * self.dt < GLITCH:
            self.glitches += 1
        else:
            self.events.append(event.event(self.dt, times, joint, self.joints[joint]))

    def finish(self) -> list[Event]:
        """All events, by their start."""
        for joint in list(self._open):
            self._close(joint, self._open[joint].end + int(2 * GAP / self.dt) + 1)
        if self._touch is not None:
            self._close_contact(self._touch.end + int(2 * GAP / self.dt) + 1)
        self.events = [self._whole(event) for event in self.events]
        self._parts = []
        self.events.sort(key=lambda event: (event.start_s, event.joint))
        return self.events

    def _whole(self, event: Event) -> Event:
        """A contact from the first alarm that is part of it to the last; another event as it is."""
        if event.kind != Verdict.CONTACT.label:
            return event
        own = [times for times in self._parts if times[0] <= event.end_s and times[1] >= event.start_s]
        return event._replace(
            start_s=min([event.start_s, *(start for start, _ in own)]), end_s=max([event.end_s, *(end for _, end in own)])
        )

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
