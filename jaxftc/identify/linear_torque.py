"""The torque of an arm as a linear function of its parameters: the regressor, a Jacobian of the inverse dynamics.

Eq. (1), measured::

    tau = sum_i Y_i(q, qd, qdd) theta_i + I_m qdd + D qd + f_c(qd) + offset

theta_i [10] is link i's mass (kg), first moment x y z (kg m) and inertia xx yy zz xy xz yz (kg m^2), about the hinge in the
hinge's frame, as ``robot.Link`` has them. The recursions are linear in theta, so the derivative at any theta is Y.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.compile.jit import jit
from jaxftc.robot import dynamics, lanes, rigid_body
from jaxftc.robot.link import Link
from jaxftc.robot.model import Robot
from jaxftc.types import Array

LINK = ("mass", "mx", "my", "mz", "ixx", "iyy", "izz", "ixy", "ixz", "iyz")  # order of theta_i
_TENSOR = ((0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2))  # where the six are in a 3 x 3
CHUNK = 4096  # rows at a time: a seven-joint arm's regressor of 1e6 rows would fill 4 GB


def from_link(link: Link) -> np.ndarray:
    """Theta [10] of a link."""
    return np.concatenate([[link.mass], link.moment, link.inertia[_TENSOR]])


def to_link(link: Link, theta: np.ndarray) -> Link:
    """A link in the place of ``link`` with mass, first moment and inertia of theta [10]."""
    tensor = np.empty((3, 3))
    tensor[_TENSOR] = tensor.T[_TENSOR] = theta[4:]
    return Link(link.rotation, link.offset, float(theta[0]), np.asarray(theta[1:4], float), tensor)


def link_torque(robot: Robot, theta: Array, q: Array, qd: Array, qdd: Array) -> Array:
    """M qdd + h [n, ...] N m of the links alone, from theta [n, 10] and the motion [n, ...]; differentiable in all.

    Motor inertia and friction are not in it.
    """
    bodies = [
        rigid_body.Inertia(row[0], (row[1], row[2], row[3]), (row[4], row[5], row[6], row[7], row[8], row[9]))
        for row in ([theta[i, k] for k in range(10)] for i in range(robot.n))
    ]
    at = rigid_body.pose(robot, q)
    return lanes.stack(rigid_body.newton_euler(robot, bodies, at, list(qd), list(qdd)), q)


def _jacobian(robot: Robot, q: Array, qd: Array, qdd: Array) -> Array:
    """Y [n, T, n, 10] of a motion [n, T]."""
    zero = jnp.zeros((robot.n, 10), q.dtype)
    return jax.jacfwd(lambda theta: link_torque(robot, theta, q, qd, qdd))(zero)


def _inverse(robot: Robot, q: Array, qd: Array, qdd: Array) -> Array:
    """Torque [n, T] N m of a model for a motion [n, T]."""
    at = rigid_body.pose(robot, q)
    return dynamics.nominal_torque(robot, at, qd, qdd) + dynamics.coulomb(robot, qd)


_jacobian = jit(_jacobian, static_argnums=0)
_inverse = jit(_inverse, static_argnums=0)


def regressor(robot: Robot, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Y [T, n, 10 n] of a motion [T, n] in float64, theta of all links one after the other."""
    return _by_chunks(_jacobian, robot, q, qd, qdd, 10 * robot.n)


def inverse(robot: Robot, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Torque [T, n] N m of a model for a motion [T, n] in float64, friction and motor inertia included."""
    return _by_chunks(_inverse, robot, q, qd, qdd, 1)[..., 0]


def _by_chunks(program: Any, robot: Robot, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, columns: int) -> np.ndarray:
    """Results [T, n, columns] of a program of motions [n, T], in float64 and by chunks of rows.

    One program serves all chunks: the last is filled up with its last row.
    """
    rows, n = q.shape
    out = np.empty((rows, n, columns))
    with jax.enable_x64(True):
        for start in range(0, rows, CHUNK):
            took = np.minimum(np.arange(start, start + min(CHUNK, _round_up(rows))), rows - 1)
            part = np.asarray(program(robot, *(jnp.asarray(x[took].T, float) for x in (q, qd, qdd))))
            size = min(len(took), rows - start)
            out[start : start + size] = np.moveaxis(part.reshape(n, len(took), columns), 1, 0)[:size]
    return out


def _round_up(rows: int) -> int:
    return CHUNK if rows >= CHUNK else 1 << (rows - 1).bit_length()
