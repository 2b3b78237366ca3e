"""``Robot``: the numbers of a serial arm of hinges, and a MuJoCo model made of them."""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any

import mujoco
import numpy as np

from jaxftc import checks
from jaxftc.robot import mujoco_model
from jaxftc.robot.link import Link, inertial, oddity
from jaxftc.robot.numbers import Numbers, checked

BARE = (
    "the file gives no motor inertia (armature) and no friction for any joint: light joints are accelerated as no real one "
    "is, and faults may throw the arm; give both in the file or in an arm.toml"
)
COULOMB_SPEED = 0.05  # rad/s, width of the friction's tanh where nothing else is known


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Robot(Numbers):
    """A serial arm of n hinges. Static: hashed and compared by its numbers."""

    mj_model: mujoco.MjModel = dataclasses.field(repr=False)  # the chain alone, a body a hinge, made of the numbers below
    body_link: np.ndarray = dataclasses.field(repr=False)  # [bodies] hinge that moves the body, -1 for the base
    fingerprint: str
    cautions: tuple[str, ...] = dataclasses.field(default=(), repr=False)  # what makes results doubtful, a line each

    @property
    def mjcf(self) -> str:
        """The chain as MJCF text."""
        return mujoco_model.mujoco_spec(self).to_xml()

    def replace(self, **numbers: Any) -> Robot:
        """The same arm with other numbers; the MuJoCo model and the fingerprint follow.

        Args:
            numbers: By field: links, armature, damping_positive, coulomb_negative, torque_limit and so on, [n] each.

        Returns:
            A new robot.

        Raises:
            ValueError: an unknown name, a wrong shape, or numbers that no arm can have.
        """
        fields = tuple(field.name for field in dataclasses.fields(Numbers))
        for name in numbers:
            checks.one_of("number of a robot", name, fields)
        tensors = tuple(caution for caution in self.cautions if caution != BARE)
        for name, link, before in zip(self.link_names, numbers.get("links", self.links), self.links, strict=True):
            mass, _, inertia, _ = inertial(link)
            text = "" if link is before else oddity(mass, inertia)
            tensors += (f"link {name!r} {text}",) if text else ()
        return assemble(Numbers(**{name: getattr(self, name) for name in fields} | numbers), tensors)

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
        return mujoco_model.plant_model(self, self.mj_model, dt)

    def __hash__(self) -> int:
        return hash(self.fingerprint)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Robot) and other.fingerprint == self.fingerprint


def assemble(given: Numbers, tensors: tuple[str, ...] = ()) -> Robot:
    """The robot of its numbers, checked, with what is made of them.

    Args:
        given: The numbers.
        tensors: What no body can have of the links, a line each.

    Raises:
        ValueError: numbers that no arm can have.
    """
    given = checked(given, tensors)
    fields = {field.name: getattr(given, field.name) for field in dataclasses.fields(Numbers)}
    return Robot(
        **fields,
        mj_model=mujoco_model.mujoco_model(given),
        body_link=np.concatenate([[-1], np.arange(given.n), [given.n - 1]]).astype(np.int32),
        fingerprint=_fingerprint(given),
        cautions=(*tensors, *((BARE,) if given.frictionless else ())),
    )


def _fingerprint(given: Numbers) -> str:
    """Of every number that a compiled program may hold; what an arm may lack counts only where it is given."""
    links = (*given.links, given.payload_link)
    constants = [given.q_zero, given.gravity, given.armature, given.damping]
    constants += [given.coulomb_positive, given.coulomb_negative, given.torque_limit]
    constants += [getattr(link, field.name) for link in links for field in dataclasses.fields(Link)]
    if not np.array_equal(given.damping_positive, given.damping_negative):
        constants.append(given.damping_positive)
    if np.isfinite([given.q_low, given.q_high]).any():
        constants += [given.q_low, given.q_high]
    if given.coulomb_speed != COULOMB_SPEED:
        constants.append(np.array(given.coulomb_speed))
    rounded = [(np.round(np.ravel(c), 9) + 0.0).tolist() for c in constants]
    return hashlib.sha256(repr(rounded).encode()).hexdigest()[:16]
