"""Sensor check: encoder faults that are too slow to jump, found by what they do to the reading.

The torque channel sees them first; each detector here takes one kind for what it is:

* ``velocity_transient``: the onset of a drift changes the reading's speed, which looks like a torque until the observer has
  settled, and then like nothing. A torque that is really there stays. A torque residual that falls to ``FALLEN`` of its peak
  (or a statistic below the release level) within ``config.transient_ticks`` of the alarm was one. Of several at once only
  the largest counts: the inertia matrix spreads it to the neighbours;
* ``freeze``: equal readings while the arm moved by more than a jump's worth since the last change, or no reading at all. How
  far it moved is the speed it had, less what a coarse encoder makes of a single count, and its model's acceleration since;
* ``jump_rate``: noise or a steep drift, many jumps in a tenth of a second, to and fro or one way;
* ``coarse_counts``: a reading that goes straight on or turns by a jump's worth, and never by less. It says no more than
  that the angle is within half a count of it, and that is all that the observer takes from it: taken for jumps, its counts
  would explain the motion itself away. Noise of such a size is told in the same way.

A reading found out in this way explains the torque residual of its joint, and the acceleration it feigned is kept out of the
other joints' residuals (``mask_suspect``).

Limits: an actuator fault on the very joint of a slow encoder fault is hidden by it; a torque pulse shorter than
``transient_ticks`` changes the speed just as a drift does and is called one; encoders alone cannot tell them apart.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.diagnosis.alarm import Alarms
from jaxftc.gains import Gains
from jaxftc.observer.cascade import Estimate
from jaxftc.types import Array, SensorStatus

FALLEN = 0.35  # share of its peak to which the residual of a velocity transient has fallen
FROZEN_READINGS = 5
MANY_JUMPS = 8.0
SHARP_TURNS = 6.0  # without a slighter or larger one between them; a bias that comes and goes on an arm at rest makes four
COARSEST = 0.05  # rad, largest count: one of 7 bits
STRAIGHT = 1e-6  # rad, turn of a reading that goes straight on; a count of 20 bits is 6e-6
TRANSIENT_MEMORY = 0.5  # s without an alarm after which a velocity transient is forgotten
JUMP_MEMORY = 0.99  # forgetting of the jump count per tick, about 100 ticks


class Transient(NamedTuple):
    """What tells a velocity transient from a torque; all [n, ...]."""

    alarmed: Array  # 1 while the torque alarm is up, else 0
    age: Array  # ticks since it rose
    peak: Array  # N m, largest torque residual in this alarm
    found: Array  # 1 once an alarm was found to be one, until all has been quiet for TRANSIENT_MEMORY
    quiet: Array  # ticks since an alarm was up


class Jumps(NamedTuple):
    """Leaky counts of jumps; all [n, ...]."""

    total: Array
    signed: Array  # the same, jumps down counted negative


class Freeze(NamedTuple):
    """Readings that do not change; all [n, ...]."""

    y: Array  # rad, last reading
    equal: Array  # readings in a row that did not change or did not come
    lost: Array  # readings in a row that were not used
    speed: Array  # rad/s, of the arm since the reading last changed
    travel: Array  # rad, by which it should have moved since


class Counts(NamedTuple):
    """Turns of a reading, changes of its change in a tick, since one too slight or too large for a count; all [n, ...]."""

    reading: Array  # rad, the last
    change: Array  # rad, by which it changed
    turns: Array  # how many were sharp
    smallest: Array  # rad, of those


class State(NamedTuple):
    """What the detectors remember."""

    transient: Transient
    jumps: Jumps
    freeze: Freeze
    counts: Counts


class Inputs(NamedTuple):
    """What a tick takes in."""

    alarms: Alarms
    threshold_tau: Array  # [n, ...] N m, of this tick
    residual_tau: Array  # [n, ...] N m
    estimate: Estimate
    qd_hat: Array  # [n, ...] rad/s
    qdd: Array  # [n, ...] rad/s^2, acceleration that the command of the last tick stands for, without faults


def init(config: Config, gains: Gains, q: Array) -> State:
    """Nothing found."""
    del config, gains
    zero = jnp.zeros_like(q)
    return State(Transient(*[zero] * 5), Jumps(zero, zero), Freeze(q, zero, zero, zero, zero), Counts(q, zero, zero, zero))


def nothing_found(q: Array) -> SensorStatus:
    """Status of sensors [n, ...] that are in order."""
    return SensorStatus(*[jnp.zeros_like(q)] * 5)


def mask_suspect(sensors: SensorStatus, psi: Array) -> Array:
    """Fault estimate psi [n, ...] rad/s^2 without the joints whose reading is held to be wrong."""
    return psi * (1 - sensors.suspect)


@box("Block 7: sensor check")
def step(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, SensorStatus]:
    """All detectors. Comparisons: no gradient passes."""
    gains, state, inputs = jax.lax.stop_gradient((gains, state, inputs))
    transient = velocity_transient(config, state.transient, inputs)
    jumps, many, noisy = jump_rate(state.jumps, inputs.estimate)
    unchanging, frozen = freeze(config, gains, state.freeze, inputs)
    counts, resolution = coarse_counts(gains, state.counts, inputs.estimate)
    suspect = frozen | many | (resolution > 0) | (transient.found > 0)
    flags = (flag.astype(resolution.dtype) for flag in (suspect, transient.found > 0, frozen, noisy))
    return State(transient, jumps, unchanging, counts), SensorStatus(*flags, resolution=resolution)


def velocity_transient(config: Config, state: Transient, inputs: Inputs) -> Transient:
    """A torque alarm that is over too soon for a torque."""
    residual, up = jnp.abs(inputs.residual_tau), inputs.alarms.tau
    alarmed = (state.alarmed > 0) | up
    age = jnp.where(alarmed, state.age + 1, 0.0)
    peak = jnp.where(alarmed, jnp.maximum(state.peak, residual), 0.0)
    fallen = ~up | (residual < FALLEN * peak)
    excess = peak / inputs.threshold_tau
    now = (state.alarmed > 0) & (age < config.transient_ticks) & fallen & (excess >= excess.max(0))
    quiet = jnp.where(up | inputs.alarms.q, 0.0, state.quiet + 1)
    found = jnp.where(now, 1.0, jnp.where(quiet >= round(TRANSIENT_MEMORY / config.dt), 0.0, state.found))
    return Transient(up.astype(residual.dtype), age, peak, found, quiet)


def jump_rate(state: Jumps, seen: Estimate) -> tuple[Jumps, Array, Array]:
    """Counts, and [n, ...] bool: many jumps; many that go to and fro (a steep drift jumps one way)."""
    total = JUMP_MEMORY * state.total + seen.jump.h_s
    signed = JUMP_MEMORY * state.signed + seen.jump.h_s * seen.jump.side
    many = total >= MANY_JUMPS
    return Jumps(total, signed), many, many & (jnp.abs(signed) < 0.5 * total)


def coarse_counts(gains: Gains, state: Counts, seen: Estimate) -> tuple[Counts, Array]:
    """Size [n, ...] rad of the counts in which a reading comes; 0 where it is fine enough."""
    change = seen.reading - state.reading
    turn = jnp.abs(change - state.change)
    sharp, straight = (turn >= 0.5 * gains.observer.jump) & (turn <= COARSEST), turn <= STRAIGHT
    turns = jnp.where(sharp, state.turns + 1, jnp.where(straight, state.turns, 0.0))
    smallest = jnp.where(sharp & ((turn < state.smallest) | (state.turns == 0)), turn, state.smallest)
    return Counts(seen.reading, change, turns, smallest), jnp.where(turns >= SHARP_TURNS, smallest, 0.0)


def freeze(config: Config, gains: Gains, state: Freeze, inputs: Inputs) -> tuple[Freeze, Array]:
    """Readings that stay the same while the arm moves, or do not come; [n, ...] bool."""
    seen = inputs.estimate
    unchanged = seen.missing | (seen.y == state.y)
    equal = jnp.where(unchanged, state.equal + 1, 0.0)
    lost = jnp.where(seen.missing, state.lost + 1, 0.0)  # one alone that does not come to an arm at rest is no freeze
    stepped = jnp.abs(seen.y - state.y) / (config.dt * (state.equal + 1))  # of a coarse encoder: one count in so many ticks
    changed = jnp.where(state.equal > 0, jnp.clip(inputs.qd_hat, -stepped, stepped), inputs.qd_hat)
    ahead = state.speed + config.dt * inputs.qdd
    ahead = jnp.where(ahead * state.speed > 0, ahead, 0.0)  # it may stop, and then stands
    speed = jnp.where(unchanged, ahead, changed)
    travel = jnp.where(unchanged, state.travel + config.dt * jnp.abs(state.speed), 0.0)
    moved = travel > gains.observer.jump
    frozen = ((equal >= FROZEN_READINGS) & moved) | ((lost >= FROZEN_READINGS) & seen.absent)
    return Freeze(seen.y, equal, lost, speed, travel), frozen
