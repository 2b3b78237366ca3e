"""Contact: whether a force on a link explains the torque alarms, rather than faults of motors.

A motor's fault shows in its own joint. A force F on link l shows in joints 1 to l at once, as J^T F, and in none beyond. So
where torque alarms are up, S in units of their thresholds, x_j = S_j / alpha_j, is explained in two ways:

* by faults of at most m = ``config.contact`` joints. They leave sum x^2 less its m largest terms;
* by a force on the link of the last joint that takes part. x = A w, w the force f and its moment about the middle c of the
  link over its reach R; row j of A is [z_j x (c - o_j), R z_j] / alpha_j. The weakest w is preferred: w = A^T a with
  (A A^T + k 1) a = x, which leaves k a. k is small, and keeps out patterns that take a force many times as large as usual.

It is a contact if more than m joints take part and the force leaves less than ``LEFT`` of what the motors leave. |f| is the
size that is reported: the least that explains x, as where on the link it acts is not known.

What cannot be told apart: a force that at most m joints bear, above all one on link 1, is called a fault of these motors;
faults of more than m motors at once, such as a brown-out, and a payload that is picked up look like forces. While a reading
is held to be wrong, nothing is said of contacts. The pattern alone seldom excludes a force: of an arm of six joints nearly
all torques are a force somewhere on the tool.

Sources: De Luca, Albu-Schaeffer, Haddadin, Hirzinger, Collision detection and safe reaction with the DLR-III lightweight
manipulator arm, IROS 2006 (the last joint that takes part); Haddadin, De Luca, Albu-Schaeffer, IEEE T-RO 33(6), 2017.
"""

from __future__ import annotations

import functools
import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.numerics.barrier import unstack
from jaxftc.robot import forces, lanes
from jaxftc.robot.lanes import Lane, add, dot, mul
from jaxftc.robot.mass_matrix import solve
from jaxftc.robot.model import Robot
from jaxftc.robot.rigid_body import Pose
from jaxftc.robot.vectors import Vector, cross, less, times
from jaxftc.types import Array, Verdict

SHARE = 0.1  # of the largest |x|, below which a joint's alarm is what an inexact model leaks into it
LEFT = 0.5  # of what the motors leave unexplained, that a force may leave
STIFF = 0.01  # k over the mean of A A^T's diagonal: a force ten times as large as usual for its torques is half believed
GIRTH = 0.1  # m, how far from the line between its joints a link may be touched


class Inputs(NamedTuple):
    """What a tick takes in."""

    at: Pose  # of the arm
    statistic: Array  # [n, ...] N m
    threshold: Array  # [n, ...] N m
    verdict: Array  # [n, ...] int32, of both channels


class Found(NamedTuple):
    """What is said of each joint."""

    verdict: Array  # [n, ...] int32: CONTACT for every joint up to the link; as it was where there is no contact
    force: Array  # [n, ...] N, size of the force on the link of this joint, else 0


@box("Block 7: contact")
def judge(config: Config, inputs: Inputs) -> Found:
    """The verdict with a contact in it, where that explains the alarms. Comparisons: no gradient passes."""
    if not config.contact:
        return Found(inputs.verdict, jnp.zeros_like(inputs.statistic))
    inputs = jax.lax.stop_gradient(inputs)
    x = inputs.statistic / inputs.threshold
    size = jnp.abs(x)
    alone = (inputs.verdict & Verdict.SENSOR == 0).all(0)
    takes_part = (inputs.verdict & Verdict.ACTUATOR > 0) & (size >= SHARE * size.max(0))
    number = lanes.trailing_constant(np.arange(1, config.n + 1), x)
    link = jnp.where(takes_part, number, 0).max(0)
    left, force = by_force(config.robot, inputs.at, x, inputs.threshold, link)
    many = takes_part.sum(0) > config.contact
    contact = alone & many & (left <= LEFT * by_motors(x, config.contact))
    verdict = jnp.where(number <= link, Verdict.CONTACT, Verdict.NORMAL).astype(inputs.verdict.dtype)
    return Found(jnp.where(contact, verdict, inputs.verdict), jnp.where(contact & (number == link), force, 0.0))


def by_motors(x: Array, count: int) -> Array:
    """What faults of the ``count`` joints that explain most of x [n, ...] leave of the sum of its squares [...]."""
    squares = unstack(x * x)
    most = [add(*some) for some in itertools.combinations(squares, min(count, len(squares)))]
    return add(*squares) - functools.reduce(jnp.maximum, most)


def by_force(robot: Robot, at: Pose, x: Array, threshold: Array, link: Array) -> tuple[Array, Array]:
    """What a force on a link [...] leaves of the sum of squares of x [n, ...], and its size [...] N.

    All of a joint beyond the link is left, as its row of A is zero.
    """
    rows = [[*arm, *turn] for arm, turn in _levers(robot, at, threshold, link)]
    gram = [[dot(one, other) for other in rows] for one in rows]
    stiff = mul(STIFF, add(*(gram[i][i] for i in range(len(rows))))) / jnp.maximum(link, 1)
    matrix = [[add(entry, stiff) if i == j else entry for j, entry in enumerate(row)] for i, row in enumerate(gram)]
    weights = solve(matrix, unstack(x))
    pull = [add(*(mul(w, row[k]) for w, row in zip(weights, rows, strict=True))) for k in range(3)]
    left = mul(stiff * stiff, dot(weights, weights))
    return left, jnp.sqrt(dot(pull, pull))


def _levers(robot: Robot, at: Pose, threshold: Array, link: Array) -> list[tuple[Vector, Vector]]:
    """Rows of A: for each joint z x (c - o) and R z, over its threshold, zero beyond the link."""
    links = forces.frames(robot, at)
    middles = [forces.between(frame, 0.5) for frame in links]
    middle: Vector = tuple(_of_link([place[k] for place in middles], link) for k in range(3))  # pyright: ignore[reportAssignmentType]
    reach = _of_link([float(half + GIRTH) for half in 0.5 * forces.lengths(robot)], link)
    found = []
    for j, (frame, level) in enumerate(zip(links, unstack(threshold), strict=True)):
        weight = jnp.where(link >= j + 1, 1.0, 0.0) / level
        arm = times(weight, cross(frame.axis, less(middle, frame.origin)))
        found.append((arm, times(mul(weight, reach), frame.axis)))
    return found


def _of_link(values: list[Lane], link: Array) -> Lane:
    """The value [...] of a link [...], from 1, of one a link."""
    found = values[0]
    for i, value in enumerate(values[1:], start=2):
        found = jnp.where(link == i, value, found)
    return found
