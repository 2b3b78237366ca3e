"""The arm as a MuJoCo model to be stepped: motors in N m and the robot's own friction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from jaxftc import checks

if TYPE_CHECKING:
    from jaxftc.robot.model import Robot

NUMBERS = ("body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_armature", "dof_damping")


def compiled(robot: Robot, spec: mujoco.MjSpec, dt: float | None) -> mujoco.MjModel:
    """``Robot.plant_model`` from the robot's own spec."""
    if dt is not None:
        checks.positive("dt", dt, "seconds")
        spec.option.timestep = dt
    for number, joint in enumerate(spec.joints):
        joint.frictionloss = 0.0
        positive, negative = robot.coulomb_positive[number], robot.coulomb_negative[number]
        if positive or negative:
            slope = max(positive, negative) / robot.coulomb_speed
            spec.add_actuator(
                name=f"{joint.name}_friction",
                target=joint.name,
                trntype=mujoco.mjtTrn.mjTRN_JOINT,
                gaintype=mujoco.mjtGain.mjGAIN_FIXED,
                biastype=mujoco.mjtBias.mjBIAS_AFFINE,
                gainprm=np.zeros(10),
                biasprm=[0.0, 0.0, -slope, *[0.0] * 7],
                forcelimited=True,
                forcerange=(-positive, negative),
            )
    plant = spec.compile()
    for name in NUMBERS:  # also of a tensor that no solid has, which the compiler would refuse
        getattr(plant, name)[:] = getattr(robot.mj_model, name)
    mujoco.mj_setConst(plant, mujoco.MjData(plant))
    return plant
