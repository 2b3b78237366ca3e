"""The numbers that make an arm, and which of them no arm can have."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxftc import checks
from jaxftc.robot.link import Link

NOT_NEGATIVE = ("armature", "damping_positive", "damping_negative", "coulomb_positive", "coulomb_negative")
POSITIVE = ("torque_limit", "speed_limit")


class Source(NamedTuple):
    """What a robot was read from."""

    path: Path  # the MJCF or URDF file
    tip: str | None
    lock: tuple[tuple[str, float], ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Numbers:
    """A serial arm of n hinges, as a file or its maker gives it."""

    name: str
    joint_names: tuple[str, ...]  # as in the file; each with its number where two would make one column of a table
    link_names: tuple[str, ...] = dataclasses.field(repr=False)  # the body that each hinge moves
    links: tuple[Link, ...] = dataclasses.field(repr=False)  # with everything that is welded to them
    payload_link: Link = dataclasses.field(repr=False)  # one kilogram at the tool, in the frame of the last hinge
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
    tool: str = dataclasses.field(default="", repr=False)  # where a payload hangs, in words
    notes: tuple[str, ...] = dataclasses.field(
        default=(), repr=False
    )  # what was welded, left out or a placeholder, a line each
    source: Source | None = dataclasses.field(default=None, repr=False)  # None for the built-in arm

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.links)

    @functools.cached_property
    def damping(self) -> np.ndarray:
        """Viscous friction [n] N m s/rad, the mean of both directions."""
        return 0.5 * (self.damping_positive + self.damping_negative)

    @functools.cached_property
    def inertia_diagonal(self) -> np.ndarray:
        """What each joint moves with the others held, motor included [n] kg m^2: the mean over the joints' ranges."""
        return np.diagonal(_inertia_matrices(self), axis1=1, axis2=2).mean(0)

    @functools.cached_property
    def acceleration_limit(self) -> np.ndarray:
        """What the torque limit gives a joint with the others free [n] rad/s^2: the most over the joints' ranges."""
        return self.torque_limit * np.diagonal(np.linalg.inv(_inertia_matrices(self)), axis1=1, axis2=2).max(0)

    @property
    def frictionless(self) -> bool:
        """Whether no joint has any friction or motor inertia."""
        return not any(np.any(getattr(self, name)) for name in NOT_NEGATIVE)


def checked(given: Numbers, tensors: tuple[str, ...]) -> Numbers:
    """The same with read-only arrays, or a refusal that names the joint or link.

    Args:
        given: The numbers.
        tensors: What no body can have of the links, a line each; they are named if the inertia matrix is singular.
    """
    names = (*NOT_NEGATIVE, *POSITIVE, "q_zero", "q_low", "q_high")
    given = dataclasses.replace(given, **{name: _checked(name, getattr(given, name), given.joint_names) for name in names})
    checks.positive("coulomb_speed", given.coulomb_speed, "rad/s")
    checks.finite("gravity", given.gravity, "it is in m/s^2, such as 0 0 -9.81")
    _refuse_singular(given, tensors)
    return given


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


def _refuse_singular(given: Numbers, tensors: tuple[str, ...]) -> None:
    """Refuse an arm whose inertia matrix is not positive definite, and name the links that no body can be."""
    matrices = _inertia_matrices(given)
    diagonal = np.diagonal(matrices, axis1=1, axis2=2)
    names, joints = given.link_names, given.joint_names
    empty = [repr(names[j]) for j, link in enumerate(given.links) if not link.mass and not link.inertia.any()]
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


def _inertia_matrices(given: Numbers) -> np.ndarray:
    """M(q) [64, n, n] of links and motors, at angles drawn from the joints' ranges."""
    low, high = (
        np.where(np.isfinite(getattr(given, k)), getattr(given, k), s * np.pi) for k, s in (("q_low", -1), ("q_high", 1))
    )
    q = np.random.default_rng(0).uniform(np.minimum(low, high), np.maximum(low, high), (64, len(low)))
    return mass_matrices(given.links, q - given.q_zero) + np.diag(given.armature)


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
