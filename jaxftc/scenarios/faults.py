"""Kinds of fault, and the layout of one channel's faults.

Everything about a kind is here: its number, the unit of its magnitude and its effect (``Actuator``, ``Sensor``), and the law
of its size in a preset (``ActuatorFaults``, ``SensorFaults``). A new kind is a function and a line in each of two tables,
never a new signature.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from enum import IntEnum
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxftc.numerics.trigonometry import cos_sin
from jaxftc.scenarios.distributions import Law, Real, Table, require, require_number
from jaxftc.scenarios.preset_error import one_of
from jaxftc.types import Array


class Fault(NamedTuple):
    """One fault per joint of one channel, and its law in time.

    Attributes:
        kind: [n, ...] int32, Actuator or Sensor.
        magnitude: [n, ...] in the kind's unit.
        onset: [n, ...] s.
        clear: [n, ...] s, infinite if it stays.
        rise: [n, ...] s, ramp from 0 to full size; 0 is abrupt.
        period: [n, ...] s, of an intermittent fault; infinite if it is not.
        duty: [n, ...] 1, share of the period in which it is there.
    """

    kind: Array
    magnitude: Array
    onset: Array
    clear: Array
    rise: Array
    period: Array
    duty: Array


def no_fault(n: int) -> Fault:
    """A healthy channel of n joints."""
    zero, always = jnp.zeros(n), jnp.ones(n)
    return Fault(jnp.zeros(n, jnp.int32), zero, zero, always * jnp.inf, zero, always * jnp.inf, always)


LATEST = 5  # ticks that a signal can be late
RIPPLES = 60  # of a motor's torque, in one turn of its joint
FRICTION_SPEED = 0.1  # rad/s, width of a fault's friction
LOCK = 50.0  # rad/s, natural frequency of a joint in its brake


# What a kind does to its signal.


class Torque(NamedTuple):
    """What an actuator's fault acts on."""

    tau: Array  # [n, ...] N m, command
    size: Array  # [n, ...] in the kind's unit, grown as far as its law in time says
    share: Array  # [n, ...] 1, how far it has grown
    magnitude: Array  # [n, ...] in the kind's unit, grown to the full
    held: Array  # [n, ...] N m, torque at onset
    limit: Array  # [n, ...] N m, infinite if there is none
    late: Array  # [n, ...] N m, command of ``size`` ticks ago
    q: Array  # [n, ...] rad, true angle
    qd: Array  # [n, ...] rad/s
    q_held: Array  # [n, ...] rad, angle at onset
    inertia: Array  # [n, ...] kg m^2, that a joint moves
    dt: float  # s, time between ticks


class Reading(NamedTuple):
    """What an encoder's fault acts on."""

    q: Array  # [n, ...] rad, true angle
    noise: Array  # [n, ...] rad, the encoder's own
    size: Array  # [n, ...] in the kind's unit, grown as far as its law in time says
    share: Array  # [n, ...] 1, how far it has grown
    magnitude: Array  # [n, ...] in the kind's unit, grown to the full
    since: Array  # [n, ...] s, time from onset on
    held: Array  # [n, ...] rad, reading at onset
    late: Array  # [n, ...] rad, reading of ``size`` ticks ago

    @property
    def clean(self) -> Array:
        """Reading [n, ...] rad without a fault."""
        return self.q + self.noise


def _ripple(x: Torque) -> Array:
    return x.tau + x.size * cos_sin(RIPPLES * x.q)[1]


def _rubbed(x: Torque) -> Array:
    """Less a friction; where one tick of it would turn the speed round it is softer, as only a stop is possible."""
    width = jnp.maximum(FRICTION_SPEED, x.size * x.dt / x.inertia)
    return x.tau - x.size * jnp.tanh(x.qd / width)


