"""Desired motion, Eqs. (34) to (36): a cubic per joint from rest to rest."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxftc.robot.lanes import trailing_constant
from jaxftc.robot.model import Robot
from jaxftc.types import Array, Reference

PAPER_START = np.deg2rad((30.0, 120.0, 30.0, 120.0, 50.0, 180.0))  # rad, q_0 of Eq. (36)
PAPER_GOAL = np.deg2rad((180.0, 30.0, 330.0, -50.0, 280.0, 16.0))  # rad, q_f of Eq. (36)
MARGIN = 0.05  # of a joint's range, kept free at either end


def within_range(robot: Robot, q_start: Array, q_goal: Array) -> tuple[Array, Array]:
    """Start and goal [n, ...] rad moved into the ranges of the joints, MARGIN of a range from its ends.

    The travel stays what it is, up to the whole range. The cubic between the two leaves neither.
    """
    if not np.isfinite([robot.q_low, robot.q_high]).any():
        return q_start, q_goal
    span = robot.q_high - robot.q_low
    margin = np.where(np.isfinite(span), MARGIN * span, 0.0)
    low, high = (trailing_constant(end, q_start) for end in (robot.q_low + margin, robot.q_high - margin))
    travel = jnp.clip(q_goal - q_start, low - high, high - low)
    start = jnp.clip(q_start, low - jnp.minimum(travel, 0.0), high - jnp.maximum(travel, 0.0))
    return start, start + travel


def cubic(q_start: Array, q_goal: Array, t_final: float, t: Array) -> Reference:
    """Reference [n, ...] at time t s; at rest in the goal from t_final on.

    a_3 = -2 (q_f - q_0) / t_f^3. Eq. (35) prints +2, which ends joint 3 of the paper at 1530 deg.
    """
    travel = q_goal - q_start
    k = jnp.clip(t / t_final, 0.0, 1.0)
    moving = jnp.where(t < t_final, 1.0, 0.0).astype(travel.dtype)
    return Reference(
        q=q_start + travel * (3 * k**2 - 2 * k**3),
        qd=travel * (6 * k - 6 * k**2) / t_final,
        qdd=moving * travel * (6 - 12 * k) / t_final**2,
    )
