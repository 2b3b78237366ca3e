"""Rigid-body dynamics of a serial chain of hinges, unrolled: Newton-Euler and composite inertia recursions.

Every quantity is a Python list of per-joint scalars ("lanes"), each an array over the scenario axes, so that the compiled
step is straight-line arithmetic; products with the constants 0 and 1 of the arm's geometry are left out while tracing.
Spatial inertia is mass, first moment and inertia about the hinge: linear in the masses, so a scaled link or a payload only
adds. Friction and motor inertia are the door's business (dynamics.py).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.numerics.barrier import stack as join
from jaxftc.numerics.barrier import store
from jaxftc.numerics.barrier import unstack as lanes
from jaxftc.numerics.trigonometry import cos_sin
from jaxftc.robot.model import Link, Robot
from jaxftc.types import Array

Lane = Any  # float or Array [...]
Vector = tuple[Lane, Lane, Lane]
ZERO: Vector = (0.0, 0.0, 0.0)


def stack(values: list[Lane], like: Array) -> Array:
    """Lanes as one array in the shape and precision of ``like`` [n, ...]; a lane may be a plain number."""
    return store(join([jnp.broadcast_to(jnp.asarray(v, like.dtype), like.shape[1:]) for v in values]))


class Inertia(NamedTuple):
    """Spatial inertia about a hinge's origin, in the hinge's frame."""

    mass: Lane  # kg
    moment: Vector  # kg m
    tensor: tuple[Lane, Lane, Lane, Lane, Lane, Lane]  # kg m^2, xx yy zz xy xz yz


_EMPTY = Inertia(0.0, ZERO, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def _mul(a: Lane, b: Lane) -> Lane:
    for u, v in ((a, b), (b, a)):
        if isinstance(u, float):
            if u == 0.0:
                return 0.0
            if u == 1.0:
                return v
            if u == -1.0:
                return -v
    return a * b


def _sum(*terms: Lane) -> Lane:
    total: Lane = 0.0
    for term in terms:
        if isinstance(term, float) and term == 0.0:
            continue
        total = term if isinstance(total, float) and total == 0.0 else total + term
    return total


def _minus(a: Lane, b: Lane) -> Lane:
    return _sum(a, -b) if isinstance(a, float) or isinstance(b, float) else a - b


def _dot(u: Sequence[Lane], v: Sequence[Lane]) -> Lane:
    return _sum(*(_mul(a, b) for a, b in zip(u, v, strict=True)))


def _add(*vectors: Vector) -> Vector:
    return tuple(_sum(*parts) for parts in zip(*vectors, strict=True))  # pyright: ignore[reportReturnType]


def _scale(s: Lane, v: Vector) -> Vector:
    return (_mul(s, v[0]), _mul(s, v[1]), _mul(s, v[2]))


def _cross(u: Vector, v: Vector) -> Vector:
    return tuple(_minus(_mul(u[i], v[j]), _mul(u[j], v[i])) for i, j in ((1, 2), (2, 0), (0, 1)))  # pyright: ignore[reportReturnType]


def _symmetric(tensor: Sequence[Lane], v: Vector) -> Vector:
    xx, yy, zz, xy, xz, yz = tensor
    return (_dot((xx, xy, xz), v), _dot((xy, yy, yz), v), _dot((xz, yz, zz), v))


def _constant(values: np.ndarray) -> Any:
    return tuple(float(v) for v in values)


def link_inertia(link: Link, scale: Lane = 1.0) -> Inertia:
    """Spatial inertia of a link, its mass and tensor scaled together (a denser link, same shape)."""
    tensor = link.inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
    parts = [_mul(scale, v) for v in (link.mass, *_constant(link.moment), *_constant(tensor))]
    return Inertia(parts[0], tuple(parts[1:4]), tuple(parts[4:]))  # pyright: ignore[reportArgumentType]


def _join(a: Inertia, b: Inertia) -> Inertia:
    tensor = tuple(_sum(u, v) for u, v in zip(a.tensor, b.tensor, strict=True))
    return Inertia(_sum(a.mass, b.mass), _add(a.moment, b.moment), tensor)  # pyright: ignore[reportArgumentType]


def nominal_inertias(robot: Robot) -> list[Inertia]:
    """The model's links as base parameters: Python floats, so that zeros vanish from the compiled step."""
    return _grouped(robot, [link_inertia(link) for link in robot.links])