def _locked(x: Torque) -> Array:
    """A brake in place of the motor: a stiff spring to the angle at onset, critically damped for the joint's inertia."""
    frequency = min(LOCK, 0.2 / x.dt)  # slow enough for the tick
    brake = x.inertia * frequency * (frequency * (x.q_held - x.q) - 2 * x.qd)
    return x.tau + x.share * (brake - x.tau)


def _wrapped(x: Reading) -> Array:
    half = jnp.where(x.magnitude > 0, x.magnitude, 1.0)
    return x.clean - 2 * half * jnp.round(x.clean / (2 * half))


def _rounded(x: Reading) -> Array:
    return in_counts(x.clean, x.size)


def in_counts(x: Array, size: Array) -> Array:
    """Angles [n, ...] rad in whole counts of a size in rad, 0 for none; the slope is that of ``x``."""
    count = jnp.where(size > 0, size, 1.0)
    return x + lax.stop_gradient(jnp.where(size > 0, count * jnp.round(x / count) - x, 0.0))


def _saturated(x: Torque) -> Array:
    left = jnp.where(jnp.isfinite(x.limit), x.limit, 0.0) * (1 - x.share * (1 - x.magnitude))
    return jnp.where(jnp.isfinite(x.limit), jnp.clip(x.tau, -left, left), x.tau)


class Kind(IntEnum):
    """A kind of fault: its number, the unit of its magnitude ("" if it has none), and what it makes of the signal."""

    unit: str
    effect: Callable[..., Array]

    def __new__(cls, number: int, unit: str, effect: Callable[..., Array]) -> Kind:
        """A member with its unit and effect."""
        member = int.__new__(cls, number)
        member._value_ = number
        member.unit, member.effect = unit, effect
        return member


class Actuator(Kind):
    """What can happen to a torque."""

    NONE = 0, "", lambda x: x.tau
    BIAS = 1, "N m", lambda x: x.tau + x.size  # added
    LOSS = 2, "1", lambda x: x.tau * (1 - x.size)  # lost share of the command
    STUCK = 3, "", lambda x: x.held  # the torque stays what it was at onset
    SATURATION = 4, "1", _saturated  # share of the torque limit that is left
    GAIN = 5, "1", lambda x: x.tau * (1 + x.size)  # share of the command added
    RIPPLE = 6, "N m", _ripple  # amplitude, with the joint's angle
    FRICTION = 7, "N m", _rubbed  # dry friction added
    LOCKED = 8, "", _locked  # the joint stays where it was at onset
    DELAY = 9, "ticks", lambda x: x.late  # the command comes late


class Sensor(Kind):
    """What can happen to an encoder."""

    NONE = 0, "", lambda x: x.clean
    BIAS = 1, "rad", lambda x: x.clean + x.size  # added
    DRIFT = 2, "rad/s", lambda x: x.clean + x.size * x.since  # grows from onset
    SCALE = 3, "1", lambda x: x.clean + x.size * x.q  # share of the angle added
    FREEZE = 4, "", lambda x: x.held  # the reading stays what it was at onset
    NOISE = 5, "1", lambda x: x.q + x.noise * (1 + x.share * (x.magnitude - 1))  # factor on the encoder's noise
    DROPOUT = 6, "", lambda x: jnp.full_like(x.q, jnp.nan)  # no reading
    ROUNDING = 7, "rad", _rounded  # size of a count
    WRAP = 8, "rad", _wrapped  # the reading stays within plus and minus that angle, and begins anew beyond
    DELAY = 9, "ticks", lambda x: x.late  # the reading comes late
    CROSSTALK = 10, "1", lambda x: x.clean + x.size * jnp.roll(x.q, -1, axis=0)  # share of the next joint's angle added


def common(kinds: type[Kind]) -> Kind:
    """The last of a channel's common kinds; sets without those after it run smaller programs (``Scenario.uncommon``)."""
    return Actuator.STUCK if kinds is Actuator else Sensor.NOISE


# The law of its size in a preset.

