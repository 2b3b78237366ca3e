"""From MJCF or URDF to ``Robot``: a compiled MuJoCo model, and the serial chain of hinges read out of it.

Contacts, joint limits and dry friction as MuJoCo constraints are switched off: they bring a solver loop that has no
reverse mode. Dry friction becomes a smooth torque, Coulomb times tanh of speed, in both engines.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from jaxftc.robot import plant

PAYLOAD = "jaxftc_payload"  # massless body at the tool, so that a payload is one mass leaf in both engines


@dataclasses.dataclass(frozen=True, eq=False)
class Link:
    """One hinge and what it carries, in the frame at the hinge whose z axis is the hinge."""

    rotation: np.ndarray  # [3, 3] this frame at zero angle, in the frame of the hinge before
    offset: np.ndarray  # [3] m, this origin in the frame of the hinge before
    mass: float  # kg
    moment: np.ndarray  # [3] kg m, mass times centre of mass
    inertia: np.ndarray  # [3, 3] kg m^2, about this origin


@dataclasses.dataclass(frozen=True, eq=False)
class Robot:
    """A serial arm of n hinges. Static: hashed and compared by what it was compiled from."""

    name: str
    mjcf: str
    mj_model: mujoco.MjModel = dataclasses.field(repr=False)
    joint_names: tuple[str, ...]  # as in the file; each with its number where two would make one column of a table
    links: tuple[Link, ...] = dataclasses.field(repr=False)
    payload_link: Link = dataclasses.field(repr=False)  # one kilogram at the tool, in the frame of the last hinge
    body_link: np.ndarray = dataclasses.field(repr=False)  # [bodies] hinge that moves the body, -1 for the base
    q_zero: np.ndarray  # [n] rad, angles at which the MJCF is drawn
    gravity: np.ndarray  # [3] m/s^2
    armature: np.ndarray  # [n] kg m^2
    damping: np.ndarray  # [n] N m s/rad
    coulomb_positive: np.ndarray  # [n] N m, speed > 0
    coulomb_negative: np.ndarray  # [n] N m, speed < 0
    coulomb_speed: float  # rad/s, width of the tanh
    torque_limit: np.ndarray  # [n] N m, infinite where the model gives none
    fingerprint: str

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.links)

    def plant_model(self, dt: float | None = None) -> mujoco.MjModel:
        """A new MuJoCo model that is this arm: the plant of a control loop of your own, moved by ``mujoco.mj_step``.

        ``data.ctrl[:n]`` are the joints' motors, N m within ``torque_limit``, in place of the file's actuators: a position
        servo would work against the controller. Motor inertia and viscous friction are the robot's. Coulomb friction is an
        actuator behind the motors, for each joint that has any: linear up to ``coulomb_speed``, where the robot's is a tanh.
        There are no shapes, contacts and joint limits. ``mj_model`` is no plant: servos are on in it, dry friction is off.

        Args:
            dt: Time of one step, s; that of the file if not given. Take ``config.dt`` and one step a tick.

        Raises:
            ValueError: dt is not a positive number.
        """
        return plant.compiled(self, dt)

    def __hash__(self) -> int:
        return hash(self.fingerprint)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Robot) and other.fingerprint == self.fingerprint


def load_robot(path: str | Path) -> Robot:
    """Compile a serial arm of hinges from an MJCF or URDF file.

    A site named ``tool`` says where a payload sits (otherwise the last link's origin). Joint attribute ``user`` gives the
    Coulomb torques for positive and negative speed; without it, ``frictionloss`` serves for both.

    Raises:
        ValueError: the file is not a serial arm of hinges, or MuJoCo cannot compile it.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"no robot file at {path}; give an MJCF or URDF file, or 'puma560' for the built-in arm")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ValueError(f"{path} does not compile: {error}") from error
    return _from_spec(path.stem, spec, None)


def compile_robot(name: str, mjcf: str, amend: Callable[[mujoco.MjModel], None] | None = None) -> Robot:
    """Compile MJCF text; ``amend`` may overwrite constants that the compiler refuses."""
    return _from_spec(name, mujoco.MjSpec.from_string(mjcf), amend)