def scaled_inertias(robot: Robot, mass: Array, payload: Array) -> list[Inertia]:
    """The links with ``mass`` [n, ...] as factors and ``payload`` [...] kg at the tool, as base parameters."""
    inertias = [link_inertia(link, scale) for link, scale in zip(robot.links, lanes(mass), strict=True)]
    inertias[-1] = _join(inertias[-1], link_inertia(robot.payload_link, payload))
    return _grouped(robot, inertias)


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
        grouped.append(Inertia(0.0, (mx, my, 0.0), (_minus(xx, yy), 0.0, zz, xy, xz, yz)))
        given = _inertia_to_parent(robot, still, i, Inertia(mass, (0.0, 0.0, mz), (yy, yy, 0.0, 0.0, 0.0, 0.0)))
    return grouped[::-1]


class Pose(NamedTuple):
    """Cosine and sine of every hinge, shared by all recursions of one tick."""

    cos: Any  # [n, ...], or n lanes inside a recursion
    sin: Any


def pose(robot: Robot, q: Array) -> Pose:
    """Trigonometry of q [n, ...] rad."""
    turned = q - trailing_constant(robot.q_zero, q) if np.any(robot.q_zero) else q
    return Pose(*cos_sin(turned))


def trailing_constant(values: np.ndarray, like: Array) -> Array:
    """Per-joint numbers [n] in the dtype and with the scenario axes of ``like`` [n, ...]."""
    return jnp.asarray(values, like.dtype).reshape(values.shape + (1,) * (like.ndim - 1))


def _turn(at: Pose, i: int, v: Vector) -> Vector:
    c, s = at.cos[i], at.sin[i]
    return (_minus(_mul(c, v[0]), _mul(s, v[1])), _sum(_mul(s, v[0]), _mul(c, v[1])), v[2])


def _unturn(at: Pose, i: int, v: Vector) -> Vector:
    c, s = at.cos[i], at.sin[i]
    return (_sum(_mul(c, v[0]), _mul(s, v[1])), _minus(_mul(c, v[1]), _mul(s, v[0])), v[2])


def _to_parent(robot: Robot, at: Pose, i: int, v: Vector) -> Vector:
    turned = _turn(at, i, v)
    return tuple(_dot(_constant(row), turned) for row in robot.links[i].rotation)  # pyright: ignore[reportReturnType]


def _to_child(robot: Robot, at: Pose, i: int, v: Vector) -> Vector:
    aligned = tuple(_dot(_constant(column), v) for column in robot.links[i].rotation.T)
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
    speed, spin, lift = ZERO, ZERO, (_constant(-robot.gravity) if gravity else ZERO)
    forces: list[Vector] = []
    moments: list[Vector] = []
    for i, body in enumerate(inertias):
        offset = _constant(robot.links[i].offset)
        lift = _add(lift, _cross(spin, offset), _cross(speed, _cross(speed, offset)))
        speed, spin, lift = (_to_child(robot, at, i, v) for v in (speed, spin, lift))
        if qd is not None:
            spin = _add(spin, (_mul(speed[1], qd[i]), -_mul(speed[0], qd[i]), 0.0))
            speed = _add(speed, (0.0, 0.0, qd[i]))
        if qdd is not None:
            spin = _add(spin, (0.0, 0.0, qdd[i]))
        swing = _cross(speed, _cross(speed, body.moment))
        forces.append(_add(_scale(body.mass, lift), _cross(spin, body.moment), swing))
        gyro = _cross(speed, _symmetric(body.tensor, speed))
        moments.append(_add(_symmetric(body.tensor, spin), gyro, _cross(body.moment, lift)))
    force, moment = ZERO, ZERO
    torques: list[Lane] = []
    for i in reversed(range(robot.n)):
        force, moment = _add(forces[i], force), _add(moments[i], moment)
        torques.append(moment[2])
        force, moment = _to_parent(robot, at, i, force), _to_parent(robot, at, i, moment)
        moment = _add(moment, _cross(_constant(robot.links[i].offset), force))
    return torques[::-1]


