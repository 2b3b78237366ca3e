"""``Robot``: the numbers of a serial arm of hinges, and a MuJoCo model made of them; from MJCF, URDF or an arm's own file.

Contacts, joint limits and dry friction as MuJoCo constraints are switched off: they bring a solver loop that has no
reverse mode. Dry friction becomes a smooth torque, Coulomb times tanh of speed, in both engines.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from jaxftc import checks
from jaxftc.robot import chain, mjcf, urdf
from jaxftc.robot.chain import Chain
from jaxftc.robot.chain import Link as Link
from jaxftc.robot.tree import Tree, point_inertia

PAYLOAD = "jaxftc_payload"  # massless body at the tool, so that a payload is one mass leaf in both engines
ARM_FILE = "arm.toml"
BARE = (
    "the file gives no motor inertia (armature) and no friction for any joint: light joints are accelerated as no real one "
    "is, and faults may throw the arm; give both in the file or in an arm.toml"
)
COULOMB_SPEED = 0.05  # rad/s, width of the friction's tanh where nothing else is known
NOT_NEGATIVE = ("armature", "damping_positive", "damping_negative", "coulomb_positive", "coulomb_negative")
POSITIVE = ("torque_limit", "speed_limit")


class Source(NamedTuple):
    """What a robot was read from."""

    path: Path  # the MJCF or URDF file
    tip: str | None
    lock: tuple[tuple[str, float], ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Robot:
    """A serial arm of n hinges. Static: hashed and compared by its numbers."""

    name: str
    mj_model: mujoco.MjModel = dataclasses.field(repr=False)  # the chain alone, a body a hinge, made of the numbers below
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...] = dataclasses.field(repr=False)  # the body that each hinge moves
    links: tuple[Link, ...] = dataclasses.field(repr=False)  # with everything that is welded to them
    payload_link: Link = dataclasses.field(repr=False)  # one kilogram at the tool, in the frame of the last hinge
    body_link: np.ndarray = dataclasses.field(repr=False)  # [bodies] hinge that moves the body, -1 for the base
    q_zero: np.ndarray  # [n] rad, angles at which the file is drawn
    q_low: np.ndarray  # [n] rad, range of the joint, infinite where the file gives none
    q_high: np.ndarray  # [n] rad
    gravity: np.ndarray  # [3] m/s^2
    armature: np.ndarray  # [n] kg m^2, motor inertia behind its gear
    damping_positive: np.ndarray  # [n] N m s/rad, viscous friction, speed > 0
    damping_negative: np.ndarray  # [n] N m s/rad, speed < 0
    coulomb_positive: np.ndarray  # [n] N m, speed > 0
    coulomb_negative: np.ndarray  # [n] N m, speed < 0
    coulomb_speed: float  # rad/s, width of the tanh
    torque_limit: np.ndarray  # [n] N m, infinite where the model gives none
    speed_limit: np.ndarray  # [n] rad/s, infinite where the model gives none
    fingerprint: str
    tool: str = dataclasses.field(default="", repr=False)  # where a payload hangs, in words
    notes: tuple[str, ...] = dataclasses.field(
        default=(), repr=False
    )  # what was welded, left out or a placeholder, a line each
    cautions: tuple[str, ...] = dataclasses.field(default=(), repr=False)  # what makes results doubtful, a line each
    source: Source | None = dataclasses.field(default=None, repr=False)  # None for the built-in arm

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.links)

    @property
    def mjcf(self) -> str:
        """The chain as MJCF text."""
        return mujoco_spec(self).to_xml()

    @functools.cached_property
    def damping(self) -> np.ndarray:
        """Viscous friction [n] N m s/rad, the mean of both directions."""
        return 0.5 * (self.damping_positive + self.damping_negative)

    def replace(self, **numbers: Any) -> Robot:
        """The same arm with other numbers; the MuJoCo model and the fingerprint follow.

        Args:
            numbers: By field: links, armature, damping_positive, coulomb_negative, torque_limit and so on, [n] each.

        Returns:
            A new robot.

        Raises:
            ValueError: an unknown name, a wrong shape, or numbers that no arm can have.
        """
        given = {name: getattr(self, name) for name in _GIVEN}
        for name in numbers:
            checks.one_of("number of a robot", name, tuple(given))
        tensors = tuple(caution for caution in self.cautions if caution != BARE)
        for name, link, before in zip(self.link_names, numbers.get("links", self.links), self.links, strict=True):
            mass, _, inertia, _ = _inertial(link)
            text = "" if link is before else chain.oddity(mass, inertia)
            tensors += (f"link {name!r} {text}",) if text else ()
        return _assemble(**given | numbers, tensors=tensors)

    @property
    def frictionless(self) -> bool:
        """Whether no joint has any friction or motor inertia."""
        return not any(np.any(getattr(self, name)) for name in NOT_NEGATIVE)

    def __hash__(self) -> int:
        return hash(self.fingerprint)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Robot) and other.fingerprint == self.fingerprint


_MADE = ("mj_model", "body_link", "fingerprint", "cautions")
_GIVEN = tuple(field.name for field in dataclasses.fields(Robot) if field.name not in _MADE)


def load_robot(path: str | Path, *, tip: str | None = None, lock: Mapping[str, float] | None = None) -> Robot:
    """Read a serial arm of hinges from an MJCF or URDF file, or from an arm's own file (``arm.toml``, or its folder).

    Joints beyond the arm (fingers, heads, other branches, mimic joints) are welded where they stand, and their mass is
    kept. Without ``tip`` the arm goes from the base into the branch with the most hinges and ends where the branches that
    follow have fewer hinges than it has itself. Shapes are not opened where inertials are given, so meshes may be missing.
    A payload hangs at ``tip``, else at a site ``tool``, a link such as ``tool0``, ``ee_link`` or ``flange``, or the last
    link's origin. Joint attribute ``user`` of an MJCF gives the Coulomb torques for positive and negative speed; without
    it, ``frictionloss`` serves for both. What was welded or is a placeholder stands in ``notes`` of the robot, what makes
    results doubtful in ``cautions``; a link that no body can be is a warning, too.

    Args:
        path: The file.
        tip: Link, site or joint at which the arm ends.
        lock: Joints to weld and where, rad or m.

    Returns:
        The arm.

    Raises:
        ValueError: the file is not a serial arm of hinges, or holds numbers that no arm can have.
    """
    robot = read_robot(path, tip=tip, lock=lock)
    warn(robot)
    return robot


def warn(robot: Robot) -> None:
    """A warning, at the caller's caller, for each link that no body can be; that of the built-in arm is as published."""
    for caution in robot.cautions if robot.source is not None else ():
        if caution != BARE:
            warnings.warn(f"{robot.name}: {caution}", stacklevel=3)