def _from_spec(name: str, spec: mujoco.MjSpec, amend: Callable[[mujoco.MjModel], None] | None) -> Robot:
    _add_payload(spec, name)
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.compiler.fusestatic = False  # URDF would fuse the payload's body into its parent
    for geom in spec.geoms:  # MJX refuses pairs of shapes that it cannot collide, contacts or not
        geom.contype = geom.conaffinity = 0
    try:
        model = spec.compile()
    except ValueError as error:
        raise ValueError(f"{name} does not compile: {error}") from error
    if amend is not None:
        amend(model)
        mujoco.mj_setConst(model, mujoco.MjData(model))
    body_link = _serial_order(name, model)
    links, payload_link = _links(model, body_link)
    positive, negative = _coulomb(model)
    limit = _torque_limit(model)
    constants = [model.qpos0, model.opt.gravity, model.dof_armature, model.dof_damping, positive, negative, limit]
    constants += [getattr(link, f.name) for link in (*links, payload_link) for f in dataclasses.fields(Link)]
    digest = hashlib.sha256(repr([(np.round(np.ravel(c), 9) + 0.0).tolist() for c in constants]).encode())
    return Robot(
        name=name,
        mjcf=spec.to_xml(),
        mj_model=model,
        joint_names=_distinct([model.joint(j).name or f"joint{j + 1}" for j in range(model.njnt)]),
        links=links,
        payload_link=payload_link,
        body_link=body_link,
        q_zero=model.qpos0.copy(),
        gravity=model.opt.gravity.copy(),
        armature=model.dof_armature.copy(),
        damping=np.asarray(model.dof_damping, float).copy(),
        coulomb_positive=positive,
        coulomb_negative=negative,
        coulomb_speed=0.05,
        torque_limit=limit,
        fingerprint=digest.hexdigest()[:16],
    )


def _distinct(names: list[str]) -> tuple[str, ...]:
    """The joints' names, each with its number where the columns of a table could be the same for two.

    Columns are a signal and a joint: ``q_hat_x`` would be ``q_hat`` of ``x`` and ``q`` of ``hat_x``; case does not count.
    """
    low = [name.lower() for name in names]
    same = any(a == b or a.endswith(f"_{b}") for i, a in enumerate(low) for j, b in enumerate(low) if i != j)
    return tuple(f"{name}_{j + 1}" for j, name in enumerate(names)) if same else tuple(names)


def _add_payload(spec: mujoco.MjSpec, name: str) -> None:
    moving = [body for body in spec.bodies if body.joints]
    if not moving:
        raise ValueError(f"{name} has no joint; a serial arm of at least one hinge is needed")
    parent, position = moving[-1], np.zeros(3)
    site = next((s for s in spec.sites if s.name == "tool"), None)
    if site is not None:  # compiled, because the site may be drawn in a frame of its own
        parent, position = site.parent, spec.compile().site("tool").pos.copy()
    parent.add_body(name=PAYLOAD, pos=position, ipos=np.zeros(3), explicitinertial=True)


def _serial_order(name: str, model: mujoco.MjModel) -> np.ndarray:
    """Hinge index per body; refuses anything but one chain of hinges."""
    if np.any(model.jnt_stiffness) or np.any(model.body_gravcomp):
        raise ValueError(
            f"{name}: joint stiffness and gravcomp are not modelled here; remove them, or add their torque to the command"
        )
    if model.opt.density or model.opt.viscosity:
        raise ValueError(f"{name}: air or water (option density, viscosity) is not modelled here; remove it")
    for j in range(model.njnt):
        if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE:
            kind = mujoco.mjtJoint(model.jnt_type[j]).name.removeprefix("mjJNT_").lower()
            raise ValueError(
                f"{name}: joint {model.joint(j).name!r} is a {kind} joint; only hinges are supported, "
                "so weld the base to the world and replace other joints"
            )
    body_link = np.full(model.nbody, -1, np.int32)
    for body in range(1, model.nbody):
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        above = body_link[model.body_parentid[body]]
        if count and first != above + 1:
            raise ValueError(
                f"{name}: body {model.body(body).name!r} branches off; only one serial chain is supported, "
                "so remove or weld the joints of the other branch"
            )
        body_link[body] = first + count - 1 if count else above
    if body_link[model.body(PAYLOAD).id] != model.njnt - 1:
        raise ValueError(f"{name}: the site 'tool' must sit on the last link, where a payload hangs; move it there")
    return body_link


