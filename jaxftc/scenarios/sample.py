"""Scenarios drawn from a preset's laws, each a function of the key and of its id alone.

Scenario ``id`` is drawn with ``fold_in(key, id)``, so it does not depend on how many are drawn, in which order or chunk. Its
uniform numbers are dealt in a fixed order, also those for kinds of fault that the preset does not have: a law that changes
changes no other draw. What is new is dealt last, so that a preset draws today what it drew before.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc import checks
from jaxftc.compile.jit import jit
from jaxftc.config import Config
from jaxftc.robot.dynamics import Plant
from jaxftc.scenarios import contact
from jaxftc.scenarios.contact import Contact
from jaxftc.scenarios.distributions import Law, scaled
from jaxftc.scenarios.faults import (
    UNITS,
    Actuator,
    ActuatorFaults,
    Fault,
    Kind,
    Sensor,
    SensorFaults,
    Signed,
    Sized,
    common,
    kinds,
)
from jaxftc.scenarios.preset import Encoder, Paper, Preset, Times
from jaxftc.scenarios.preset_file import load_preset
from jaxftc.scenarios.reference import within_range
from jaxftc.scenarios.scenario import CONDITIONS, Scenario, paper_motion, paper_scenario, stack
from jaxftc.scenarios.uniforms import DEALT, UniformStream
from jaxftc.types import Array

DEG = math.radians(1.0)  # rad
CONTACT, RESOLUTION = 300, 301  # numbers of the streams that those are dealt from; kinds of fault have the ones below


def sample_scenarios(key: Array, n: int, preset: str | Path | Preset = "standard", *, config: Config) -> Scenario:
    """Draw n scenarios from a preset's laws.

    Args:
        key: A random key, such as ``jax.random.key(0)``.
        n: How many.
        preset: A name, the path of a preset file, or a ``Preset``. ``paper`` deals the paper's four
            conditions in turn and draws nothing.
        config: Robot and timing.

    Returns:
        Scenarios with a leading axis, ids 0 to n - 1.

    Raises:
        ValueError: an unknown preset, a preset file that is not right, n below 1, a key that is none, or a preset that does
            not fit the arm.
    """
    laws = load_preset(preset)
    checks.random_key("key", key)
    checks.integer("n", n, 1, "it is the number of scenarios")
    check_arm(laws, config, "the preset" if isinstance(preset, Preset) else f"preset {str(preset)!r}")
    return _draw_all(laws, config, key, jnp.arange(n, dtype=jnp.int32))


def draw_all(preset: Preset, config: Config, key: Array, ids: Array) -> Scenario:
    """Draw the scenarios of some ids [...] int32; the leaves of the result have the axes of ids first.

    Each depends on its id and the key alone. Under ``jax.jit``, preset and config are static.

    Raises:
        ValueError: the preset does not fit the arm.
    """
    check_arm(preset, config, "the preset")
    return _draw_all(preset, config, key, jnp.asarray(ids, jnp.int32))


def check_arm(preset: Preset, config: Config, name: str) -> None:
    """Refuse a preset that the arm cannot have: joints that are not there, faults of torque limits that are not there.

    Raises:
        ValueError: starting with ``name``, what came and what to do.
    """
    allowed = preset.joints.allowed
    if allowed is not None and max(allowed) > config.n:
        raise ValueError(f"{name}: joints.allowed: {config.robot.name!r} has joints 1 to {config.n}, got {list(allowed)}")
    links = None if preset.contact is None else preset.contact.links
    if links is not None and max(links) > config.n:
        raise ValueError(f"{name}: contact.links: {config.robot.name!r} has links 1 to {config.n}, got {list(links)}")
    if isinstance(preset, Paper) or preset.shares.actuator + preset.shares.both == 0:
        return
    drawn = kinds(preset.actuator).items()
    by_limit = [kind for kind, law in drawn if kind == "saturation" or getattr(law, "unit", "") == "limit"]
    if by_limit and not np.isfinite(config.robot.torque_limit[_allowed(preset, config)]).all():
        raise ValueError(
            f"{name} sizes faults by torque limits (actuator.{', actuator.'.join(by_limit)}), {config.robot.name!r} has "
            f"{config.robot.torque_limit.tolist()} N m; give every joint torque_limit_nm in an arm.toml (or in the file), "
            'take a preset without saturation and with unit = "N m" for the others, or build Scenario yourself'
        )


def _draw_all(preset: Preset, config: Config, key: Array, ids: Array) -> Scenario:
    if isinstance(preset, Paper):
        four = stack([paper_scenario(condition, config) for condition in CONDITIONS])
        return jax.tree.map(lambda leaf: leaf[ids % len(CONDITIONS)], four)._replace(id=ids, uncommon=None)
    drawn = jax.vmap(lambda i: draw(preset, config, jax.random.fold_in(key, i), i))(ids.reshape(-1))
    return jax.tree.map(lambda leaf: leaf.reshape(*ids.shape, *leaf.shape[1:]), drawn)


_draw_all = jit(_draw_all, static_argnums=(0, 1))


def draw(preset: Preset, config: Config, key: Array, scenario_id: Array) -> Scenario:
    """One scenario from its own key."""
    n = config.n
    stream = UniformStream(key, 27 + 9 * n)
    condition = jnp.searchsorted(_bounds(preset), stream.number(), side="right")
    q_start = paper_motion(config)[0] + stream(scaled(preset.motion.start_deg, DEG), (n,))
    q_goal = q_start + stream(scaled(preset.motion.travel_deg, DEG), (n,))
    q_start, q_goal = within_range(config.robot, q_start, q_goal)
    law = _times(preset.times, stream)
    limit = np.where(np.isfinite(config.robot.torque_limit), config.robot.torque_limit, 0.0)
    torque = _channel(preset.actuator, Actuator, stream, limit)
    beside = preset.sensor if preset.sensor_in_both is None else preset.sensor_in_both
    angles = [_channel(faults, Sensor, stream, limit) for faults in (preset.sensor, beside)]
    angle = jnp.where(condition == 3, angles[1], angles[0])
    choose = functools.partial(stream.joints, preset.joints.at_once, _allowed(preset, config), n)
    tau_joints, q_joints = choose(), choose()
    plant = preset.plant
    mass, damping, coulomb = (stream(factor, (n,)) for factor in (plant.mass, plant.damping, plant.coulomb))
    payload, noise = stream(plant.payload_kg), stream(preset.encoder.noise_rad)
    armature, torque_constant = stream(plant.armature, (n,)), stream(plant.torque_constant, (n,))
    return Scenario(
        id=scenario_id,
        q_start=q_start,
        q_goal=q_goal,
        noise=noise,
        fault_tau=_fault(torque, tau_joints & ((condition == 1) | (condition == 3)), law),
        fault_q=_fault(angle, q_joints & ((condition == 2) | (condition == 3)), law),
        plant=Plant(mass, payload, armature, damping, coulomb, torque_constant),
        contact=_contact(preset, n, stream, condition == 4, law),
        uncommon=_uncommon(preset),
        resolution=_resolution(preset.encoder, stream),
    )


def _allowed(preset: Preset, config: Config) -> list[int]:
    """Joints that can be at fault, counted from 0."""
    allowed = preset.joints.allowed
    return list(range(config.n)) if allowed is None else sorted(joint - 1 for joint in allowed)


def _bounds(preset: Preset) -> Array:
    """Upper ends [4] of healthy, actuator, sensor and both on 0..1."""
    shares = list(dataclasses.astuple(preset.shares))
    nothing_after = np.array([not any(shares[k + 1 :]) for k in range(4)])
    ends = jnp.append(jnp.cumsum(jnp.asarray(shares[:3])), 1 - shares[4])
    return jnp.where(nothing_after, 1.0, ends)  # a sum can end just below 1


def _channel(faults: ActuatorFaults | SensorFaults, codes: type[Kind], stream: UniformStream, limit: np.ndarray) -> Array:
    """(kind, magnitude [n]) of a channel's fault as one array [1 + n]: all sizes are drawn, the kind's own is taken."""
    kind, side = stream.kind(kinds(faults), codes), stream.side()
    sizes = {code: jnp.zeros(len(limit)) for code in codes}
    for field in dataclasses.fields(faults):  # in the order of draws
        code, law = codes[field.name.upper()], getattr(faults, field.name)
        if code.unit and (law is not None or code <= DEALT[codes]):
            sizes[code] = _size(law, side, stream.of_kind(code), limit)
    return jnp.concatenate([kind[None].astype(float), jnp.select([kind == code for code in sizes], [*sizes.values()])])


def _size(fault: Sized | None, side: Array, numbers: Callable[[Law], Array], limit: np.ndarray) -> Array:
    """The size [n] of a kind of fault, in rad, rad/s, N m or 1; zero, from a number all the same, if it does not occur."""
    size = numbers(0.0 if fault is None else scaled(fault.size, UNITS[fault.unit]))
    size = side * size if isinstance(fault, Signed) and fault.sign == "random" else size
    return size * jnp.asarray(limit if fault is not None and fault.unit == "limit" else np.ones_like(limit), float)


def _times(times: Times, stream: UniformStream) -> dict[str, Array]:
    """Onset, clearance, rise, period and duty of one scenario; both channels share them."""
    slow, coming = times.incipient, times.intermittent
    onset = stream(times.onset_s)
    stays, lasting = stream.number() < times.permanent, stream(0.0 if times.lasting_s is None else times.lasting_s)
    u, rise = stream.number(), stream(slow.rise_s if slow else 0.0)
    period, duty = stream(coming.period_s if coming else math.inf), stream(coming.duty if coming else 1.0)
    ramp = slow.share if slow else 0.0
    comes_and_goes = (u >= ramp) & (u < ramp + (coming.share if coming else 0.0))
    return {
        "onset": onset,
        "clear": jnp.where(stays, jnp.inf, onset + lasting),
        "rise": jnp.where(u < ramp, rise, 0.0),
        "period": jnp.where(comes_and_goes, period, jnp.inf),
        "duty": jnp.where(comes_and_goes, duty, 1.0),
    }


def _contact(preset: Preset, n: int, stream: UniformStream, there: Array, law: dict[str, Array]) -> Contact | None:
    """The drawn contact where it is ``there``, from numbers of its own; None if the preset never has one."""
    if preset.contact is None or preset.shares.contact == 0:
        return None
    links = preset.contact.links or range(1, n + 1)
    return contact.draw(preset.contact, stream.apart(CONTACT, 8), list(links), there, law)


def _resolution(encoder: Encoder, stream: UniformStream) -> Array | None:
    """The size of a count, from a number of its own; None if readings never come in counts."""
    return stream.apart(RESOLUTION, 1)(encoder.resolution_rad) if encoder.in_counts else None


def _uncommon(preset: Preset) -> tuple[()] | None:
    """None if the preset has common kinds of fault only."""
    channels = ((preset.actuator, Actuator), (preset.sensor, Sensor), (preset.sensor_in_both or preset.sensor, Sensor))
    some = any(codes[name.upper()] > common(codes) for channel, codes in channels for name in kinds(channel))
    return () if some else None


def _fault(drawn: Array, joints: Array, law: dict[str, Array]) -> Fault:
    """The drawn fault on some joints [n], none on the others."""
    return Fault(
        kind=jnp.where(joints, drawn[0], 0).astype(jnp.int32),
        magnitude=jnp.where(joints, drawn[1:], 0.0),
        **{name: jnp.broadcast_to(value, joints.shape) for name, value in law.items()},
    )