def read_robot(path: str | Path, *, tip: str | None = None, lock: Mapping[str, float] | None = None) -> Robot:
    """The same without warnings, for callers that print the cautions themselves."""
    path = Path(path)
    if path.suffix == ".toml" or path.is_dir():
        from jaxftc.robot.arm_file import read_arm

        if tip is not None or lock:
            raise ValueError(f"{path} names tip and locked joints itself; change them there, or give its model's file")
        return read_arm(path).robot
    if not path.is_file():
        raise ValueError(f"no robot file at {path}; give an MJCF or URDF file, or 'puma560' for the built-in arm")
    try:
        found = chain.pick(_tree(path), tip, dict(lock or {}))
        return _from_chain(path.stem, found, Source(path, tip, tuple((lock or {}).items())))
    except ValueError as error:
        raise ValueError(f"{path}: {' '.join(str(error).split())}") from error


def compile_robot(name: str, text: str) -> Robot:
    """The arm of MJCF text."""
    try:
        return _from_chain(name, chain.pick(mjcf.read(mujoco.MjSpec.from_string(text))), None)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error


def _tree(path: Path) -> Tree:
    """What the file says, by what it is: its root element, not its name."""
    root = urdf.parse(path.read_bytes())
    if root.tag == "robot":
        return urdf.read(root)
    if root.tag == "sdf":
        raise ValueError("is SDF, which is not read here; give the robot's URDF, or convert it to MJCF")
    if root.tag != "mujoco":
        raise ValueError(f"begins with <{root.tag}>; an MJCF begins with <mujoco>, a URDF with <robot>")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ValueError(f"does not compile: {error}") from error
    return mjcf.read(spec)


