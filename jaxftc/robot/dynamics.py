"""The arm's dynamics: one signature, two engines.

Equation of motion (design choice on Eq. 1, signs as in ``docs/paper.md``)::

    M(q) qdd + h(q, qd) + D qd + f_c(qd) = tau + fault_tau

M holds the reflected motor inertia, f_c is Coulomb friction smoothed by tanh; both frictions may differ by direction.
``mjx`` takes M and h from MuJoCo MJX, ``chain`` from the unrolled recursions. The plant's masses, payload, friction and
motor inertia are leaves of ``Plant``; the controller's nominal model is the robot itself and never sees them.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxftc import checks
from jaxftc.compile.box import box
from jaxftc.numerics.barrier import unstack
from jaxftc.numerics.batch import trailing
from jaxftc.robot import lanes, mjx, rigid_body
from jaxftc.robot.mass_matrix import MassMatrix
from jaxftc.robot.model import Robot
from jaxftc.types import Array

Engine = Literal["mjx", "chain"]
ENGINES: tuple[str, ...] = ("mjx", "chain")


class Plant(NamedTuple):
    """How the arm that is simulated differs from the nominal one: factors (1 is nominal) and a payload.

    Attributes:
        mass: [n, ...] 1, on the mass and inertia of each link.
        payload: [...] kg, at the tool.
        armature: [n, ...] 1, on the reflected motor inertia.
        damping: [n, ...] 1, on the viscous friction.
        coulomb: [n, ...] 1, on the Coulomb friction.
        torque_constant: [n, ...] 1, delivered torque over commanded torque.
    """

    mass: Array
    payload: Array
    armature: Array
    damping: Array
    coulomb: Array
    torque_constant: Array


def nominal_plant(robot: Robot) -> Plant:
    """The arm exactly as the model has it.

    Args:
        robot: The arm.

    Returns:
        Factors of 1 and no payload.
    """
    one = jnp.ones(robot.n)
    return Plant(mass=one, payload=jnp.zeros(()), armature=one, damping=one, coulomb=one, torque_constant=one)


def coulomb(robot: Robot, qd: Array) -> Array:
    """Coulomb friction [n, ...] N m, direction-dependent: Tc+ at high positive speed, -Tc- at high negative speed."""
    t = jnp.tanh(qd / robot.coulomb_speed)
    positive = lanes.trailing_constant(robot.coulomb_positive, qd)
    negative = lanes.trailing_constant(robot.coulomb_negative, qd)
    return 0.5 * ((positive + negative) * t + (positive - negative) * t * t)


def viscous(robot: Robot, qd: Array, damping: Array | None = None) -> Array:
    """Viscous friction [n, ...] N m: D+ qd at positive speed, D- qd at negative speed.

    ``damping`` [n, ...] stands for the mean of both, if a plant has another one; their difference scales with it.
    """
    mean = lanes.trailing_constant(robot.damping, qd) if damping is None else damping
    if np.array_equal(robot.damping_positive, robot.damping_negative):
        return mean * qd
    half = 0.5 * (robot.damping_positive - robot.damping_negative) / np.where(robot.damping > 0, robot.damping, 1.0)
    return mean * qd * (1.0 + lanes.trailing_constant(half, qd) * jnp.tanh(qd / robot.coulomb_speed))


def acceleration(robot: Robot, engine: Engine, plant: Plant, q: Array, qd: Array, tau: Array, dt: float = 0.0) -> Array:
    """Qdd [n, ...] rad/s^2 for a delivered torque; with dt > 0 viscous friction acts implicitly, as MuJoCo's Euler does."""
    plant = _align(plant, qd.ndim - 1)
    damping = plant.damping * lanes.trailing_constant(robot.damping, qd)
    armature = plant.armature * lanes.trailing_constant(robot.armature, qd)
    drive = tau - viscous(robot, qd, damping) - plant.coulomb * coulomb(robot, qd)
    if engine == "mjx":
        matrix, bias = mjx.mass_and_bias(robot, plant.mass, plant.payload, q, qd)
        mass = MassMatrix.of(matrix)
        drive = drive - bias
    else:
        at = rigid_body.pose(robot, q)
        inertias = rigid_body.scaled_inertias(robot, plant.mass, plant.payload)
        mass = rigid_body.mass_matrix(robot, inertias, at)
        drive = drive - lanes.stack(rigid_body.newton_euler(robot, inertias, at, unstack(qd), None), drive)
    return mass.plus_diagonal(unstack(armature + dt * damping)).solve(drive)


