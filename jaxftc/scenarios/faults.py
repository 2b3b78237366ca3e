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


# What a kind does to its signal.


class Torque(NamedTuple):
    """What an actuator's fault acts on."""

    tau: Array  # [n, ...] N m, command
    size: Array  # [n, ...] in the kind's unit, grown as far as its law in time says
    share: Array  # [n, ...] 1, how far it has grown
    magnitude: Array  # [n, ...] in the kind's unit, grown to the full
    held: Array  # [n, ...] N m, torque at onset
    limit: Array  # [n, ...] N m, infinite if there is none


class Reading(NamedTuple):
    """What an encoder's fault acts on."""

    q: Array  # [n, ...] rad, true angle
    noise: Array  # [n, ...] rad, the encoder's own
    size: Array  # [n, ...] in the kind's unit, grown as far as its law in time says
    share: Array  # [n, ...] 1, how far it has grown
    magnitude: Array  # [n, ...] in the kind's unit, grown to the full
    since: Array  # [n, ...] s, time from onset on
    held: Array  # [n, ...] rad, reading at onset

    @property
    def clean(self) -> Array:
        """Reading [n, ...] rad without a fault."""
        return self.q + self.noise


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


class Sensor(Kind):
    """What can happen to an encoder."""

    NONE = 0, "", lambda x: x.clean
    BIAS = 1, "rad", lambda x: x.clean + x.size  # added
    DRIFT = 2, "rad/s", lambda x: x.clean + x.size * x.since  # grows from onset
    SCALE = 3, "1", lambda x: x.clean + x.size * x.q  # share of the angle added
    FREEZE = 4, "", lambda x: x.held  # the reading stays what it was at onset
    NOISE = 5, "1", lambda x: x.q + x.noise * (1 + x.share * (x.magnitude - 1))  # factor on the encoder's noise
    DROPOUT = 6, "", lambda x: jnp.full_like(x.q, jnp.nan)  # no reading


# The law of its size in a preset.

UNITS = {"1": 1.0, "limit": 1.0, "N m": 1.0, "rad": 1.0, "rad/s": 1.0, "deg": math.radians(1.0), "deg/s": math.radians(1.0)}


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
    """A size that can be negative: a share of the angle, added."""

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


@dataclasses.dataclass(frozen=True)
class SensorFaults(Table):
    """Kinds that can happen to an encoder; None does not. Fields are named as members of ``Sensor``."""

    bias: AngleBias | None = None
    drift: Drift | None = None
    freeze: Unsized | None = None
    scale: Signed | None = None
    noise: Sized | None = None
    dropout: Unsized | None = None


def kinds(channel: ActuatorFaults | SensorFaults) -> dict[str, Unsized]:
    """The kinds of fault that a channel can have, by name."""
    found = {field.name: getattr(channel, field.name) for field in dataclasses.fields(channel)}
    return {name: kind for name, kind in found.items() if kind is not None}
