"""One run of a ``Loop``, tick by tick.

Tick k belongs to the moment k dt after the start, and is run then or a little later. Ticks whose moment has passed are
missed: they are run without a reading and with the torque that was held meanwhile, so that the state of the controller is
that of the moment again.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from jaxftc.config import Config
from jaxftc.realtime.clock import Clock
from jaxftc.realtime.deadlines import Deadlines
from jaxftc.realtime.events import Events
from jaxftc.realtime.reaction import Reaction, names
from jaxftc.realtime.robot import Robot, Stop, angles
from jaxftc.realtime.summary import Summary
from jaxftc.realtime.tick import Tick
from jaxftc.realtime.trips import Trip, Trips, Watch
from jaxftc.types import Measurement, Output, Reference
from jaxftc.version import __version__

MOST_CAUGHT_UP = 100  # ticks; after a longer gap the prediction is worth nothing
LATE_START = 0.25  # of a period, at most: a reading that is late by more looks like a jump of the encoder, none does not


class Parts(Protocol):
    """What a run needs of its ``Loop``, where each is explained."""

    config: Config
    tick: Tick
    robot: Robot
    reference: Callable[[float], Reference]
    trips: Trips
    reaction: Reaction
    stop: Stop
    event_file: str | Path | None
    on_tick: Callable[[float, Output], object] | None
    clock: Clock
    asked: str | None  # why to stop, once that is asked for


class Run:
    """What changes while a loop runs: its ticks, one by one, and what became of it."""

    def __init__(self, loop: Parts, state: Any, safe: Stop) -> None:
        self._loop, self._state, self._safe = loop, state, safe
        self._nan: Any = np.full(loop.config.n, np.nan)
        self._nowhere = Reference(self._nan, self._nan, self._nan)  # every joint holds where it is
        self.events = Events(loop.event_file)
        self.summary = Summary(loop.config.dt)
        self.reacted = loop.reaction.init(loop.config.n)
        self.over = False
        # The last output whose estimates are finite; before the first tick that of one without a reading.
        self.out: Any = loop.tick.step(state, self._nowhere, Measurement(self._nan, self._nan))[1]
        self._stop, self._limit = loop.stop, np.asarray(loop.config.robot.torque_limit)
        self._watch = Watch(loop.trips, loop.config)
        self._k, self._last = 0, -1  # the tick to come, and the last that was run
        self._tripped = 0  # tick of the trip
        self._missing = np.zeros(loop.config.n, bool)
        self._deadlines = Deadlines(loop.config.n, self.summary, self.events)

    def begin(self) -> None:
        """Time starts now."""
        config, now = self._loop.config, datetime.now(UTC).isoformat(timespec="milliseconds")
        self.events.add(0.0, "start", time=now, robot=config.robot.name, dt=config.dt, jaxftc=__version__)
        self._start = self._loop.clock.now()

    def turn(self, duration: float) -> None:
        """One tick: wait, read, decide, write, and look at what came of it."""
        loop, dt = self._loop, self._loop.config.dt
        self._wait()
        k, t = self._k, self._k * dt
        if loop.asked is not None:
            self._trip(Trip("asked", loop.asked))
        elif t >= duration - 0.5 * dt:
            self._trip(Trip("end", f"{duration:g} s are over"))
        elapsed, began = (k - self._last) * dt, loop.clock.now()
        missing, measurement = self._read(k)
        self._state, out = loop.tick.step(self._state, self._reference(t), measurement)
        tau = self._torque(k, out)
        taken = self._write(tau)
        wrote = loop.clock.now()
        self._k, self._last = k + 1, k
        self._note_times(k, began, wrote, tau, taken=taken)
        self._judge(t, out, missing, elapsed)
        if loop.on_tick is not None:
            try:
                loop.on_tick(t, out)
            except Exception as error:
                self._trip(Trip("error", f"on_tick: {error!r}"))

    def end(self) -> None:
        """Close what was open."""
        self._deadlines.end_streak(self._k)
        self.summary.duration = self._loop.clock.now() - self._start
        ended = self.summary.ended
        self.events.add(self.summary.duration, "end", cause=ended.cause if ended else "exception")
        self.events.close()
        self.summary.lost = self.events.lost

    def _next(self) -> int:
        """The first tick that is not too late for a reading now."""
        return math.ceil((self._loop.clock.now() - self._start) / self._loop.config.dt - LATE_START)

    def _wait(self) -> None:
        """Wait for the next tick; run those that were missed without a reading and with the torque that was held."""
        loop, first, dt = self._loop, self._k, self._loop.config.dt
        while True:
            loop.clock.wait_until(self._start + self._k * dt)
            due = self._next()
            if due <= self._k:
                break
            if self._k - first >= MOST_CAUGHT_UP:
                self._k = due
                continue
            measurement = Measurement(self._nan, self._deadlines.in_effect(self._k))
            self._state, _ = loop.tick.step(self._state, self._reference(self._k * dt), measurement)
            self._k += 1
        if self._k > first:
            self._missed(self._deadlines.skipped(self._k - first))

    def _read(self, k: int) -> tuple[np.ndarray, Measurement]:
        """Joints without a reading [n] bool, and what the tick is told."""
        loop = self._loop
        why = {}
        try:
            q, tau = angles(loop.robot.read(), loop.config.n)
        except Exception as error:
            q, tau, why = self._nan, None, {"why": repr(error)}
        missing = ~np.isfinite(q)
        self.summary.unread += bool(missing.any())
        if (missing != self._missing).any():
            self._missing = missing
            joints = [int(j) + 1 for j in np.flatnonzero(missing)]
            self.events.add(k * loop.config.dt, "reading", without=joints, **why)
        return missing, Measurement(q, self._deadlines.in_effect(k) if tau is None else tau)

    def _reference(self, t: float) -> Reference:
        """The wanted motion; in the stop none."""
        if self.summary.ended is not None:
            return self._nowhere
        n = self._loop.config.n
        try:
            wanted = self._loop.reference(t)
            if any(np.shape(signal) != (n,) for signal in wanted):
                raise ValueError(f"it must give arrays [{n}], got {[list(np.shape(signal)) for signal in wanted]}")
            return wanted
        except Exception as error:
            self._trip(Trip("error", f"reference: {error!r}"))
            return self._nowhere

    def _torque(self, k: int, out: Any) -> np.ndarray:
        """What is to be written: the controller's command, or the stop's."""
        loop = self._loop
        if self.summary.ended is None:
            bad = None if np.isfinite(out.tau).all() else self._watch.command(out.tau, 0.0)
            if bad is None:
                return out.tau
            self._trip(bad)
        since = (k - self._tripped) * loop.config.dt
        try:
            tau, self.over = self._stop(since, self._estimates(out))
            tau = np.asarray(tau, float)
            if tau.shape != (loop.config.n,) or not np.isfinite(tau).all():
                raise ValueError(f"it must give finite torques [{loop.config.n}], got {tau.tolist()}")
        except Exception as error:
            self.events.add(k * loop.config.dt, "stop failed", why=repr(error))
            self._stop, self._tripped = self._safe, k
            tau, self.over = self._safe(0.0, self._estimates(out))
        return np.clip(tau, -self._limit, self._limit)

    def _estimates(self, out: Any) -> Output:
        """The output with estimates that are finite: its own, or the last angles that were, at rest."""
        if np.isfinite(out.q_hat).all() and np.isfinite(out.qd_hat).all():
            return out
        return out._replace(q_hat=self.out.q_hat, qd_hat=np.zeros_like(self.out.q_hat))

    def _write(self, tau: np.ndarray) -> bool:
        """Give the robot a torque [n] N m; whether it took it."""
        try:
            self._loop.robot.write(tau)
        except Exception as error:
            if not self._deadlines.streak:  # of a streak the first, so that the log stays short
                self.events.add(self._k * self._loop.config.dt, "write", why=repr(error))
            return False
        return True

    def _note_times(self, k: int, began: float, wrote: float, tau: np.ndarray, *, taken: bool) -> None:
        """When the command of tick k came, and whether that was in time."""
        due = self._start + k * self._loop.config.dt
        self.summary.ticks += 1
        self.summary.start.add(began - due)
        self.summary.work.add(wrote - began)
        if taken:
            self._deadlines.took(tau, k, wrote - due)
        self._missed(self._deadlines.command(k, wrote - due, taken=taken))

    def _missed(self, count: int) -> None:
        """Deadlines that were missed, which may trip."""
        if count:
            self._trip(self._watch.deadlines(self._k * self._loop.config.dt, count))

    def _judge(self, t: float, out: Any, missing: np.ndarray, elapsed: float) -> None:
        """Reaction and trips, when the command is on its way; ``missing`` [n] bool, ``elapsed`` s since the last tick."""
        if np.isfinite(out.q_hat).all() and np.isfinite(out.qd_hat).all():
            self.out = out
        self.reacted, changes = self._loop.reaction.step(self.reacted, out.verdict, elapsed)
        for change in names(changes, self._loop.config.robot.joint_names):
            self.events.add(t, "reaction", **change)
        if self.summary.ended is None:
            self._trip(self._watch.reading(missing, elapsed))
            self._trip(self._watch.command(out.tau, elapsed))
            self._trip(self._watch.verdicts(self.reacted))

    def _trip(self, trip: Trip | None) -> None:
        """Go over to the stop, once; the first cause is the one that counts."""
        if trip is not None and self.summary.ended is None:
            self.summary.ended, self._tripped = trip, self._k
            self.events.add(self._k * self._loop.config.dt, "trip", cause=trip.cause, text=trip.text)