def advance(robot: Robot, engine: Engine, plant: Plant, q: Array, qd: Array, tau: Array, dt: float) -> tuple[Array, Array]:
    """(q, qd) one tick later, [n, ...] each, under a held torque [n, ...]: semi-implicit Euler, as in ``mj_step``."""
    qd_next = qd + dt * acceleration(robot, engine, plant, q, qd, tau, dt)
    return q + dt * qd_next, qd_next


def forward_dynamics(
    robot: Robot, q: Array, qd: Array, tau: Array, engine: Engine = "mjx", plant: Plant | None = None
) -> Array:
    """Joint accelerations under torques, friction included.

    Args:
        robot: The arm.
        q: [n, ...] rad, angles. Any trailing axes are configurations side by side.
        qd: [n, ...] rad/s, speeds.
        tau: [n, ...] N m, torques of the motors.
        engine: ``mjx`` or ``chain``.
        plant: How the arm differs from its model; not at all if None.

    Returns:
        [n, ...] rad/s^2.

    Raises:
        ValueError: an unknown engine, or an array whose first axis is not the joints.
    """
    checks.one_of("engine", engine, ENGINES)
    q, qd, tau = _arrays(robot, q=q, qd=qd, tau=tau)
    return acceleration(robot, engine, nominal_plant(robot) if plant is None else plant, q, qd, tau)


def inverse_dynamics(robot: Robot, q: Array, qd: Array, qdd: Array) -> Array:
    """Joint torques that give accelerations, friction included, by one Newton-Euler pass.

    Args:
        robot: The arm.
        q: [n, ...] rad, angles. Any trailing axes are configurations side by side.
        qd: [n, ...] rad/s, speeds.
        qdd: [n, ...] rad/s^2, accelerations.

    Returns:
        [n, ...] N m.

    Raises:
        ValueError: an array whose first axis is not the joints.
    """
    q, qd, qdd = _arrays(robot, q=q, qd=qd, qdd=qdd)
    return nominal_torque(robot, rigid_body.pose(robot, q), qd, qdd) + coulomb(robot, qd)


@box("Nominal arm: Newton-Euler pass")
def nominal_torque(robot: Robot, at: rigid_body.Pose, qd: Array, qdd: Array) -> Array:
    """M qdd + h + D qd [n, ...] N m of the nominal arm, Coulomb friction left out."""
    inertias = rigid_body.nominal_inertias(robot)
    links = rigid_body.newton_euler(robot, inertias, at, unstack(qd), unstack(qdd))
    motor = lanes.trailing_constant(robot.armature, qdd) * qdd + viscous(robot, qd)
    return lanes.stack(links, motor) + motor


@box("Nominal arm: a payload")
def load_torque(robot: Robot, at: rigid_body.Pose, qd: Array, qdd: Array) -> Array:
    """Torque [n, ...] N m of 1 kg at the tool, all else without mass: what a payload adds to ``nominal_torque``.

    At the same motion its outward recursion is the one of ``nominal_torque``, which the compiler shares.
    """
    bodies = rigid_body.payload_inertias(robot)
    return lanes.stack(rigid_body.newton_euler(robot, bodies, at, unstack(qd), unstack(qdd)), qdd)


@box("Nominal arm: inertia M(q)")
def nominal_mass(robot: Robot, at: rigid_body.Pose) -> MassMatrix:
    """M(q) of the nominal arm, motor inertia included."""
    links = rigid_body.mass_matrix(robot, rigid_body.nominal_inertias(robot), at)
    return links.plus_diagonal([float(armature) for armature in robot.armature])


def _align(plant: Plant, axes: int) -> Plant:
    aligned = Plant(*(trailing(leaf, 1, axes) for leaf in plant))
    return aligned._replace(payload=trailing(plant.payload, 0, axes))


def _arrays(robot: Robot, **values: Array) -> list[Array]:
    arrays = [jnp.asarray(value) for value in values.values()]
    for name, value in zip(values, arrays, strict=True):
        checks.joints_first(name, value, robot.n)
    checks.same_shape(list(values), arrays)
    dtype = jnp.result_type(*arrays, np.float32)
    return [value.astype(dtype) for value in arrays]
