"""What a robot file says, before an arm is picked out of it: bodies, the joints that move them, marked points."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

HINGE, SLIDE = "hinge", "slide"  # the kinds of joint that can be welded at a value; all others only where they stand


class Joint(NamedTuple):
    """One joint of a body, in the body's frame."""

    name: str
    kind: str  # HINGE, SLIDE, or the file's word for what cannot be modelled: ball, free, planar
    axis: np.ndarray  # [3] 1
    anchor: np.ndarray  # [3] m
    zero: float = 0.0  # rad or m, at which the body is drawn
    low: float = -math.inf  # rad or m
    high: float = math.inf
    torque_limit: float = math.inf  # N m
    speed_limit: float = math.inf  # rad/s
    armature: float = 0.0  # kg m^2
    damping: float = 0.0  # N m s/rad
    coulomb: tuple[float, float] = (0.0, 0.0)  # N m, speed > 0 and speed < 0
    follows: tuple[str, float, float] | None = None  # mimic: joint, factor, offset
    spring: bool = False
    remarks: tuple[str, ...] = ()  # what is odd about it, said if the arm has it


class Body(NamedTuple):
    """One body, in the frame of its parent; its inertia is in its own frame."""

    name: str
    parent: int  # -1 for the world; parents come first
    position: np.ndarray  # [3] m
    rotation: np.ndarray  # [3, 3]
    joints: tuple[Joint, ...]
    mass: float = 0.0  # kg
    com: np.ndarray = np.zeros(3)  # [3] m
    inertia: np.ndarray = np.zeros((3, 3))  # [3, 3] kg m^2, about the centre of mass, axes of the body
    has_inertia: bool = True  # whether the file gives any
    has_shape: bool = True  # a frame without a shape needs no mass
    gravcomp: bool = False
    refused: str = ""  # why the arm cannot have this body, if so


class Place(NamedTuple):
    """A marked frame."""

    body: int
    position: np.ndarray  # [3] m, in the frame of the body
    rotation: np.ndarray  # [3, 3]


class Tree(NamedTuple):
    """A robot file."""

    bodies: tuple[Body, ...]
    sites: dict[str, Place]
    gravity: np.ndarray  # [3] m/s^2


def rpy(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Rotation of a URDF: about the fixed x, then y, then z."""
    z, y, x = (turn(axis, angle) for axis, angle in zip(np.eye(3)[::-1], (yaw, pitch, roll), strict=True))
    return z @ y @ x


def turn(axis: Any, angle: float) -> np.ndarray:
    """Rotation by an angle in rad about a unit vector; the identity, exactly, for 0."""
    if angle == 0.0:
        return np.eye(3)
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross


def point_inertia(position: np.ndarray) -> np.ndarray:
    """Inertia [3, 3] m^2 of one kilogram at ``position`` [3] m about the origin."""
    return position @ position * np.eye(3) - np.outer(position, position)
