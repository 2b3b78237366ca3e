"""A force on a link: where the joints are, and the torques J^T F that the joints bear.

Joint j bears z_j . ((p - o_j) x F) of a force F at the point p, z_j its axis and o_j a point on it, if it comes before the
link or is the link's own; a joint beyond the link bears nothing. All vectors are in the base frame.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxftc.compile.box import box
from jaxftc.numerics.barrier import unstack
from jaxftc.robot import rigid_body
from jaxftc.robot.lanes import Lane, dot
from jaxftc.robot.model import Robot
from jaxftc.robot.rigid_body import Pose
from jaxftc.robot.vectors import ZERO, Vector, constant, cross, less, plus, times
from jaxftc.types import Array

Turn = tuple[Vector, Vector, Vector]  # columns of a rotation matrix


class Frame(NamedTuple):
    """A link in the base frame; its frame is at its joint, the third axis being the joint's."""

    origin: Vector  # m, of its joint
    turn: Turn  # axes of its frame
    end: Vector  # m, the next joint; the tool of the last link

    @property
    def axis(self) -> Vector:
        """Of its joint."""
        return self.turn[2]


class Place(NamedTuple):
    """A point of a link.

    Attributes:
        link: [...] int32, which link, from 1.
        along: [...] 1, from the link's joint, 0, to the next joint or the tool, 1.
        offset: [3, ...] m, from there, in the frame at the link's joint, whose z axis is the joint.
    """

    link: Array
    along: Array
    offset: Array


@box("Nominal arm: where the links are")
def frames(robot: Robot, at: Pose) -> list[Frame]:
    """Every link of the arm at a pose, by lanes."""
    at = Pose(unstack(at.cos), unstack(at.sin))
    origin, turn = ZERO, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    found: list[tuple[Vector, Turn]] = []
    for i, link in enumerate(robot.links):
        origin = plus(origin, _turned(turn, constant(link.offset)))
        x, y, z = (_turned(turn, constant(column)) for column in link.rotation.T)
        c, s = at.cos[i], at.sin[i]
        turn = (plus(times(c, x), times(s, y)), less(times(c, y), times(s, x)), z)
        found.append((origin, turn))
    tool = plus(origin, _turned(turn, constant(robot.payload_link.moment)))
    ends = [*(origin for origin, _ in found[1:]), tool]
    return [Frame(origin, turn, end) for (origin, turn), end in zip(found, ends, strict=True)]


def joint_torques(robot: Robot, q: Array, place: Place, force: Array) -> Array:
    """J^T F [n, ...] N m at q [n, ...] rad of a force [3, ...] N, base frame; no torque of a link that there is not."""
    links = frames(robot, rigid_body.pose(robot, q))
    offset, pull = tuple(unstack(place.offset)), tuple(unstack(force))
    point = [jnp.zeros(q.shape[1:], q.dtype)] * 3
    for i, link in enumerate(links):
        here = plus(between(link, place.along), _turned(link.turn, offset))
        point = [jnp.where(place.link == i + 1, new, old) for new, old in zip(here, point, strict=True)]
    rows = [lever(link, tuple(point), pull) for link in links]  # pyright: ignore[reportArgumentType]
    bears = [(place.link >= i + 1) & (place.link <= len(links)) for i in range(len(links))]
    return jnp.stack([jnp.where(own, row, 0.0) for own, row in zip(bears, rows, strict=True)])


def between(link: Frame, along: Lane) -> Vector:
    """The point of the line from a link's joint to its end that is ``along`` of the way."""
    way = less(link.end, link.origin)
    return plus(link.origin, times(along, way))


def lever(link: Frame, point: Vector, force: Vector) -> Lane:
    """Torque of a force at a point about the link's joint, N m."""
    return dot(link.axis, cross(less(point, link.origin), force))


def _turned(turn: Turn, v: Any) -> Vector:
    return plus(*(times(part, column) for part, column in zip(v, turn, strict=True)))


def lengths(robot: Robot) -> np.ndarray:
    """Length [n] m of every link, from its joint to the next one or to the tool."""
    ends = [*(link.offset for link in robot.links[1:]), robot.payload_link.moment]
    return np.linalg.norm(np.stack(ends), axis=1)
