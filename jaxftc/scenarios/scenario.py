"""Scenarios: one motion, its faults and how the arm differs from its model; a batch has a leading axis.

``paper`` is the paper's experiment, Eqs. (36) to (39): healthy, actuator, sensor, both, on all joints from 0.1 to 0.25 s,
with an exact model. The paper prints the actuator fault in degrees and the sensor fault in N m; an actuator fault is a
torque and an encoder fault an angle, so the units are swapped here and the magnitudes kept.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxftc import checks
from jaxftc.config import Config
from jaxftc.robot.dynamics import Plant, nominal_plant
from jaxftc.scenarios import builders
from jaxftc.scenarios import contact as contacts
from jaxftc.scenarios.contact import Contact, no_contact
from jaxftc.scenarios.faults import Actuator, Fault, Sensor, no_fault
from jaxftc.scenarios.reference import PAPER_GOAL, PAPER_START, within_range
from jaxftc.types import Array

CONDITIONS = ("healthy", "actuator", "sensor", "both")
ENCODER_NOISE = 3e-5  # rad, standard deviation
PAPER_TORQUE, PAPER_ANGLE = 5.0, math.radians(1.5)  # N m and rad, Eqs. (37), (38) with their units swapped
PAPER_WINDOW = (0.1, 0.25)  # s


class Scenario(NamedTuple):
    """Everything that differs from run to run; ``with_...`` adds a fault (``jaxftc.scenarios.builders``).

    Attributes:
        id: [...] int32; the noise depends on the key and on this, not on the place in a batch.
        q_start: [n, ...] rad.
        q_goal: [n, ...] rad.
        noise: [...] rad, standard deviation of the encoder.
        fault_tau: Faults of the actuators.
        fault_q: Faults of the encoders.
        plant: How the arm differs from its model.
        contact: A force on a link; None where no scenario of a set has one: their programs are smaller and faster.
        uncommon: () where faults may be of any kind; None where all are of the common ones, bias, loss and a stuck motor,
            bias, drift, scale, freeze and noise of an encoder: those programs are smaller and faster, too.
        resolution: [...] rad, size of the counts in which all readings come, 0 for none; None where no scenario of a set
            has any.
    """

    id: Array
    q_start: Array
    q_goal: Array
    noise: Array
    fault_tau: Fault
    fault_q: Fault
    plant: Plant
    contact: Contact | None = None
    uncommon: tuple[()] | None = ()
    resolution: Array | None = None

    with_contact = contacts.with_contact
    with_actuator_bias = builders.with_actuator_bias
    with_actuator_loss = builders.with_actuator_loss
    with_actuator_saturation = builders.with_actuator_saturation
    with_stuck_actuator = builders.with_stuck_actuator
    with_actuator_gain = builders.with_actuator_gain
    with_actuator_delay = builders.with_actuator_delay
    with_torque_ripple = builders.with_torque_ripple
    with_joint_friction = builders.with_joint_friction
    with_locked_joint = builders.with_locked_joint
    with_brown_out = builders.with_brown_out
    with_encoder_bias = builders.with_encoder_bias
    with_encoder_drift = builders.with_encoder_drift
    with_encoder_scale = builders.with_encoder_scale
    with_encoder_noise = builders.with_encoder_noise
    with_frozen_encoder = builders.with_frozen_encoder
    with_encoder_dropout = builders.with_encoder_dropout
    with_encoder_rounding = builders.with_encoder_rounding
    with_encoder_wrap = builders.with_encoder_wrap
    with_encoder_delay = builders.with_encoder_delay
    with_encoder_crosstalk = builders.with_encoder_crosstalk


def healthy_scenario(
    config: Config,
    *,
    q_start: ArrayLike | None = None,
    q_goal: ArrayLike | None = None,
    noise: float = ENCODER_NOISE,
    resolution: float | None = None,
    scenario_id: int = 0,
) -> Scenario:
    """A motion without a fault, of an arm that is as its model; its ``with_...`` methods add faults.

    Args:
        config: The arm and how it is run.
        q_start: [n] rad, where the motion starts; the paper's, or the zero position of an arm that has not six joints, moved
            into the joints' ranges.
        q_goal: [n] rad, where it ends; the paper's, or one radian from the zero position, moved into the ranges.
        noise: Standard deviation of the encoders, rad.
        resolution: Size of the counts in which the encoders read, rad; none if not given.
        scenario_id: The encoders' noise depends on the key and on this number.

    Returns:
        One scenario.

    Raises:
        ValueError: angles that are not n finite numbers, or noise or resolution that is negative or not finite.
    """
    checks.instance("config", config, Config)
    start, goal = paper_motion(config)
    start = start if q_start is None else _angles("q_start", q_start, config.n)
    goal = goal if q_goal is None else _angles("q_goal", q_goal, config.n)
    for name, value in (("noise", noise), ("resolution", resolution or 0.0)):
        if isinstance(value, bool) or not (math.isfinite(value) and value >= 0):
            raise ValueError(f"{name} must be finite and not negative, in rad, got {value!r}")
    return Scenario(
        id=jnp.asarray(scenario_id, jnp.int32),
        q_start=start,
        q_goal=goal,
        noise=jnp.asarray(noise, float),
        fault_tau=no_fault(config.n),
        fault_q=no_fault(config.n),
        plant=nominal_plant(config.robot),
        resolution=None if resolution is None else jnp.asarray(resolution, float),
    )


def _angles(name: str, value: ArrayLike, n: int) -> Array:
    """Angles [n] rad, checked."""
    if np.shape(value) != (n,):
        raise ValueError(f"{name} must have shape [{n}], an angle in rad a joint, got {list(np.shape(value))}")
    checks.finite(name, value, "angles are in rad")
    return jnp.asarray(value, float)


def paper_scenario(
    condition: str, config: Config, *, torque: float = PAPER_TORQUE, angle: float = PAPER_ANGLE, scenario_id: int = 0
) -> Scenario:
    """One of the paper's four conditions.

    The plant is the robot as the config has it: for the paper's arm, without Coulomb friction, give puma560(coulomb=False).
    An arm that does not have six joints moves each by one radian from its zero position instead of the paper's motion.
    Either motion is moved into the ranges of the arm's joints.

    Args:
        condition: ``healthy``, ``actuator``, ``sensor`` or ``both``.
        config: Robot and timing.
        torque: N m, size of the actuator fault.
        angle: rad, size of the encoder fault.
        scenario_id: Of its noise.

    Returns:
        One scenario, faults on every joint from 0.1 to 0.25 s.

    Raises:
        ValueError: an unknown condition.
    """
    checks.one_of("condition", condition, CONDITIONS)
    n, healthy = config.n, no_fault(config.n)

    def bias(kind: int, size: float) -> Fault:
        leaves = {"kind": jnp.asarray(kind, jnp.int32), "magnitude": jnp.asarray(size, float)}
        leaves |= {"onset": jnp.asarray(PAPER_WINDOW[0], float), "clear": jnp.asarray(PAPER_WINDOW[1], float)}
        return healthy._replace(**{name: jnp.broadcast_to(leaf, (n,)) for name, leaf in leaves.items()})

    return healthy_scenario(config, scenario_id=scenario_id)._replace(
        fault_tau=bias(Actuator.BIAS, torque) if condition in ("actuator", "both") else healthy,
        fault_q=bias(Sensor.BIAS, angle) if condition in ("sensor", "both") else healthy,
    )


def paper_motion(config: Config) -> tuple[Array, Array]:
    """Start and goal [n] rad: the paper's for six joints, otherwise one radian from the zero position; within the ranges."""
    six = config.n == len(PAPER_START)
    start, goal = (PAPER_START, PAPER_GOAL) if six else (config.robot.q_zero, config.robot.q_zero + 1.0)
    return within_range(config.robot, jnp.asarray(start, float), jnp.asarray(goal, float))


def stack(scenarios: list[Scenario]) -> Scenario:
    """Scenarios as one with a leading axis."""
    if any(scenario.contact for scenario in scenarios):
        scenarios = [scenario._replace(contact=scenario.contact or no_contact()) for scenario in scenarios]
    if any(scenario.uncommon is not None for scenario in scenarios):
        scenarios = [scenario._replace(uncommon=()) for scenario in scenarios]
    if any(scenario.resolution is not None for scenario in scenarios):
        zero = jnp.zeros_like(scenarios[0].noise)
        sizes = [zero if scenario.resolution is None else scenario.resolution for scenario in scenarios]
        scenarios = [scenario._replace(resolution=size) for scenario, size in zip(scenarios, sizes, strict=True)]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenarios)


def trail(scenarios: Scenario) -> Scenario:
    """From a leading scenario axis, as sampled, to a trailing one, as simulated."""
    return jax.tree.map(lambda leaf: (np if isinstance(leaf, np.ndarray) else jnp).moveaxis(leaf, 0, -1), scenarios)


def take(scenarios: Scenario, rows: np.ndarray | slice) -> Scenario:
    """Some of a set with a leading axis, as NumPy arrays."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[rows], scenarios)
