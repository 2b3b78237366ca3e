"""What torque thresholds follow of the motion, fitted on recordings of a healthy arm, for the ``Diagnoser``.

The motion is what the diagnosis estimates, low-passed as its residual is. A fault moves the arm: were a threshold to rise
with the acceleration by as much as the joint's own inertia, the fault would lift it as fast as the residual. By each of the
motions that have the acceleration in them it may rise by a share PUSHED of that.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxftc.campaigns import follow
from jaxftc.campaigns.log_thresholds import NEVER
from jaxftc.campaigns.return_level import MIXED
from jaxftc.config import Config
from jaxftc.diagnosis.threshold import FOLLOW
from jaxftc.gains import Gains
from jaxftc.logs.diagnose import Stream
from jaxftc.logs.log import Log
from jaxftc.robot import dynamics, rigid_body
from jaxftc.schemes.diagnoser import SETTLE

PUSHED = 0.2  # of a joint's own inertia
ABOVE = 30  # moments that the level of the fit has above it, at least
POSES = 200  # of the logs, at which inertias are looked at


def fit(config: Config, gains: Gains, logs: list[Log]) -> follow.Shares:
    """Shares for gains that have been calibrated on the same logs with constant thresholds."""
    parts, blocks = [], 0
    for log in logs:  # by turns over all of them: short logs would otherwise all go to the first half
        size, motion, block = _of_log(config, gains, log)
        parts.append((size, motion, (blocks + block) % 2))
        blocks += int(block.max(initial=-1)) + 1
    size, motion, half = (np.concatenate(part, -1) for part in zip(*parts, strict=True))
    halves = [follow.Moments(size[:, half == k], motion[..., half == k]) for k in (0, 1)]
    quantile = min(follow.QUANTILE, 1 - ABOVE / max(half.sum(), 2 * ABOVE))
    return follow.fit(*halves, quantile=quantile, most=_most(config, logs))


def _of_log(config: Config, gains: Gains, log: Log) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """|S| [n, T], motion [n, 5, T] and block [T] of every moment of a log; the moments before anything is said left out.

    Thresholds that nothing reaches, with a share of one for one motion each, side by side: they are the motions.
    """
    one = {f"diagnosis.{name}": np.tile(row, (config.n, 1)) for name, row in zip(FOLLOW, np.eye(len(FOLLOW)), strict=True)}
    never = gains.replace(one | {"diagnosis.alpha_tau": NEVER, "diagnosis.alpha_q": NEVER})
    said = [said for _, said in Stream(config, never).feed(log)]
    size = np.concatenate([np.abs(part.statistic_tau[..., 0]) for part in said])
    motion = np.concatenate([part.threshold_tau for part in said]) / NEVER - 1  # [T, n, 5]
    block = np.arange(len(size)) * config.dt // MIXED
    moments = np.arange(len(size)) * config.dt >= 2 * SETTLE
    return size[moments].T, np.moveaxis(motion[moments], 0, -1), block[moments].astype(int)


def _most(config: Config, logs: list[Log]) -> np.ndarray:
    """By how many N m [n, 5] a threshold may rise for a unit of each motion."""
    poses = np.concatenate([log.q[np.isfinite(log.q).all(1)] for log in logs])
    poses = poses[:: max(1, len(poses) // POSES)].T
    robot, q = config.robot, jnp.asarray(poses)
    at = rigid_body.pose(robot, q)
    own = np.asarray(dynamics.nominal_mass(robot, at).diagonal(q))
    payload = np.asarray(rigid_body.mass_matrix(robot, rigid_body.payload_inertias(robot), at).diagonal(q))
    most = np.full((config.n, len(FOLLOW)), np.inf)
    most[:, FOLLOW.index("follow_acceleration")] = PUSHED * own.min(1)
    most[:, FOLLOW.index("follow_torque")] = PUSHED
    most[:, FOLLOW.index("follow_payload")] = PUSHED * (own / np.maximum(payload, 1e-9)).min(1)
    return most
