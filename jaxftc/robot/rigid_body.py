"""Rigid-body dynamics of a serial chain of hinges, unrolled: Newton-Euler and composite inertia recursions.

Every quantity is a Python list of per-joint scalars (``lanes``). Spatial inertia is mass, first moment and inertia about the
hinge: linear in the masses, so a scaled link or a payload only adds. Friction and motor inertia come in ``dynamics``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxftc.compile.box import box
from jaxftc.numerics.barrier import unstack as lanes
from jaxftc.numerics.trigonometry import cos_sin
from jaxftc.robot.lanes import Lane, add, dot, less_products, minus, mul, trailing_constant
from jaxftc.robot.link import Link
from jaxftc.robot.mass_matrix import MassMatrix
from jaxftc.robot.model import Robot
from jaxftc.robot.vectors import ZERO, Vector, constant, cross, plus, times
from jaxftc.types import Array


class Inertia(NamedTuple):
    """Spatial inertia about a hinge's origin, in the hinge's frame."""

    mass: Lane  # kg
    moment: Vector  # kg m
    tensor: tuple[Lane, Lane, Lane, Lane, Lane, Lane]  # kg m^2, xx yy zz xy xz yz


_EMPTY = Inertia(0.0, ZERO, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def _symmetric(tensor: Sequence[Lane], v: Vector) -> Vector:
    xx, yy, zz, xy, xz, yz = tensor
    return (dot((xx, xy, xz), v), dot((xy, yy, yz), v), dot((xz, yz, zz), v))


def link_inertia(link: Link, scale: Lane = 1.0) -> Inertia:
    """Spatial inertia of a link, its mass and tensor scaled together (a denser link, same shape)."""
    tensor = link.inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
    parts = [mul(scale, v) for v in (link.mass, *constant(link.moment), *constant(tensor))]
    return Inertia(parts[0], tuple(parts[1:4]), tuple(parts[4:]))  # pyright: ignore[reportArgumentType]


def _join(a: Inertia, b: Inertia) -> Inertia:
    tensor = tuple(add(u, v) for u, v in zip(a.tensor, b.tensor, strict=True))
    return Inertia(add(a.mass, b.mass), plus(a.moment, b.moment), tensor)  # pyright: ignore[reportArgumentType]


def nominal_inertias(robot: Robot) -> list[Inertia]:
    """The model's links as base parameters: Python floats, so that zeros vanish from the compiled step."""
    return _grouped(robot, [link_inertia(link) for link in robot.links])


def scaled_inertias(robot: Robot, mass: Array, payload: Array) -> list[Inertia]:
    """The links with ``mass`` [n, ...] as factors and ``payload`` [...] kg at the tool, as base parameters."""
    inertias = [link_inertia(link, scale) for link, scale in zip(robot.links, lanes(mass), strict=True)]
    inertias[-1] = _join(inertias[-1], link_inertia(robot.payload_link, payload))
    return _grouped(robot, inertias)


def payload_inertias(robot: Robot) -> list[Inertia]:
    """1 kg at the tool on links without mass."""
    return [_EMPTY] * (robot.n - 1) + [link_inertia(robot.payload_link)]


def _grouped(robot: Robot, inertias: list[Inertia]) -> list[Inertia]:
    """Links that move the same way with fewer numbers: what lies on a link's hinge axis is given to its parent.

    Mass on the axis does not feel the hinge, so a link can do without mass, first moment along z and second moment yy (taken
    off xx, too, as a thin rod has both): the base parameters of robot identification.
    """
    still = Pose([1.0] * robot.n, [0.0] * robot.n)
    given = _EMPTY
    grouped = []
    for i in reversed(range(robot.n)):
        mass, (mx, my, mz), (xx, yy, zz, xy, xz, yz) = _join(inertias[i], given)
        grouped.append(Inertia(0.0, (mx, my, 0.0), (minus(xx, yy), 0.0, zz, xy, xz, yz)))
        given = _inertia_to_parent(robot, still, i, Inertia(mass, (0.0, 0.0, mz), (yy, yy, 0.0, 0.0, 0.0, 0.0)))
    return grouped[::-1]


class Pose(NamedTuple):
    """Cosine and sine of every hinge, shared by all recursions of one tick."""

    cos: Any  # [n, ...], or n lanes inside a recursion
    sin: Any


@box("Nominal arm: cosines and sines")
def pose(robot: Robot, q: Array) -> Pose:
    """Trigonometry of q [n, ...] rad."""
    turned = q - trailing_constant(robot.q_zero, q) if np.any(robot.q_zero) else q
    return Pose(*cos_sin(turned))


def _turn(at: Pose, i: int, v: Vector) -> Vector:
    c, s = at.cos[i], at.sin[i]
    return (less_products(mul(c, v[0]), [s], [v[1]]), add(mul(s, v[0]), mul(c, v[1])), v[2])


