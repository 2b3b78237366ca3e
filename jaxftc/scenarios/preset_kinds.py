"""Kinds of fault that a preset can have: a table each, with the law of its size, the unit and the likelihood."""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar

from jaxftc.scenarios.distributions import Law, Real, Table, require, require_number
from jaxftc.scenarios.preset_error import one_of

UNITS = {"1": 1.0, "limit": 1.0, "N m": 1.0, "rad": 1.0, "rad/s": 1.0, "deg": math.radians(1.0), "deg/s": math.radians(1.0)}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Kind(Table):
    """A kind of fault; this one has no size."""

    weight: Real = 1.0  # 1, likelihood against the channel's other kinds

    def __post_init__(self) -> None:
        require_number("weight", self.weight, 0.0, above=True)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sized(Kind):
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
    """Kinds that can happen to a torque; None does not. Fields are named and ordered as draws are: see ``sample.py``."""

    bias: TorqueBias | None = None
    loss: Share | None = None
    stuck: Kind | None = None
    saturation: Share | None = None


@dataclasses.dataclass(frozen=True)
class SensorFaults(Table):
    """Kinds that can happen to an encoder; None does not. Fields are named and ordered as draws are: see ``sample.py``."""

    bias: AngleBias | None = None
    drift: Drift | None = None
    freeze: Kind | None = None
    scale: Signed | None = None
    noise: Sized | None = None
    dropout: Kind | None = None


def kinds(channel: ActuatorFaults | SensorFaults) -> dict[str, Kind]:
    """The kinds of fault that a channel can have, by name."""
    found = {field.name: getattr(channel, field.name) for field in dataclasses.fields(channel)}
    return {name: kind for name, kind in found.items() if kind is not None}
