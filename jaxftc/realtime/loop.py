"""The tick against a robot, at the sample time, until there is a reason to stop.

Tick k belongs to the moment k dt after the start, and is run then or a little later. Ticks whose moment has passed are
missed: they are run without a reading and with the torque that was held meanwhile, so that the state of the controller is
that of the moment again. Soft real time: an operating system may take the processor away at any time, and the summary says
how often that was.
"""

from __future__ import annotations

import gc
import math
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from jaxftc import checks
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.realtime.clock import Clock, SystemClock
from jaxftc.realtime.events import Events
from jaxftc.realtime.reaction import Reaction, names
from jaxftc.realtime.stop import SafeStop
from jaxftc.realtime.summary import Summary
from jaxftc.realtime.tick import Tick
from jaxftc.realtime.trips import Trip, Trips, Watch
from jaxftc.types import Measurement, Output, Reference
from jaxftc.version import __version__

MOST_CAUGHT_UP = 100  # ticks; after a longer gap the prediction is worth nothing
LATE_START = 0.25  # of a period, at most: a reading that is late by more looks like a jump of the encoder, none does not

Stop = Callable[[float, Output], tuple[Any, bool]]


class Robot(Protocol):
    """What a loop asks of a robot. What ``read`` raises is a missing reading, what ``write`` raises a missed deadline."""

    def read(self) -> Any:
        """Angles [n] rad, nan where there is none; or a ``Measurement`` with the torque [n] N m that the drives made."""
        ...

    def write(self, tau: np.ndarray) -> Any:
        """Take a torque [n] N m and hold it until the next."""
        ...


class Loop:
    """The tick at ``config.dt`` against a robot, with deadlines, trips and a safe stop. Compiled when made.

    What it was made with are its attributes; those but ``config`` may be changed between runs.

    Args:
        config: Robot, scheme and timing.
        gains: Gains of the tick.
        robot: Any object with ``read()`` and ``write(tau)``.
        reference: The wanted motion: t in s since the start, to a ``Reference`` of arrays [n].
        trips: What takes the loop to its stop.
        reaction: When a verdict counts, and when it is over.
        stop: s since the trip and the tick's ``Output``, to a torque [n] N m and whether the stop is over;
            ``SafeStop(config)`` if None. The estimates in that output are finite.
        event_file: File to which every change is appended, a JSON line each.
        on_tick: Called with t in s and the ``Output`` when a command has been written.
        clock: The computer's, or one of your own.
        backend: Of the ``Tick``: ``c``, where there is a C compiler, leaves most of a period to the robot's driver.

    Raises:
        ValueError: the gains or the file are refused, or there is no C compiler for ``backend="c"``.
    """

    def __init__(
        self,
        config: Config,
        gains: Gains,
        robot: Robot,
        reference: Callable[[float], Reference],
        *,
        trips: Trips | None = None,
        reaction: Reaction | None = None,
        stop: Stop | None = None,
        event_file: str | Path | None = None,
        on_tick: Callable[[float, Output], object] | None = None,
        clock: Clock | None = None,
        backend: Literal["xla", "c"] = "xla",
    ) -> None:
        checks.instance("config", config, Config)
        checks.instance("gains", gains, Gains)
        self.config, self.robot, self.reference = config, robot, reference
        self.trips = Trips() if trips is None else trips
        self.reaction = Reaction() if reaction is None else reaction
        self.clock: Clock = SystemClock() if clock is None else clock
        self.tick = Tick(config, gains, backend=backend)
        self._safe: Stop = SafeStop(config)
        self.stop = self._safe if stop is None else stop
        self.on_tick, self.event_file = on_tick, event_file
        self._asked: str | None = None
        self._nan: Any = np.full(config.n, np.nan)
        self._nowhere = Reference(self._nan, self._nan, self._nan)  # every joint holds where it is
        self._run: _Run | None = None

    def request_stop(self, why: str = "asked for") -> None:
        """Stop at the next tick; from another thread, a signal handler, or what the loop calls."""
        self._asked = why

    def reset(self) -> None:
        """Every joint healthy in the reaction, by a person's word."""
        if self._run is not None:
            self._run.reacted = self.reaction.reset(self._run.reacted)

    @property
    def reacted(self) -> Any:
        """State of the reaction, joint by joint; None before the first run."""
        return None if self._run is None else self._run.reacted

    @property
    def events(self) -> list[dict[str, Any]]:
        """The last events of the last run."""
        return [] if self._run is None else list(self._run.events.last)

    def run(self, duration: float = math.inf) -> Summary:
        """Run for ``duration`` s, or until something trips, then stop the arm.

        The arm must be at rest. Ctrl-C asks for the stop; a second one ends at once and leaves the last torque.

        Returns:
            The run's figures; printing them gives text.

        Raises:
            ValueError: the duration is not positive, or the first reading is not finite.
        """
        if duration != math.inf:
            checks.positive("duration", duration, "seconds; math.inf is until something trips")
        self._asked = None
        state = self.tick.init(_angles(self.robot.read(), self.config.n)[0])
        run = self._run = _Run(self, state)
        self._safe(0.0, run.out)  # as the tick has been: nothing is done for the first time later
        gc.collect()
        gc.freeze()  # what is there now is never searched for garbage again, which would take many ticks
        try:
            run.begin()
            while not run.over:
                try:
                    run.turn(duration)
                except KeyboardInterrupt:
                    if run.summary.ended is not None:
                        raise
                    self._asked = "interrupted from the keyboard"
        finally:
            gc.unfreeze()
            run.end()
        return run.summary