def _unturn(at: Pose, i: int, v: Vector) -> Vector:
    c, s = at.cos[i], at.sin[i]
    return (add(mul(c, v[0]), mul(s, v[1])), less_products(mul(c, v[1]), [s], [v[0]]), v[2])


def _to_parent(robot: Robot, at: Pose, i: int, v: Vector) -> Vector:
    turned = _turn(at, i, v)
    return tuple(dot(constant(row), turned) for row in robot.links[i].rotation)  # pyright: ignore[reportReturnType]


def _to_child(robot: Robot, at: Pose, i: int, v: Vector) -> Vector:
    aligned = tuple(dot(constant(column), v) for column in robot.links[i].rotation.T)
    return _unturn(at, i, aligned)  # pyright: ignore[reportArgumentType]


def newton_euler(
    robot: Robot,
    inertias: list[Inertia],
    at: Pose,
    qd: list[Lane] | None,
    qdd: list[Lane] | None,
    *,
    gravity: bool = True,
) -> list[Lane]:
    """Joint torques [n lanes] N m of the links alone: recursive Newton-Euler, outward then inward.

    ``qd`` or ``qdd`` of None stand for zero and cost nothing; M(q) qdd is ``qd=None, gravity=False``.
    """
    at = Pose(lanes(at.cos), lanes(at.sin))
    speed, spin, lift = ZERO, ZERO, (constant(-robot.gravity) if gravity else ZERO)
    forces: list[Vector] = []
    moments: list[Vector] = []
    for i, body in enumerate(inertias):
        offset = constant(robot.links[i].offset)
        lift = plus(lift, cross(spin, offset), cross(speed, cross(speed, offset)))
        speed, spin, lift = (_to_child(robot, at, i, v) for v in (speed, spin, lift))
        if qd is not None:
            spin = plus(spin, (mul(speed[1], qd[i]), -mul(speed[0], qd[i]), 0.0))
            speed = plus(speed, (0.0, 0.0, qd[i]))
        if qdd is not None:
            spin = plus(spin, (0.0, 0.0, qdd[i]))
        swing = cross(speed, cross(speed, body.moment))
        forces.append(plus(times(body.mass, lift), cross(spin, body.moment), swing))
        gyro = cross(speed, _symmetric(body.tensor, speed))
        moments.append(plus(_symmetric(body.tensor, spin), gyro, cross(body.moment, lift)))
    force, moment = ZERO, ZERO
    torques: list[Lane] = []
    for i in reversed(range(robot.n)):
        force, moment = plus(forces[i], force), plus(moments[i], moment)
        torques.append(moment[2])
        force, moment = _to_parent(robot, at, i, force), _to_parent(robot, at, i, moment)
        moment = plus(moment, cross(constant(robot.links[i].offset), force))
    return torques[::-1]


def mass_matrix(robot: Robot, inertias: list[Inertia], at: Pose) -> MassMatrix:
    """M(q) of the links alone, by composite inertias from the tool to the base."""
    n, at = robot.n, Pose(lanes(at.cos), lanes(at.sin))
    matrix: list[list[Lane]] = [[0.0] * n for _ in range(n)]
    composite = _EMPTY
    for i in reversed(range(n)):
        composite = _join(composite, inertias[i])
        force: Vector = (-composite.moment[1], composite.moment[0], 0.0)
        moment: Vector = (composite.tensor[4], composite.tensor[5], composite.tensor[2])
        matrix[i][i] = moment[2]
        for j in range(i, 0, -1):
            force, moment = _to_parent(robot, at, j, force), _to_parent(robot, at, j, moment)
            moment = plus(moment, cross(constant(robot.links[j].offset), force))
            matrix[i][j - 1] = matrix[j - 1][i] = moment[2]
        if i:
            composite = _inertia_to_parent(robot, at, i, composite)
    return MassMatrix(matrix)


def _inertia_to_parent(robot: Robot, at: Pose, i: int, body: Inertia) -> Inertia:
    """Turn a spatial inertia into the parent's axes, then move its origin (parallel axes, with first moments)."""
    xx, yy, zz, xy, xz, yz = body.tensor
    columns = [_to_parent(robot, at, i, v) for v in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))]
    rows = [_to_parent(robot, at, i, (columns[0][k], columns[1][k], columns[2][k])) for k in range(3)]
    moment = _to_parent(robot, at, i, body.moment)
    p = constant(robot.links[i].offset)
    far = add(mul(2.0, dot(moment, p)), mul(float(np.dot(p, p)), body.mass))

    def entry(a: int, b: int) -> Lane:
        shift = add(mul(moment[a], p[b]), mul(moment[b], p[a]), mul(p[a] * p[b], body.mass))
        return minus(add(rows[a][b], far if a == b else 0.0), shift)

    tensor = tuple(entry(a, b) for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
    return Inertia(body.mass, plus(moment, times(body.mass, p)), tensor)  # pyright: ignore[reportArgumentType]
