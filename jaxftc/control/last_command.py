"""The last command, until the next measurement shows what came of it. Shared by every scheme."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.robot import dynamics, rigid_body
from jaxftc.robot.mass_matrix import MassMatrix
from jaxftc.robot.model import Robot
from jaxftc.types import Array


class LastCommand(NamedTuple):
    """A command and the acceleration that the nominal arm should have made of it."""

    tau: Array  # [n, ...] N m, before the limits
    qdd: Array  # [n, ...] rad/s^2, acceleration that tau was computed for
    mass: Array  # [n (n + 1) / 2, ...] kg m^2, nominal inertia, lower triangle


def hold(robot: Robot, q: Array) -> LastCommand:
    """The command that holds the arm in q [n, ...] rad against gravity."""
    at, zero = rigid_body.pose(robot, q), jnp.zeros_like(q)
    gravity = dynamics.nominal_torque(robot, at, zero, zero)
    return LastCommand(gravity, zero, dynamics.nominal_mass(robot, at).packed(q))


def applied_acceleration(command: LastCommand, tau: Array) -> Array:
    """Acceleration [n, ...] rad/s^2 that the torque [n, ...] N m really commanded in the last tick stands for.

    The command was computed for ``command.qdd``; what the limits (or a log) made of it differs by M^-1 of the difference.
    """
    return command.qdd + MassMatrix.unpacked(command.mass).solve(tau - command.tau)