def _axis_frame(axis: np.ndarray) -> np.ndarray:
    """A rotation whose third column is ``axis``; exact permutations where the axis is a coordinate axis."""
    axis = axis / np.linalg.norm(axis)
    other = np.roll(np.eye(3)[np.argmax(np.abs(axis))], 1)
    first = other - axis * (other @ axis)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis, first), axis])


def _links(model: mujoco.MjModel, body_link: np.ndarray) -> tuple[tuple[Link, ...], Link]:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    frames = [data.xmat[model.jnt_bodyid[j]].reshape(3, 3) @ _axis_frame(model.jnt_axis[j]) for j in range(model.njnt)]
    links, before, origin = [], np.eye(3), np.zeros(3)
    for j in range(model.njnt):
        mass, moment, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
        for body in np.flatnonzero(body_link == j):
            axes = frames[j].T @ data.ximat[body].reshape(3, 3)
            com = frames[j].T @ (data.xipos[body] - data.xanchor[j])
            part = float(model.body_mass[body])
            mass, moment = mass + part, moment + part * com
            inertia = inertia + axes @ np.diag(model.body_inertia[body]) @ axes.T + part * _point_inertia(com)
        offset = before.T @ (data.xanchor[j] - origin)
        links.append(Link(_clean(before.T @ frames[j]), _clean(offset), mass, _clean(moment), _clean(inertia)))
        before, origin = frames[j], data.xanchor[j]
    tool = before.T @ (data.xipos[model.body(PAYLOAD).id] - origin)
    return tuple(links), Link(np.eye(3), np.zeros(3), 1.0, _clean(tool), _clean(_point_inertia(tool)))


def _point_inertia(position: np.ndarray) -> np.ndarray:
    """Inertia of one kilogram at ``position`` about the origin."""
    return position @ position * np.eye(3) - np.outer(position, position)


def _clean(values: np.ndarray) -> np.ndarray:
    """Rounding dust to exact 0 and +-1, so that the unrolled chain can leave out what it multiplies by them."""
    values = np.where(np.abs(values) < 1e-14, 0.0, values)
    return np.where(np.abs(np.abs(values) - 1) < 1e-14, np.sign(values), values)


def _coulomb(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    if model.nuser_jnt >= 2:
        return model.jnt_user[:, 0].copy(), model.jnt_user[:, 1].copy()
    return model.dof_frictionloss.copy(), model.dof_frictionloss.copy()


def _torque_limit(model: mujoco.MjModel) -> np.ndarray:
    """Largest torque per joint from the joint's own force range and its actuators'; infinite where none is given.

    An actuator's force range counts, and for a plain motor its control range too (of a servo that is an angle). Of an
    asymmetric range the smaller side counts.
    """
    limit = np.full(model.njnt, np.inf)
    for j in range(model.njnt):
        if model.jnt_actfrclimited[j]:
            limit[j] = np.abs(model.jnt_actfrcrange[j]).min()
    for a in range(model.nu):
        if model.actuator_trntype[a] != mujoco.mjtTrn.mjTRN_JOINT:
            continue
        j, gear = int(model.actuator_trnid[a, 0]), abs(model.actuator_gear[a, 0])
        is_motor = model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE
        if model.actuator_forcelimited[a]:
            limit[j] = min(limit[j], gear * np.abs(model.actuator_forcerange[a]).min())
        if model.actuator_ctrllimited[a] and is_motor:
            gain = gear * abs(model.actuator_gainprm[a, 0])
            limit[j] = min(limit[j], gain * np.abs(model.actuator_ctrlrange[a]).min())
    return limit
