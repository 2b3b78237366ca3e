"""From MJCF to ``Tree``, by MuJoCo's own compiler; what has nothing to do with an arm's mechanics is taken out before.

Shapes are compiled only where a body takes its mass from them, so other meshes may be missing.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from jaxftc.robot.tree import HINGE, SLIDE, Body, Joint, Place, Tree

KINDS = {int(mujoco.mjtJoint.mjJNT_HINGE): HINGE, int(mujoco.mjtJoint.mjJNT_SLIDE): SLIDE}
JOINT_DRIVES = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
IDLE = (
    "keys",
    "sensors",
    "tuples",
    "texts",
    "pairs",
    "excludes",
    "skins",
    "flexes",
    "equalities",
    "tendons",
    "cameras",
    "lights",
)


def read(spec: mujoco.MjSpec) -> Tree:
    """The tree of a model.

    Raises:
        ValueError: MuJoCo cannot compile it, or it holds what is not modelled here.
    """
    name_all(spec)
    follows = {
        e.name1: (e.name2, float(e.data[1]), float(e.data[0]))
        for e in spec.equalities
        if e.type == mujoco.mjtEq.mjEQ_JOINT and e.active and e.name2
    }
    by_shape = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    _take_out(spec, by_shape)
    lost = _shapes(spec, by_shape)
    odd = {} if by_shape or spec.compiler.balanceinertia else _odd_inertias(spec)
    spec.compiler.fusestatic, spec.memory = False, -1  # bodies keep their names; as much memory as it takes
    try:
        with warnings.catch_warnings():  # about inertias, which are judged when the arm is known
            warnings.simplefilter("ignore")
            model = spec.compile()
    except ValueError as error:
        raise ValueError(f"does not compile: {error}") from error
    if model.opt.density or model.opt.viscosity:
        raise ValueError("air or water (option density, viscosity) is not modelled here; remove it")
    if np.any(model.jnt_stiffnesspoly) or np.any(model.dof_dampingpoly):
        raise ValueError("springs or damping of higher order are not modelled here; give one number for each")
    drives = _drives(model)
    bodies = [_body(model, b, follows, drives) for b in range(1, model.nbody)]
    for k, body in enumerate(bodies):
        if body.name in odd:
            mass, inertia = odd[body.name]
            axes = _rotation(model.body_iquat[k + 1])
            bodies[k] = body._replace(mass=mass, inertia=axes @ inertia @ axes.T)
        elif body.name in lost:
            bodies[k] = body._replace(refused=lost[body.name])
    sites = {
        model.site(s).name: Place(int(model.site_bodyid[s]) - 1, model.site_pos[s].copy(), _rotation(model.site_quat[s]))
        for s in range(model.nsite)
        if model.site(s).name
    }
    weightless = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    return Tree(tuple(bodies), sites, np.zeros(3) if weightless else model.opt.gravity.copy())


def name_all(spec: mujoco.MjSpec) -> None:
    """Give bodies and joints without a name their number."""
    for kind, elements in (("body", spec.bodies[1:]), ("joint", spec.joints)):
        for number, element in enumerate(elements, 1):
            element.name = element.name or f"{kind}{number}"


def _take_out(spec: mujoco.MjSpec, by_shape: bool) -> None:
    """Everything but bodies, joints, sites, drives of joints, and shapes that weigh something."""
    for kind in IDLE:
        for element in list(getattr(spec, kind)):
            spec.delete(element)
    for actuator in list(spec.actuators):
        if actuator.trntype not in JOINT_DRIVES:
            spec.delete(actuator)
    for geom in list(spec.geoms):
        if not _moves(geom.parent) or (geom.parent.explicitinertial and not by_shape):
            spec.delete(geom)
        else:
            geom.material, geom.contype, geom.conaffinity = "", 0, 0
    for site in spec.sites:
        site.material = ""


def _moves(body: Any) -> bool:
    """Whether the body or one above it has a joint."""
    while body is not None:
        if body.joints:
            return True
        body = body.parent
    return False


def _shapes(spec: mujoco.MjSpec, by_shape: bool) -> dict[str, str]:
    """Take out meshes that weigh nothing or are not there; of the latter, by body, why it has no mass."""
    folder = Path(spec.modelfiledir, spec.meshdir)
    files = {mesh.name or Path(mesh.file).stem: folder / mesh.file for mesh in spec.meshes if mesh.file}
    gone = {name for name, file in files.items() if not file.is_file() and file.name not in spec.assets}
    lost: dict[str, str] = {}
    for geom in list(spec.geoms):
        if geom.meshname in gone:
            if geom.mass != 0 and geom.density != 0:
                lost[geom.parent.name] = f"takes its mass from {files[geom.meshname]}, which is not there; add <inertial>"
            spec.delete(geom)
    used = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if (mesh.name or Path(mesh.file).stem) in used:
            mesh.material = ""
        else:
            spec.delete(mesh)
    for kind in ("materials", "textures", "hfields"):
        for element in list(getattr(spec, kind)):
            spec.delete(element)
    for name in lost:  # something that compiles
        body = spec.body(name)
        body.explicitinertial, body.mass, body.inertia = True, 1.0, np.ones(3)
    return lost


def _odd_inertias(spec: mujoco.MjSpec) -> dict[str, tuple[float, np.ndarray]]:
    """Mass and inertia [3, 3], in the axes of the inertial frame, that MuJoCo would refuse; legal ones take their place.

    Whether the arm can have them is decided when the arm is known.
    """
    found: dict[str, tuple[float, np.ndarray]] = {}
    for body in spec.bodies[1:]:
        if not body.explicitinertial:
            if not body.geoms and body.joints:  # MuJoCo lets nothing without a mass move
                found[body.name] = (0.0, np.zeros((3, 3)))
                body.explicitinertial, body.mass, body.inertia = True, 1.0, np.ones(3)
            continue
        full = np.asarray(body.fullinertia)
        xx, yy, zz, xy, xz, yz = (*body.inertia, 0.0, 0.0, 0.0) if np.isnan(full[0]) else full
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        moments = np.linalg.eigvalsh(inertia) if np.isfinite(inertia).all() else np.full(3, -1.0)
        legal = moments[0] > 1e-14 and moments[0] + moments[1] >= moments[2]
        if not (legal and 1e-14 < body.mass < np.inf):
            found[body.name] = (float(body.mass), inertia)
            body.mass, body.inertia, body.fullinertia = 1.0, np.ones(3), np.array([np.nan, 0, 0, 0, 0, 0])
    return found


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """Rotation [3, 3] of a quaternion [4], w first."""
    flat = np.zeros(9)
    mujoco.mju_quat2Mat(flat, quaternion)
    return flat.reshape(3, 3)


def _body(model: mujoco.MjModel, b: int, follows: dict[str, tuple[str, float, float]], drives: list[dict[str, Any]]) -> Body:
    first = int(model.body_jntadr[b])
    axes = _rotation(model.body_iquat[b])
    return Body(
        name=model.body(b).name,
        parent=int(model.body_parentid[b]) - 1,
        position=model.body_pos[b].copy(),
        rotation=_rotation(model.body_quat[b]),
        joints=tuple(_joint(model, j, follows, drives[j]) for j in range(first, first + int(model.body_jntnum[b]))),
        mass=float(model.body_mass[b]),
        com=model.body_ipos[b].copy(),
        inertia=axes @ np.diag(model.body_inertia[b]) @ axes.T,
        has_inertia=bool(model.body_mass[b] > 0),
        has_shape=bool(model.body_geomnum[b]),
        gravcomp=bool(model.body_gravcomp[b]),
    )


def _joint(model: mujoco.MjModel, j: int, follows: dict[str, tuple[str, float, float]], drive: dict[str, Any]) -> Joint:
    kind, name = int(model.jnt_type[j]), model.joint(j).name
    if kind not in KINDS:
        word = mujoco.mjtJoint(kind).name.removeprefix("mjJNT_").lower()
        return Joint(name, word, np.zeros(3), np.zeros(3), spring=bool(model.jnt_stiffness[j]))
    dof, low, high = int(model.jnt_dofadr[j]), -np.inf, np.inf
    if model.jnt_limited[j]:
        low, high = (float(x) for x in model.jnt_range[j])
    by_direction = model.jnt_user[j, :2] if model.nuser_jnt >= 2 else np.repeat(model.dof_frictionloss[dof], 2)
    return Joint(
        name=name,
        kind=KINDS[kind],
        axis=model.jnt_axis[j].copy(),
        anchor=model.jnt_pos[j].copy(),
        zero=float(model.qpos0[model.jnt_qposadr[j]]),
        low=low,
        high=high,
        torque_limit=drive["limit"],
        armature=float(model.dof_armature[dof]) + drive["armature"],
        damping=float(model.dof_damping[dof]) + drive["damping"],
        coulomb=(float(by_direction[0]), float(by_direction[1])),
        follows=follows.get(name),
        spring=bool(model.jnt_stiffness[j]),
        remarks=tuple(drive["remarks"]),
    )


def _drives(model: mujoco.MjModel) -> list[dict[str, Any]]:
    """What actuators and force range give each joint: largest torque, infinite where there is none, armature, damping.

    An actuator's force range counts, and for a plain motor its control range too (of a servo that is an angle). Of an
    asymmetric range the smaller side counts; a range on one side of zero is of a motor that pulls one way.
    """
    drives: list[dict[str, Any]] = []
    for j in range(model.njnt):
        drives.append({"limit": np.inf, "armature": 0.0, "damping": 0.0, "remarks": []})
        if model.jnt_actfrclimited[j]:
            _limit(model.joint(j).name, drives[j], 1.0, model.jnt_actfrcrange[j], "actuatorfrcrange")
    for a in range(model.nu):
        j, gear = int(model.actuator_trnid[a, 0]), abs(float(model.actuator_gear[a, 0]))
        name = model.joint(j).name
        drives[j]["armature"] += gear**2 * float(model.actuator_armature[a])
        drives[j]["damping"] += gear**2 * float(model.actuator_damping[a])
        if model.actuator_forcelimited[a]:
            _limit(name, drives[j], gear, model.actuator_forcerange[a], "forcerange")
        if model.actuator_ctrllimited[a] and model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE:
            _limit(
                name, drives[j], gear * abs(float(model.actuator_gainprm[a, 0])), model.actuator_ctrlrange[a], "ctrlrange"
            )
    return drives


def _limit(joint: str, drive: dict[str, Any], scale: float, bounds: np.ndarray, key: str) -> None:
    low, high = (scale * float(x) for x in bounds)
    smaller, larger = sorted((abs(low), abs(high)))
    if low < 0 < high:
        drive["limit"] = min(drive["limit"], smaller)
    elif larger > 0:
        drive["limit"] = min(drive["limit"], larger)
        drive["remarks"].append(
            f"joint {joint!r} has the {key} {low:g} to {high:g} N m, on one side of zero: {larger:g} N m taken both ways"
        )
    else:
        drive["remarks"].append(f"joint {joint!r} has the {key} 0 to 0, a placeholder: taken as no limit")
