"""The tick against a robot, at the sample time, until there is a reason to stop.

Soft real time: an operating system may take the processor away at any time, and the summary says how often that was.
``run.py`` has the ticks one by one.
"""

from __future__ import annotations

import gc
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from jaxftc import checks
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.realtime.clock import Clock, SystemClock
from jaxftc.realtime.reaction import Reaction
from jaxftc.realtime.robot import Robot, Stop, angles
from jaxftc.realtime.run import Run
from jaxftc.realtime.stop import SafeStop
from jaxftc.realtime.summary import Summary
from jaxftc.realtime.tick import Tick
from jaxftc.realtime.trips import Trips
from jaxftc.types import Output, Reference


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
        self.asked: str | None = None  # why to stop, once that is asked for
        self._run: Run | None = None

    def request_stop(self, why: str = "asked for") -> None:
        """Stop at the next tick; from another thread, a signal handler, or what the loop calls."""
        self.asked = why

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
        self.asked = None
        state = self.tick.init(angles(self.robot.read(), self.config.n)[0])
        run = self._run = Run(self, state, self._safe)
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
                    self.asked = "interrupted from the keyboard"
        finally:
            gc.unfreeze()
            run.end()
        return run.summary