@dataclasses.dataclass(frozen=True)
class MassMatrix:
    """M(q) [n, n] kg m^2, symmetric and positive definite; lives inside one tick, ``packed`` between two."""

    rows: list[list[Lane]]

    @classmethod
    def of(cls, matrix: Array) -> MassMatrix:
        """From an array [n, n, ...]."""
        return cls([lanes(row) for row in lanes(matrix)])

    @classmethod
    def unpacked(cls, triangle: Array) -> MassMatrix:
        """From its lower triangle [n (n + 1) / 2, ...], row after row."""
        below, rows = iter(lanes(triangle)), []
        for n in range(math.isqrt(2 * len(triangle))):
            rows.append([next(below) for _ in range(n + 1)])
        return cls([[rows[max(i, j)][min(i, j)] for j in range(len(rows))] for i in range(len(rows))])

    def packed(self, like: Array) -> Array:
        """Its lower triangle [n (n + 1) / 2, ...], each entry in the shape of ``like``'s [n, ...]."""
        return stack([entry for i, row in enumerate(self.rows) for entry in row[: i + 1]], like)

    def plus_diagonal(self, diagonal: Sequence[Lane]) -> MassMatrix:
        """M + diag(n lanes)."""
        return MassMatrix(
            [[entry + diagonal[i] if i == j else entry for j, entry in enumerate(row)] for i, row in enumerate(self.rows)]
        )

    def diagonal(self, like: Array) -> Array:
        """Its diagonal [n, ...]."""
        return stack([row[i] for i, row in enumerate(self.rows)], like)

    def matvec(self, qdd: Array) -> Array:
        """M qdd [n, ...] N m."""
        parts = lanes(qdd)
        return join([sum(m * a for m, a in zip(row, parts, strict=True)) for row in self.rows])

    def solve(self, tau: Array) -> Array:
        """M^-1 tau [n, ...] rad/s^2; each row of tau may have axes of its own between joints and scenarios."""
        return join(solve(self.rows, lanes(tau)))


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
            moment = _add(moment, _cross(_constant(robot.links[j].offset), force))
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
    p = _constant(robot.links[i].offset)
    far = _sum(_mul(2.0, _dot(moment, p)), _mul(float(np.dot(p, p)), body.mass))

    def entry(a: int, b: int) -> Lane:
        shift = _sum(_mul(moment[a], p[b]), _mul(moment[b], p[a]), _mul(p[a] * p[b], body.mass))
        return _minus(_sum(rows[a][b], far if a == b else 0.0), shift)

    tensor = tuple(entry(a, b) for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
    return Inertia(body.mass, _add(moment, _scale(body.mass, p)), tensor)  # pyright: ignore[reportArgumentType]


def solve(matrix: list[list[Lane]], right: list[Lane]) -> list[Lane]:
    """X of M x = b for a symmetric positive definite M, by an unrolled LDL^T without square roots.

    Derivatives are solutions with the same factors, M dx = db - dM x: a quarter of what the elimination's own would cost.
    """
    below = {(i, j): entry for i, row in enumerate(matrix) for j, entry in enumerate(row[: i + 1])}
    numbers = {place: entry for place, entry in below.items() if isinstance(entry, float)}

    @jax.custom_jvp
    def solution(entries: dict[tuple[int, int], Lane], right: list[Lane]) -> list[Lane]:
        return _substitute(_factors(entries | numbers, len(right)), right)

    @solution.defjvp
    def _(at: tuple[Any, Any], change: tuple[Any, Any]) -> tuple[list[Lane], list[Lane]]:
        factors = _factors(at[0] | numbers, len(right))
        x, slopes = _substitute(factors, at[1]), list(change[1])
        for (i, j), slope in change[0].items():
            slopes[i] = slopes[i] - slope * x[j]
            if i != j:
                slopes[j] = slopes[j] - slope * x[i]
        return x, _substitute(factors, slopes)

    return solution({place: entry for place, entry in below.items() if place not in numbers}, right)


class _Factors(NamedTuple):
    """M = L D L^T."""

    low: list[list[Lane]]  # L below its diagonal of ones
    inverse: list[Lane]  # 1 / D


def _factors(below: dict[tuple[int, int], Lane], n: int) -> _Factors:
    low: list[list[Lane]] = [[0.0] * n for _ in range(n)]
    scaled: list[list[Lane]] = [[0.0] * n for _ in range(n)]
    inverse: list[Lane] = [0.0] * n
    for j in range(n):
        inverse[j] = 1.0 / _minus(below[j, j], _dot(low[j][:j], scaled[j][:j]))
        for i in range(j + 1, n):
            scaled[i][j] = _minus(below[i, j], _dot(scaled[i][:j], low[j][:j]))
            low[i][j] = _mul(scaled[i][j], inverse[j])
    return _Factors(low, inverse)


def _substitute(factors: _Factors, right: list[Lane]) -> list[Lane]:
    low, n = factors.low, len(right)
    x: list[Lane] = []
    for i in range(n):
        x.append(_minus(right[i], _dot(low[i][:i], x)))
    x = [_mul(part, inverse) for part, inverse in zip(x, factors.inverse, strict=True)]
    for i in reversed(range(n)):
        x[i] = _minus(x[i], _dot([low[k][i] for k in range(i + 1, n)], x[i + 1 :]))
    return x