UNITS = {
    **dict.fromkeys(("1", "limit", "N m", "rad", "rad/s", "ticks"), 1.0),
    **dict.fromkeys(("deg", "deg/s"), math.radians(1.0)),
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Unsized(Table):
    """A kind of fault without a size."""

    weight: Real = 1.0  # 1, likelihood against the channel's other kinds

    def __post_init__(self) -> None:
        require_number("weight", self.weight, 0.0, above=True)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sized(Unsized):
    """A kind of fault with a size: a share, or a factor on the encoder's noise."""

    size: Law
    unit: str = "1"
    units: ClassVar[tuple[str, ...]] = ("1",)
    least: ClassVar[float] = 0.0
    most: ClassVar[float] = math.inf

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("unit", self.unit, self.units)
        require("size", self.size, self.least, self.most)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Share(Sized):
    """Lost share of the command, or share of the torque limit that is left."""

    most: ClassVar[float] = 1.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class Signed(Sized):
    """A size that can be negative: a share of an angle or of the command, added."""

    sign: str = "as_drawn"  # or random: half of the sizes get the other sign
    least: ClassVar[float] = -math.inf

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("sign", self.sign, ("as_drawn", "random"))


@dataclasses.dataclass(frozen=True, kw_only=True)
class TorqueBias(Signed):
    """Torque that is added: a share of the joint's limit, or N m."""

    unit: str = "limit"
    units: ClassVar[tuple[str, ...]] = ("limit", "N m")


@dataclasses.dataclass(frozen=True, kw_only=True)
class TorqueSize(Sized):
    """Torque without a sign: a share of the joint's limit, or N m."""

    unit: str = "limit"
    units: ClassVar[tuple[str, ...]] = ("limit", "N m")


@dataclasses.dataclass(frozen=True, kw_only=True)
class AngleSize(Sized):
    """Angle without a sign."""

    unit: str = "deg"
    units: ClassVar[tuple[str, ...]] = ("deg", "rad")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Ticks(Sized):
    """Ticks that a signal is late, the nearest whole number of them."""

    unit: str = "ticks"
    units: ClassVar[tuple[str, ...]] = ("ticks",)
    most: ClassVar[float] = LATEST


@dataclasses.dataclass(frozen=True, kw_only=True)
class AngleBias(Signed):
    """Angle that is added."""

    unit: str = "deg"
    units: ClassVar[tuple[str, ...]] = ("deg", "rad")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Drift(Signed):
    """Angle that is added and grows from onset."""

    unit: str = "deg/s"
    units: ClassVar[tuple[str, ...]] = ("deg/s", "rad/s")


@dataclasses.dataclass(frozen=True)
class ActuatorFaults(Table):
    """Kinds that can happen to a torque; None does not. Fields are named as members of ``Actuator``."""

    bias: TorqueBias | None = None
    loss: Share | None = None
    stuck: Unsized | None = None
    saturation: Share | None = None
    gain: Signed | None = None
    ripple: TorqueSize | None = None
    friction: TorqueSize | None = None
    locked: Unsized | None = None
    delay: Ticks | None = None


@dataclasses.dataclass(frozen=True)
class SensorFaults(Table):
    """Kinds that can happen to an encoder; None does not. Fields are named as members of ``Sensor``."""

    bias: AngleBias | None = None
    drift: Drift | None = None
    freeze: Unsized | None = None
    scale: Signed | None = None
    noise: Sized | None = None
    dropout: Unsized | None = None
    rounding: AngleSize | None = None
    wrap: AngleSize | None = None
    delay: Ticks | None = None
    crosstalk: Signed | None = None


def kinds(channel: ActuatorFaults | SensorFaults) -> dict[str, Unsized]:
    """The kinds of fault that a channel can have, by name."""
    found = {field.name: getattr(channel, field.name) for field in dataclasses.fields(channel)}
    return {name: kind for name, kind in found.items() if kind is not None}