class _Run:
    """What changes while a loop runs."""

    def __init__(self, loop: Loop, state: Any) -> None:
        self._loop, self._state = loop, state
        self.events = Events(loop.event_file)
        self.summary = Summary(loop.config.dt)
        self.reacted = loop.reaction.init(loop.config.n)
        self.over = False
        # The last output whose estimates are finite; before the first tick that of one without a reading.
        self.out: Any = loop.tick.step(state, loop._nowhere, Measurement(loop._nan, loop._nan))[1]
        self._stop, self._limit = loop.stop, np.asarray(loop.config.robot.torque_limit)
        self._watch = Watch(loop.trips, loop.config)
        self._k, self._last = 0, -1  # the tick to come, and the last that was run
        # Torque before, torque now, and the tick from which on that is held.
        self._held: tuple[Any, Any, int] = (loop._nan, loop._nan, 0)
        self._tripped = 0  # tick of the trip
        self._missing = np.zeros(loop.config.n, bool)
        self._streak, self._worst = 0, 0.0  # deadlines missed one after another, and the latest command among them, s

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
        if loop._asked is not None:
            self._trip(Trip("asked", loop._asked))
        elif t >= duration - 0.5 * dt:
            self._trip(Trip("end", f"{duration:g} s are over"))
        elapsed, began = (k - self._last) * dt, loop.clock.now()
        missing, measurement = self._read(k)
        self._state, out = loop.tick.step(self._state, self._reference(t), measurement)
        tau = self._torque(k, out)
        taken = self._write(tau)
        wrote = loop.clock.now()
        self._k, self._last = k + 1, k
        self._note_times(k, began, wrote, taken)
        self._judge(t, out, missing, elapsed)
        if loop.on_tick is not None:
            try:
                loop.on_tick(t, out)
            except Exception as error:
                self._trip(Trip("error", f"on_tick: {error!r}"))

    def end(self) -> None:
        """Close what was open."""
        self._end_streak()
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
            measurement = Measurement(loop._nan, self._in_effect(self._k))
            self._state, _ = loop.tick.step(self._state, self._reference(self._k * dt), measurement)
            self._k += 1
        if self._k > first:
            self.summary.skipped += self._k - first
            self._missed(self._k - first)

    def _in_effect(self, k: int) -> Any:
        """Torque [n] N m that was held in the period before tick k; nan before the first command."""
        before, now, since = self._held
        return now if since < k else before

    def _read(self, k: int) -> tuple[np.ndarray, Measurement]:
        """Joints without a reading [n] bool, and what the tick is told."""
        loop = self._loop
        why = {}
        try:
            q, tau = _angles(loop.robot.read(), loop.config.n)
        except Exception as error:
            q, tau, why = loop._nan, None, {"why": repr(error)}
        missing = ~np.isfinite(q)
        self.summary.unread += bool(missing.any())
        if (missing != self._missing).any():
            self._missing = missing
            joints = [int(j) + 1 for j in np.flatnonzero(missing)]
            self.events.add(k * loop.config.dt, "reading", without=joints, **why)
        return missing, Measurement(q, self._in_effect(k) if tau is None else tau)

    def _reference(self, t: float) -> Reference:
        """The wanted motion; in the stop none."""
        if self.summary.ended is not None:
            return self._loop._nowhere
        n = self._loop.config.n
        try:
            wanted = self._loop.reference(t)
            if any(np.shape(signal) != (n,) for signal in wanted):
                raise ValueError(f"it must give arrays [{n}], got {[list(np.shape(signal)) for signal in wanted]}")
            return wanted
        except Exception as error:
            self._trip(Trip("error", f"reference: {error!r}"))
            return self._loop._nowhere

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
            self._stop, self._tripped = loop._safe, k
            tau, self.over = loop._safe(0.0, self._estimates(out))
        return np.clip(tau, -self._limit, self._limit)

    def _estimates(self, out: Any) -> Output:
        """The output with estimates that are finite: its own, or the last angles that were, at rest."""
        if np.isfinite(out.q_hat).all() and np.isfinite(out.qd_hat).all():
            return out
        return out._replace(q_hat=self.out.q_hat, qd_hat=np.zeros_like(self.out.q_hat))

    def _write(self, tau: np.ndarray) -> bool:
        """Whether the robot took it."""
        try:
            self._loop.robot.write(tau)
        except Exception as error:
            if not self._streak:  # of a streak the first, so that the log stays short
                self.events.add(self._k * self._loop.config.dt, "write", why=repr(error))
            return False
        self._written = tau
        return True

    def _note_times(self, k: int, began: float, wrote: float, taken: bool) -> None:
        """Deadlines, and from when on the command is held: on time it counts for the whole period."""
        dt = self._loop.config.dt
        due = self._start + k * dt
        late = wrote - due > dt
        self.summary.ticks += 1
        self.summary.start.add(began - due)
        self.summary.work.add(wrote - began)
        if taken:
            self._held = (self._held[1], self._written, max(k, round((wrote - self._start) / dt)) if late else k)
        if not taken or late:
            self.summary.late += 1
            self._worst = max(self._worst, wrote - due - dt)
            self._missed(1)
        else:
            self._end_streak()

    def _missed(self, count: int) -> None:
        self._streak += count
        self._trip(self._watch.deadlines(self._k * self._loop.config.dt, count))

    def _end_streak(self) -> None:
        if self._streak:
            self.events.add(self._k * self._loop.config.dt, "deadlines", missed=self._streak, latest_s=round(self._worst, 6))
            self._streak, self._worst = 0, 0.0

    def _judge(self, t: float, out: Any, missing: np.ndarray, elapsed: float) -> None:
        """Reaction and trips, when the command is on its way."""
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


def _angles(reading: Any, n: int) -> tuple[Any, Any]:
    """Angles [n] rad of what a robot gave, and the torque [n] N m if it gave one."""
    q, tau = reading if isinstance(reading, Measurement) else (reading, None)
    found = []
    for name, value in (("angles", q), ("torques", tau)):
        array = None if value is None else np.array(value, float)
        if array is not None and array.shape != (n,):
            raise ValueError(f"read must give {name} [{n}], got shape {list(array.shape)}")
        found.append(array)
    return (np.full(n, np.nan) if found[0] is None else found[0]), found[1]