def _from_chain(name: str, found: Chain, source: Source | None) -> Robot:
    joints = found.joints

    def column(values: Any) -> np.ndarray:
        return np.array(list(values), float)

    return _assemble(
        name=name,
        joint_names=tuple(joint.name for joint in joints),
        link_names=found.names,
        links=found.links,
        payload_link=found.payload,
        q_zero=column(joint.zero for joint in joints),
        q_low=column(joint.low for joint in joints),
        q_high=column(joint.high for joint in joints),
        gravity=found.gravity,
        armature=column(joint.armature for joint in joints),
        damping_positive=column(joint.damping for joint in joints),
        damping_negative=column(joint.damping for joint in joints),
        coulomb_positive=column(joint.coulomb[0] for joint in joints),
        coulomb_negative=column(joint.coulomb[1] for joint in joints),
        coulomb_speed=COULOMB_SPEED,
        torque_limit=column(joint.torque_limit for joint in joints),
        speed_limit=column(joint.speed_limit for joint in joints),
        tool=found.tool,
        notes=found.notes,
        source=source,
        tensors=found.cautions,
    )


def _assemble(*, tensors: tuple[str, ...], **given: Any) -> Robot:
    """The robot of its numbers, checked, with what is made of them."""
    for name in (*NOT_NEGATIVE, *POSITIVE, "q_zero", "q_low", "q_high"):
        given[name] = _checked(name, given[name], given["joint_names"])
    checks.positive("coulomb_speed", given["coulomb_speed"], "rad/s")
    checks.finite("gravity", given["gravity"], "it is in m/s^2, such as 0 0 -9.81")
    _refuse_singular(given, tensors)
    robot = Robot(**given, mj_model=None, body_link=np.zeros(0), fingerprint=_fingerprint(given))  # pyright: ignore[reportArgumentType]
    bare = (BARE,) if robot.frictionless else ()
    body_link = np.concatenate([[-1], np.arange(robot.n), [robot.n - 1]]).astype(np.int32)
    made = {"mj_model": _mujoco(robot), "body_link": body_link, "cautions": (*tensors, *bare)}
    return dataclasses.replace(robot, **made)


def _checked(name: str, values: Any, joints: tuple[str, ...]) -> np.ndarray:
    """Numbers of all joints, or a refusal with the joint's name."""
    array = np.array(values, float)
    if array.shape != (len(joints),):
        raise ValueError(f"{name} must have shape [{len(joints)}], a number a joint, got {list(array.shape)}")
    good = ~np.isnan(array) if name in (*POSITIVE, "q_low", "q_high") else np.isfinite(array)
    good &= array >= 0 if name in NOT_NEGATIVE else array > 0 if name in POSITIVE else True
    if not good.all():
        j = int(np.argmin(good))
        rule = "finite and not negative" if name in NOT_NEGATIVE else "above zero" if name in POSITIVE else "a number"
        raise ValueError(f"{name} of joint {joints[j]!r} must be {rule}, got {array[j]:g}")
    array.setflags(write=False)
    return array


def _refuse_singular(given: dict[str, Any], tensors: tuple[str, ...]) -> None:
    """Refuse an arm whose inertia matrix is not positive definite, and name the links that no body can be."""
    low, high = (np.where(np.isfinite(given[k]), given[k], s * np.pi) for k, s in (("q_low", -1), ("q_high", 1)))
    q = np.random.default_rng(0).uniform(np.minimum(low, high), np.maximum(low, high), (64, len(low)))
    matrices = mass_matrices(given["links"], q - given["q_zero"]) + np.diag(given["armature"])
    diagonal = np.diagonal(matrices, axis1=1, axis2=2)
    names, joints = given["link_names"], given["joint_names"]
    empty = [repr(names[j]) for j, link in enumerate(given["links"]) if not link.mass and not link.inertia.any()]
    blame = [f"without mass (0 kg) move the links {', '.join(empty)}"] * bool(empty) + list(tensors)
    if diagonal.min() <= 1e-12:
        j = int(np.argmin(diagonal.min(0)))
        blame.append(f"joint {joints[j]!r} moves an inertia of {diagonal.min():.3g} kg m^2, which must be above zero")
        raise ValueError(
            f"{'; '.join(blame)}; give link {names[j]!r} and what follows mass and inertia, or the joint an armature"
        )
    scale = np.sqrt(diagonal)
    least = np.linalg.eigvalsh(matrices / scale[:, :, None] / scale[:, None, :]).min()
    if least < 1e-9:
        blame.append(
            f"the inertia matrix M(q) has the eigenvalue {least:.3g} of its diagonal's size, which must be above zero"
        )
        raise ValueError(f"{'; '.join(blame)}; check the masses and inertias")


