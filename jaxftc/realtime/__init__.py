"""The tick in a loop of one's own: deadlines, trips, a safe stop, and a reaction to verdicts."""

from jaxftc.realtime.clock import Clock as Clock
from jaxftc.realtime.clock import SimulatedClock as SimulatedClock
from jaxftc.realtime.clock import SystemClock as SystemClock
from jaxftc.realtime.loop import Loop as Loop
from jaxftc.realtime.reaction import Phase as Phase
from jaxftc.realtime.reaction import Reaction as Reaction
from jaxftc.realtime.robot import Robot as Robot
from jaxftc.realtime.stop import SafeStop as SafeStop
from jaxftc.realtime.summary import Summary as Summary
from jaxftc.realtime.tick import Tick as Tick
from jaxftc.realtime.trips import Trips as Trips
