"""The last command, until the next measurement shows what came of it. Shared by every scheme."""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.numerics import smooth
from jaxftc.numerics.barrier import stack
from jaxftc.robot import dynamics, rigid_body
from jaxftc.robot.model import Robot
from jaxftc.types import Array


class Pending(NamedTuple):
    """A command and the acceleration that the nominal arm should have made of it."""

    tau: Array  # [n, ...] N m, before the limits
    qdd: Array  # [n, ...] rad/s^2, acceleration that tau was computed for
    mass: Array  # [n (n + 1) / 2, ...] kg m^2, nominal inertia, lower triangle


def holding(robot: Robot, q: Array) -> Pending:
    """The command that holds the arm in q [n, ...] rad against gravity."""
    at, zero = rigid_body.pose(robot, q), jnp.zeros_like(q)
    return Pending(dynamics.nominal_torque(robot, at, zero, zero), zero, pack(dynamics.nominal_mass(robot, at), q))


def commanded(robot: Robot, pending: Pending, tau: Array) -> tuple[Array, Array]:
    """Torque [n, ...] N m that was really commanded in the last tick, and the acceleration [n, ...] rad/s^2 it stands for.

    The command was computed for ``pending.qdd``; what the limits (or a log) made of it differs by M^-1 of the difference.
    A torque that is not finite counts as the command itself, within the limits.
    """
    limit = rigid_body.trailing_constant(robot.torque_limit, pending.tau)
    tau = jnp.where(jnp.isfinite(tau), tau, smooth.saturate(pending.tau, limit))
    return tau, pending.qdd + stack(rigid_body.solve(rows(pending.mass), rigid_body.lanes(tau - pending.tau)))


def rows(mass: Array) -> list[list[rigid_body.Lane]]:
    """A lower triangle [n (n + 1) / 2, ...], row after row, as n x n lanes."""
    below, matrix = iter(rigid_body.lanes(mass)), []
    for n in range(math.isqrt(2 * len(mass))):
        matrix.append([next(below) for _ in range(n + 1)])
    return [[matrix[max(i, j)][min(i, j)] for j in range(len(matrix))] for i in range(len(matrix))]


def pack(mass: list[list[rigid_body.Lane]], like: Array) -> Array:
    """The lower triangle of n x n lanes as one array [n (n + 1) / 2, ...], each in the shape of ``like``'s [n, ...]."""
    return rigid_body.stack([entry for i, row in enumerate(mass) for entry in row[: i + 1]], like)
