"""Faults by name: each function gives a scenario one fault more, and ``Scenario`` has them all as methods.

Joints count from 1, as in presets, rows of campaigns and files. A joint has one fault a channel: another
replaces it. Sizes and times are numbers, or an array with the axes of ``scenario.id``: one a scenario of a set
with a leading axis. They may be traced; ``joint`` may not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal, TypedDict, TypeVar, Unpack

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike

from jaxftc import checks
from jaxftc.scenarios.faults import LATEST, Actuator, Fault, Sensor, common
from jaxftc.types import Array

F = TypeVar("F", bound=Callable[..., Any])
S = TypeVar("S")  # Scenario, which has these functions as methods


class Law(TypedDict, total=False):
    """How a fault comes and goes; abrupt and for good if nothing is given."""

    clear: ArrayLike  # s, when it goes; infinite if it stays
    rise: ArrayLike  # s, ramp from 0 to full size
    period: ArrayLike  # s, of an intermittent fault
    duty: ArrayLike  # 1, share of the period in which it is there


SIGNATURE = """

Args:
    scenario: One scenario, or a set with a leading axis.
    joint: Which one, from 1.{size}
    onset: When it comes, s.
    **law: ``clear`` s, ``rise`` s, ``period`` s and ``duty``, as in ``Law``.

Returns:
    The scenario with this fault.

Raises:
    ValueError: no such joint, a number that is not finite or not allowed, or scenarios on trailing axes.
"""


def _explained(size: str = "") -> Callable[[F], F]:
    """Complete a docstring with what all builders share; ``size`` explains the argument that says how large."""

    def complete(builder: F) -> F:
        builder.__doc__ = (builder.__doc__ or "") + SIGNATURE.format(size=f"\n    {size}" if size else "")
        return builder

    return complete


@_explained("torque: Added torque, N m.")
def with_actuator_bias(scenario: S, joint: int, torque: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """A torque added to the motor's."""
    return _with(scenario, "fault_tau", Actuator.BIAS, joint, torque, onset, law)


