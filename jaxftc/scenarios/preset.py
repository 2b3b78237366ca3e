"""``Preset``: the laws that scenarios are drawn from. Frozen and hashable: a static argument of ``jax.jit``.

The fields are the keys of a preset file, with the file's units; ``presets/standard.toml`` explains each key, ``sample.py``
turns degrees into rad. Every table checks itself, whether a file or Python made it, and raises ``PresetError``, which is a
ValueError.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated

from pydantic import Strict

from jaxftc.scenarios.contact import ContactLaw
from jaxftc.scenarios.distributions import Law, Real, Table, extent, require, require_number
from jaxftc.scenarios.faults import ActuatorFaults, AngleBias, SensorFaults, TorqueBias, kinds
from jaxftc.scenarios.preset_error import PresetError, is_integer
from jaxftc.scenarios.scenario import ENCODER_NOISE, PAPER_ANGLE, PAPER_TORQUE

MOST_JOINTS = 1000  # no arm has as many
Whole = Annotated[int, Strict()]


@dataclasses.dataclass(frozen=True)
class Shares(Table):
    """Shares of the conditions, 0 to 1; they add up to 1."""

    healthy: Real = 0.0
    actuator: Real = 0.0
    sensor: Real = 0.0
    both: Real = 0.0
    contact: Real = 0.0

    def __post_init__(self) -> None:
        shares = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        for name, share in shares.items():
            require_number(name, share, 0.0, 1.0)
        total = math.fsum(shares.values())
        if abs(total - 1) > 1e-9:
            terms = " + ".join(f"{name} {share:g}" for name, share in shares.items())
            raise PresetError("", f"must add up to 1, got {terms} = {total:.10g}")


@dataclasses.dataclass(frozen=True)
class Motion(Table):
    """Where a joint starts and how far it moves."""

    start_deg: Law  # deg, from the paper's start
    travel_deg: Law  # deg

    def __post_init__(self) -> None:
        require("start_deg", self.start_deg)
        require("travel_deg", self.travel_deg)


@dataclasses.dataclass(frozen=True)
class Encoder(Table):
    """The encoder without a fault."""

    noise_rad: Law = ENCODER_NOISE  # rad, standard deviation
    resolution_rad: Law = 0.0  # rad, size of a count; 0 for readings in no counts

    def __post_init__(self) -> None:
        require("noise_rad", self.noise_rad, 0.0)
        require("resolution_rad", self.resolution_rad, 0.0)

    @property
    def level(self) -> dict[str, float]:
        """What ``default_gains`` is told of readings that come in counts; of others nothing, whatever their noise."""
        if not self.in_counts:
            return {}
        return {"noise": extent(self.noise_rad)[1], "resolution": extent(self.resolution_rad)[1]}

    @property
    def in_counts(self) -> bool:
        """Whether readings can come in counts."""
        return extent(self.resolution_rad)[1] > 0.0


@dataclasses.dataclass(frozen=True)
class Joints(Table):
    """Joints at fault in a channel."""

    at_once: Whole = 1  # all joints of an arm that has fewer
    allowed: tuple[Whole, ...] | None = None  # counted from 1; all if None

    def __post_init__(self) -> None:
        if not is_integer(self.at_once) or not 1 <= self.at_once <= MOST_JOINTS:
            raise PresetError(
                "at_once",
                f"must be an integer of 1 to {MOST_JOINTS}, got {self.at_once!r}; "
                "shares.healthy is for runs without a fault",
            )
        if self.allowed is None:
            return
        if not isinstance(self.allowed, tuple) or not all(map(is_integer, self.allowed)):
            raise PresetError("allowed", f"must be a tuple of integers, got {self.allowed!r}")
        known = self.allowed and all(1 <= joint <= MOST_JOINTS for joint in self.allowed)
        if not known or len(set(self.allowed)) < len(self.allowed):
            raise PresetError("allowed", f"must be different joints, counted from 1, got {list(self.allowed)}")
        if self.at_once > len(self.allowed):
            raise PresetError(
                "at_once", f"must be at most {len(self.allowed)}, the number of allowed joints, got {self.at_once}"
            )


@dataclasses.dataclass(frozen=True)
class Incipient(Table):
    """Faults that grow to their full size."""

    share: Real  # of all faults
    rise_s: Law  # s

    def __post_init__(self) -> None:
        require_number("share", self.share, 0.0, 1.0)
        require("rise_s", self.rise_s, 0.0)


@dataclasses.dataclass(frozen=True)
class Intermittent(Table):
    """Faults that come and go."""

    share: Real  # of all faults
    period_s: Law  # s
    duty: Law  # 1, share of the period in which the fault is there

    def __post_init__(self) -> None:
        require_number("share", self.share, 0.0, 1.0)
        require("period_s", self.period_s, 0.0, above=True)
        require("duty", self.duty, 0.0, 1.0)


@dataclasses.dataclass(frozen=True)
class Times(Table):
    """When faults come, grow and go."""

    onset_s: Law  # s
    permanent: Real  # share of faults that stay
    lasting_s: Law | None = None  # s, of the others
    incipient: Incipient | None = None
    intermittent: Intermittent | None = None

    def __post_init__(self) -> None:
        require("onset_s", self.onset_s, 0.0)
        require_number("permanent", self.permanent, 0.0, 1.0)
        if self.lasting_s is not None:
            require("lasting_s", self.lasting_s, 0.0)
        elif self.permanent < 1:
            raise PresetError(
                "lasting_s", f"missing; only with permanent = 1 no fault clears, got permanent = {self.permanent:g}"
            )
        slow = self.incipient.share if self.incipient else 0.0
        coming = self.intermittent.share if self.intermittent else 0.0
        if slow + coming > 1 + 1e-9:
            raise PresetError("", f"incipient.share + intermittent.share must be at most 1, got {slow:g} + {coming:g}")


@dataclasses.dataclass(frozen=True)
class PlantLaws(Table):
    """The simulated arm over its model, 1; and what it carries."""

    mass: Law = 1.0
    damping: Law = 1.0
    coulomb: Law = 1.0
    armature: Law = 1.0
    torque_constant: Law = 1.0
    payload_kg: Law = 0.0  # kg

    def __post_init__(self) -> None:
        for name in ("mass", "armature", "torque_constant"):
            require(name, getattr(self, name), 0.0, above=True)
        for name in ("damping", "coulomb", "payload_kg"):
            require(name, getattr(self, name), 0.0)


@dataclasses.dataclass(frozen=True)
class Preset(Table):
    """Laws of scenarios. ``dataclasses.replace`` varies one, ``load_preset`` reads one from a file.

    Raises:
        ValueError: a condition that occurs has no kind of fault to draw, or a table is none.
    """

    shares: Shares
    motion: Motion
    times: Times
    actuator: ActuatorFaults = dataclasses.field(default_factory=ActuatorFaults)
    sensor: SensorFaults = dataclasses.field(default_factory=SensorFaults)
    sensor_in_both: SensorFaults | None = None  # beside an actuator fault; those of sensor if None
    encoder: Encoder = Encoder()
    joints: Joints = Joints()
    plant: PlantLaws = PlantLaws()
    contact: ContactLaw | None = None

    def __post_init__(self) -> None:
        tables = {"shares": Shares, "motion": Motion, "times": Times, "actuator": ActuatorFaults, "sensor": SensorFaults}
        for name, table in (tables | {"encoder": Encoder, "joints": Joints, "plant": PlantLaws}).items():
            if not isinstance(getattr(self, name), table):
                raise PresetError(name, f"must be {table.__name__}, got {getattr(self, name)!r}")
        shares = self.shares
        beside = "sensor" if self.sensor_in_both is None else "sensor_in_both"
        for name, share in (("actuator", shares.actuator + shares.both), ("sensor", shares.sensor), (beside, shares.both)):
            if share > 0 and not kinds(getattr(self, name)):
                raise PresetError(
                    name, f"no kind of fault, but {share:g} of all scenarios have one; add a table [{name}.bias]"
                )
        if self.contact is None and shares.contact > 0:
            raise PresetError("contact", f"missing, but {shares.contact:g} of all scenarios have one; add a table [contact]")


PAPER_ACTUATOR = ActuatorFaults(bias=TorqueBias(size=PAPER_TORQUE, unit="N m"))
PAPER_SENSOR = SensorFaults(bias=AngleBias(size=PAPER_ANGLE, unit="rad"))


@dataclasses.dataclass(frozen=True)
class Paper(Preset):
    """The paper's four conditions in turn; its laws are not used, since nothing is drawn."""

    shares: Shares = Shares(0.25, 0.25, 0.25, 0.25)
    motion: Motion = Motion(0.0, 0.0)
    times: Times = Times(0.1, 0.0, 0.15)
    actuator: ActuatorFaults = PAPER_ACTUATOR
    sensor: SensorFaults = PAPER_SENSOR

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if getattr(self, field.name) != field.default:
                raise PresetError(field.name, "the paper's conditions draw from no law; change one of another preset")
