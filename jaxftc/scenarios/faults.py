"""Kinds of fault, and the layout of one channel's faults.

Everything about a kind is here: its number, the unit of its magnitude and its effect (``Actuator``, ``Sensor``), and the law
of its size in a preset (``ActuatorFaults``, ``SensorFaults``). A new kind is a line in each of two tables, never a new
signature; an effect of more than a line is a function in ``fault_effects``.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from enum import IntEnum
from typing import ClassVar, NamedTuple

import jax.numpy as jnp

from jaxftc.scenarios import fault_effects
from jaxftc.scenarios.distributions import Law, Real, Table, require, require_number
from jaxftc.scenarios.preset_error import one_of
from jaxftc.types import Array

LATEST = 5  # ticks that a signal can be late


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
    SATURATION = 4, "1", fault_effects.saturated  # share of the torque limit that is left
    GAIN = 5, "1", lambda x: x.tau * (1 + x.size)  # share of the command added
    RIPPLE = 6, "N m", fault_effects.ripple  # amplitude, with the joint's angle
    FRICTION = 7, "N m", fault_effects.rubbed  # dry friction added
    LOCKED = 8, "", fault_effects.locked  # the joint stays where it was at onset
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
    ROUNDING = 7, "rad", lambda x: fault_effects.in_counts(x.clean, x.size)  # size of a count
    WRAP = 8, "rad", fault_effects.wrapped  # the reading stays within plus and minus that angle, and begins anew beyond
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
