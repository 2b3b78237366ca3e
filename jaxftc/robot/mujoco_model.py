"""An arm as a MuJoCo model: the chain alone, and the plant of somebody's own control loop.

Contacts, joint limits and dry friction as MuJoCo constraints are switched off: they bring a solver loop that has no
reverse mode. Dry friction becomes a smooth torque, Coulomb times tanh of speed, in both engines.
"""

from __future__ import annotations

import mujoco
import numpy as np

from jaxftc import checks
from jaxftc.robot.chain import TOOL
from jaxftc.robot.link import inertial
from jaxftc.robot.numbers import Numbers

PAYLOAD = "jaxftc_payload"  # massless body at the tool, so that a payload is one mass leaf in both engines
NUMBERS = ("body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_armature", "dof_damping")


def mujoco_model(robot: Numbers) -> mujoco.MjModel:
    """The compiled model; a link that no body can be is refused by the compiler, so it is written over another."""
    model = mujoco_spec(robot).compile()
    odd = [(j, *found[:3]) for j, found in enumerate(map(inertial, robot.links)) if not found[3]]
    for j, mass, com, inertia in odd:
        moments, axes = np.linalg.eigh(inertia)
        axes = axes * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))])
        model.body_mass[j + 1], model.body_ipos[j + 1], model.body_inertia[j + 1] = mass, com, moments
        model.body_iquat[j + 1] = _quaternion(axes)
    if odd:
        mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def mujoco_spec(robot: Numbers) -> mujoco.MjSpec:
    """A body and a motor for each hinge, the site ``tool`` and the payload's body at the tool."""
    spec = mujoco.MjSpec()
    spec.modelname, spec.compiler.degree, spec.option.gravity = robot.name, False, robot.gravity
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    body = spec.worldbody
    for j, link in enumerate(robot.links):
        mass, com, inertia, legal = inertial(link)
        full = inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
        of_body = {"fullinertia": full} if legal else {"inertia": np.full(3, 1e-3)}
        of_body |= {"mass": mass if mass > 1e-12 else 1.0, "ipos": com}
        body = body.add_body(
            name=robot.link_names[j], pos=link.offset, quat=_quaternion(link.rotation), explicitinertial=True, **of_body
        )
        joint = body.add_joint(
            name=robot.joint_names[j],
            axis=(0, 0, 1),
            ref=robot.q_zero[j],
            armature=robot.armature[j],
            frictionloss=0.5 * (robot.coulomb_positive[j] + robot.coulomb_negative[j]),
        )
        joint.damping[0] = robot.damping[j]
        if np.isfinite([robot.q_low[j], robot.q_high[j]]).all():
            joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, (robot.q_low[j], robot.q_high[j])
        motor = spec.add_actuator(target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        if np.isfinite(robot.torque_limit[j]):
            motor.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
            motor.ctrlrange = (-robot.torque_limit[j], robot.torque_limit[j])
    body.add_body(name=PAYLOAD, pos=robot.payload_link.moment, ipos=np.zeros(3), explicitinertial=True)
    body.add_site(name=TOOL, pos=robot.payload_link.moment, quat=_quaternion(robot.payload_link.rotation))
    return spec


def plant_model(robot: Numbers, model: mujoco.MjModel, dt: float | None) -> mujoco.MjModel:
    """The arm to be stepped: motors in N m and the robot's own friction; links as in its ``model``."""
    spec = mujoco_spec(robot)
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
        getattr(plant, name)[:] = getattr(model, name)
    mujoco.mj_setConst(plant, mujoco.MjData(plant))
    return plant


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    """Quaternion [4], w first, of a rotation [3, 3]."""
    found = np.zeros(4)
    mujoco.mju_mat2Quat(found, np.ravel(rotation))
    return found