def mass_matrices(links: tuple[Link, ...], q: np.ndarray) -> np.ndarray:
    """M [k, n, n] of the links alone at angles [k, n] from where they are drawn, by their Jacobians; for checks."""
    k, n = q.shape
    matrices, turn = np.zeros((k, n, n)), np.broadcast_to(np.eye(3), (k, 3, 3))
    origin, axes, origins = np.zeros((k, 3)), np.zeros((k, 3, n)), np.zeros((k, 3, n))
    for j, link in enumerate(links):
        origin = origin + turn @ link.offset
        c, s, zero, one = np.cos(q[:, j]), np.sin(q[:, j]), np.zeros(k), np.ones(k)
        about_z = np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=-1).reshape(k, 3, 3)
        turn = turn @ link.rotation @ about_z
        axes[:, :, j], origins[:, :, j] = turn[:, :, 2], origin
        speed = np.cross(axes, origin[:, :, None] - origins, axis=1)
        speed[:, :, j + 1 :] = 0.0
        h, inertia = turn @ link.moment, turn @ link.inertia @ turn.transpose(0, 2, 1)
        swing = np.cross(axes, np.broadcast_to(h[:, :, None], axes.shape), axis=1)
        flip = lambda m: m.transpose(0, 2, 1)  # noqa: E731
        coupling = flip(speed) @ swing
        matrices = matrices + link.mass * flip(speed) @ speed + coupling + flip(coupling) + flip(axes) @ inertia @ axes
    return matrices


def _fingerprint(given: dict[str, Any]) -> str:
    """Of every number that a compiled program may hold; what an arm may lack counts only where it is given."""
    links = (*given["links"], given["payload_link"])
    damping = 0.5 * (given["damping_positive"] + given["damping_negative"])
    constants = [given["q_zero"], given["gravity"], given["armature"], damping]
    constants += [given["coulomb_positive"], given["coulomb_negative"], given["torque_limit"]]
    constants += [getattr(link, field.name) for link in links for field in dataclasses.fields(Link)]
    if not np.array_equal(given["damping_positive"], given["damping_negative"]):
        constants.append(given["damping_positive"])
    if np.isfinite([given["q_low"], given["q_high"]]).any():
        constants += [given["q_low"], given["q_high"]]
    if given["coulomb_speed"] != COULOMB_SPEED:
        constants.append(np.array(given["coulomb_speed"]))
    rounded = [(np.round(np.ravel(c), 9) + 0.0).tolist() for c in constants]
    return hashlib.sha256(repr(rounded).encode()).hexdigest()[:16]


def _mujoco(robot: Robot) -> mujoco.MjModel:
    """The compiled model; a link that no body can be is refused by the compiler, so it is written over another."""
    model = mujoco_spec(robot).compile()
    odd = [(j, *inertial[:3]) for j, inertial in enumerate(map(_inertial, robot.links)) if not inertial[3]]
    for j, mass, com, inertia in odd:
        moments, axes = np.linalg.eigh(inertia)
        axes = axes * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))])
        model.body_mass[j + 1], model.body_ipos[j + 1], model.body_inertia[j + 1] = mass, com, moments
        model.body_iquat[j + 1] = _quaternion(axes)
    if odd:
        mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def mujoco_spec(robot: Robot) -> mujoco.MjSpec:
    """A body and a motor for each hinge, the site ``tool`` and the payload's body at the tool."""
    spec = mujoco.MjSpec()
    spec.modelname, spec.compiler.degree, spec.option.gravity = robot.name, False, robot.gravity
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    body = spec.worldbody
    for j, link in enumerate(robot.links):
        mass, com, inertia, legal = _inertial(link)
        full = inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
        inertial = {"fullinertia": full} if legal else {"inertia": np.full(3, 1e-3)}
        inertial |= {"mass": mass if mass > 1e-12 else 1.0, "ipos": com}
        body = body.add_body(
            name=robot.link_names[j], pos=link.offset, quat=_quaternion(link.rotation), explicitinertial=True, **inertial
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
    body.add_site(name=chain.TOOL, pos=robot.payload_link.moment, quat=_quaternion(robot.payload_link.rotation))
    return spec


def _inertial(link: Link) -> tuple[float, np.ndarray, np.ndarray, bool]:
    """Mass, centre, inertia [3, 3] about it, and whether MuJoCo's compiler takes them."""
    com = link.moment / link.mass if link.mass else np.zeros(3)
    inertia = link.inertia - link.mass * point_inertia(com)
    moments = np.linalg.eigvalsh(inertia)
    return link.mass, com, inertia, bool(link.mass > 1e-12 and moments[0] > 1e-14 and moments[0] + moments[1] >= moments[2])


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    found = np.zeros(4)
    mujoco.mju_mat2Quat(found, np.ravel(rotation))
    return found