@_explained("share: Lost share of the command, 0 to 1.")
def with_actuator_loss(scenario: S, joint: int, share: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """A share of the commanded torque is lost."""
    return _with(scenario, "fault_tau", Actuator.LOSS, joint, _share(share), onset, law)


@_explained("share: Share of the limit that is left, 0 to 1.")
def with_actuator_saturation(scenario: S, joint: int, share: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """Only a share of the torque limit is left."""
    return _with(scenario, "fault_tau", Actuator.SATURATION, joint, _share(share), onset, law)


@_explained()
def with_stuck_actuator(scenario: S, joint: int, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """The torque stays what it was at onset."""
    return _with(scenario, "fault_tau", Actuator.STUCK, joint, 0.0, onset, law)


@_explained("share: Added share of the command, 1; negative for a motor that gives less.")
def with_actuator_gain(scenario: S, joint: int, share: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """The motor gives more or less than it is told."""
    return _with(scenario, "fault_tau", Actuator.GAIN, joint, share, onset, law)


@_explained("ticks: How late, the nearest whole number from 0 to 5.")
def with_actuator_delay(scenario: S, joint: int, ticks: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """The command reaches the motor late."""
    return _with(scenario, "fault_tau", Actuator.DELAY, joint, _ticks(ticks), onset, law)


@_explained("torque: Amplitude, N m; 60 periods in a turn of the joint.")
def with_torque_ripple(scenario: S, joint: int, torque: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """A torque that goes up and down with the joint's angle."""
    return _with(scenario, "fault_tau", Actuator.RIPPLE, joint, torque, onset, law)


@_explained("torque: Dry friction that is added, N m; with ``rise`` it grows.")
def with_joint_friction(scenario: S, joint: int, torque: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """The joint moves harder."""
    require_range("torque", torque, 0.0, math.inf)
    return _with(scenario, "fault_tau", Actuator.FRICTION, joint, torque, onset, law)


@_explained()
def with_locked_joint(scenario: S, joint: int, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """The joint stays where it was at onset, as in a brake that has fallen in."""
    return _with(scenario, "fault_tau", Actuator.LOCKED, joint, 0.0, onset, law)


def with_brown_out(scenario: S, share: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """The supply fails: of every torque limit only a share is left.

    Args:
        scenario: One scenario, or a set with a leading axis.
        share: Share of the limits that is left, 0 to 1.
        onset: When it comes, s.
        **law: ``clear`` s, ``rise`` s, ``period`` s and ``duty``, as in ``Law``.

    Returns:
        The scenario with a saturation of every joint.

    Raises:
        ValueError: a number that is not finite or not allowed, or scenarios on trailing axes.
    """
    for joint in range(np.shape(scenario.fault_tau.onset)[-1]):  # pyright: ignore[reportAttributeAccessIssue]
        scenario = with_actuator_saturation(scenario, joint + 1, share, onset, **law)
    return scenario


@_explained("angle: Added angle, rad.")
def with_encoder_bias(scenario: S, joint: int, angle: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """An angle added to the reading."""
    return _with(scenario, "fault_q", Sensor.BIAS, joint, angle, onset, law)


@_explained("rate: How fast it drifts, rad/s.")
def with_encoder_drift(scenario: S, joint: int, rate: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """The reading drifts off."""
    return _with(scenario, "fault_q", Sensor.DRIFT, joint, rate, onset, law)


@_explained("share: Added share of the angle, 1.")
def with_encoder_scale(scenario: S, joint: int, share: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """A share of the angle is added to the reading."""
    return _with(scenario, "fault_q", Sensor.SCALE, joint, share, onset, law)


@_explained("factor: On the encoder's noise, 1.")
def with_encoder_noise(scenario: S, joint: int, factor: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """The encoder's noise is larger."""
    require_range("factor", factor, 0.0, math.inf)
    return _with(scenario, "fault_q", Sensor.NOISE, joint, factor, onset, law)


@_explained()
def with_frozen_encoder(scenario: S, joint: int, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """The reading stays what it was at onset."""
    return _with(scenario, "fault_q", Sensor.FREEZE, joint, 0.0, onset, law)


@_explained()
def with_encoder_dropout(scenario: S, joint: int, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """There is no reading."""
    return _with(scenario, "fault_q", Sensor.DROPOUT, joint, 0.0, onset, law)


@_explained("angle: Size of a count, rad.")
def with_encoder_rounding(scenario: S, joint: int, angle: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """The reading comes in coarse counts."""
    require_range("angle", angle, 0.0, math.inf)
    return _with(scenario, "fault_q", Sensor.ROUNDING, joint, angle, onset, law)


@_explained("angle: Largest reading, rad; beyond it the reading begins anew at its negative.")
def with_encoder_wrap(scenario: S, joint: int, angle: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """The reading wraps around."""
    require_range("angle", angle, 0.0, math.inf, "be positive", above=True)
    return _with(scenario, "fault_q", Sensor.WRAP, joint, angle, onset, law)


@_explained("ticks: How late, the nearest whole number from 0 to 5.")
def with_encoder_delay(scenario: S, joint: int, ticks: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """The reading comes late."""
    return _with(scenario, "fault_q", Sensor.DELAY, joint, _ticks(ticks), onset, law)


@_explained("share: Added share of the next joint's angle, 1; the first is the last one's next.")
def with_encoder_crosstalk(scenario: S, joint: int, share: ArrayLike, onset: ArrayLike, **law: Unpack[Law]) -> S:
    """A share of another joint's angle is added to the reading."""
    return _with(scenario, "fault_q", Sensor.CROSSTALK, joint, share, onset, law)


def _with(
    scenario: Any,
    channel: Literal["fault_tau", "fault_q"],
    kind: Actuator | Sensor,
    joint: int,
    magnitude: ArrayLike,
    onset: ArrayLike,
    law: Law,
) -> Any:
    axes, shape = np.shape(scenario.id), np.shape(getattr(scenario, channel).onset)
    if shape[:-1] != axes:
        raise ValueError(
            "faults are given to one scenario or to a set with a leading axis, "
            f"got {channel} of shape {list(shape)} and id of shape {list(axes)}"
        )
    checks.integer("joint", joint, 1, f"joints count from 1 to {shape[-1]}")
    if joint > shape[-1]:
        raise ValueError(f"joint must be 1 to {shape[-1]}, got {joint}")
    checks.finite("magnitude", magnitude, "it is the size of the fault in the kind's unit")
    values = Fault(jnp.int32(kind), magnitude, **times_of(onset, law))  # pyright: ignore[reportArgumentType]
    leaves = zip(Fault._fields, getattr(scenario, channel), values, strict=True)
    given = scenario._replace(**{channel: Fault(*(_set(name, leaf, joint, value, axes) for name, leaf, value in leaves))})
    return given._replace(uncommon=()) if kind > common(type(kind)) and "uncommon" in given._fields else given


def times_of(onset: ArrayLike, law: Law) -> dict[str, Any]:
    """Onset, clearance, rise, period and duty, checked."""
    for name in law:
        checks.one_of("the law of a fault", name, tuple(Law.__annotations__))
    times: dict[str, Any] = {"onset": onset, "clear": math.inf, "rise": 0.0, "period": math.inf, "duty": 1.0, **law}
    checks.finite("onset", onset, "it is when the fault comes, in s")
    checks.finite("rise", times["rise"], "it is how long the fault grows, in s")
    for name, low, high in (("onset", 0.0, math.inf), ("rise", 0.0, math.inf), ("duty", 0.0, 1.0)):
        require_range(name, times[name], low, high)
    require_range("clear", times["clear"], onset, math.inf, "be later than the onset", above=True)
    require_range("period", times["period"], 0.0, math.inf, "be positive", above=True)
    return times


def _set(name: str, leaf: ArrayLike, joint: int, value: ArrayLike, axes: tuple[int, ...]) -> Array:
    """A leaf [..., n] with another value of a joint."""
    if np.shape(value) not in ((), axes):
        raise ValueError(f"{name} must be a number or have shape {list(axes)}, got {list(np.shape(value))}")
    leaf = jnp.asarray(leaf)
    return leaf.at[..., joint - 1].set(jnp.asarray(value, leaf.dtype))


def _ticks(value: ArrayLike) -> ArrayLike:
    require_range("ticks", value, 0.0, LATEST)
    return value


def _share(value: ArrayLike) -> ArrayLike:
    require_range("share", value, 0.0, 1.0)
    return value


def require_range(
    name: str, value: ArrayLike, low: ArrayLike, high: float, rule: str | None = None, *, above: bool = False
) -> None:
    """Refuse a value outside low..high, with ``above`` also low itself; values under a trace are not looked at."""
    if isinstance(value, Tracer) or isinstance(low, Tracer):
        return
    x = np.asarray(value)
    if not ((x > low if above else x >= low) & (x <= high)).all():
        rule = rule or (f"not be less than {low:g}" if math.isinf(high) else f"lie in [{low:g}, {high:g}]")
        raise ValueError(f"{name} must {rule}, got {x.tolist()}")
