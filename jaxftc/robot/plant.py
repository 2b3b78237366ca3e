"""The arm as a MuJoCo model to be stepped: motors in N m and the robot's own friction in place of the file's actuators."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from jaxftc import checks

if TYPE_CHECKING:
    from jaxftc.robot.model import Robot

_OTHER = ("actuators", "sensors", "keys", "tendons", "equalities", "excludes", "pairs", "geoms", "meshes")
_NUMBERS = ("body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_armature", "dof_damping")


def compiled(robot: Robot, dt: float | None) -> mujoco.MjModel:
    """``Robot.plant_model``."""
    if dt is not None:
        checks.positive("dt", dt, "seconds")
    spec, model = mujoco.MjSpec.from_string(robot.mjcf), robot.mj_model
    for name in _OTHER:  # what reads or moves the arm in another way, and shapes, which may be files that are elsewhere
        for element in list(getattr(spec, name)):
            spec.delete(element)
    spec.compiler.balanceinertia = True  # of a tensor that no solid has, until the true one is written over it
    for number, body in enumerate(spec.bodies):
        if number:
            body.explicitinertial, body.mass, body.inertia = True, model.body_mass[number], model.body_inertia[number]
            body.ipos, body.iquat, body.fullinertia = model.body_ipos[number], model.body_iquat[number], np.full(6, np.nan)
    for number, joint in enumerate(spec.joints):
        joint.name = joint.name or f"jaxftc_joint{number + 1}"
        joint.actfrclimited, joint.frictionloss = False, 0.0
        limit = robot.torque_limit[number]
        _actuator(spec, joint, joint.name, 1.0, 0.0, (-limit, limit))
    for number, joint in enumerate(spec.joints):
        positive, negative = robot.coulomb_positive[number], robot.coulomb_negative[number]
        if positive or negative:
            slope = max(positive, negative) / robot.coulomb_speed
            _actuator(spec, joint, f"{joint.name}_friction", 0.0, slope, (-positive, negative))
    plant = spec.compile()
    for name in _NUMBERS:
        getattr(plant, name)[:] = getattr(model, name)
    mujoco.mj_setConst(plant, mujoco.MjData(plant))
    if dt is not None:
        plant.opt.timestep = dt
    return plant


def _actuator(
    spec: mujoco.MjSpec, joint: mujoco.MjsJoint, name: str, gain: float, slope: float, force: tuple[float, float]
) -> None:
    """A torque gain ctrl - slope qd on a joint, N m, clipped to ``force``."""
    limited = np.isfinite(force).all()
    spec.add_actuator(
        name=name,
        target=joint.name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE if slope else mujoco.mjtBias.mjBIAS_NONE,
        gainprm=[gain, *[0.0] * 9],
        biasprm=[0.0, 0.0, -slope, *[0.0] * 7],
        forcelimited=limited,
        forcerange=force if limited else (0.0, 0.0),
    )
