"""What torque thresholds follow of the motion, fitted on healthy runs: quantile regression, with a held-out check.

A joint's |S| of every moment is held against a threshold a + b |qd| + ... of its motion (``diagnosis/threshold.py``) by the
pinball loss, whose minimum is the level that a share QUANTILE of the moments stays below (Koenker and Bassett, Regression
quantiles, Econometrica 46(1), 1978). No coefficient is negative, so more motion never lowers a threshold. The fit gives the
threshold's shape; its height is set afterwards, as that of constant thresholds is, for the wanted share of false alarms.

Half of the moments check the result: a joint whose loss there is not smaller by a share WORTH than that of the best constant
keeps a constant threshold.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from jaxftc.diagnosis.threshold import FOLLOW, GAINS
from jaxftc.gains import Gains

QUANTILE = 0.999  # of the moments, below their threshold
LEAST = 0.1  # of the constant threshold, that one at rest has at least
WORTH = 0.02  # of the pinball loss
NONE = 1e-6  # rad/s, rad/s^2, 1 and N m: less is rounding, such as the weight that a vertical joint holds
SMOOTH = 1e-3  # of the constant threshold, over which the loss's corner is rounded


class Shares(NamedTuple):
    """What thresholds follow, and what that is worth."""

    values: np.ndarray  # [n, 5] in the order of FOLLOW; a threshold is alpha_tau (1 + values @ motion)
    loss: np.ndarray  # [n] held-out pinball loss over that of the best constant; 1 where a joint keeps a constant


class Moments(NamedTuple):
    """Healthy moments: what the statistic was, and how the arm moved."""

    size: np.ndarray  # [n, moments] N m, |S| of the torque channel
    motion: np.ndarray  # [n, 5, moments] in the order of FOLLOW


def fit(moments: Moments, fresh: Moments, *, quantile: float = QUANTILE, most: np.ndarray | None = None) -> Shares:
    """Shares fitted on some moments and checked on fresh ones.

    ``most`` [n, 5] bounds by how many N m a threshold may rise for a unit of each motion.
    """
    most = np.full(moments.motion.shape[:2], np.inf) if most is None else most
    fitted = [_joint(quantile, *parts) for parts in zip(*moments, *fresh, most, strict=True)]
    values, loss = (np.array(x) for x in zip(*fitted, strict=True))
    return Shares(values, loss)


def with_shares(gains: Gains, values: np.ndarray) -> Gains:
    """Gains whose torque thresholds follow the motion by shares [n, 5]."""
    return gains.replace(dict(zip(GAINS, values.T, strict=True)))


def by_joint(shares: Shares, joints: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """Shares and held-out loss by joint's name, for JSON."""
    columns = dict(zip(FOLLOW, shares.values.T, strict=True)) | {"follow_loss": shares.loss}
    return {name: dict(zip(joints, column.tolist(), strict=True)) for name, column in columns.items()}


def pinball(excess: np.ndarray, quantile: float) -> float:
    """Mean loss of |S| less its threshold [moments] N m: quantile above, 1 - quantile below."""
    return float(np.maximum(quantile * excess, (quantile - 1) * excess).mean())


def _joint(
    quantile: float, size: np.ndarray, motion: np.ndarray, fresh: np.ndarray, fresh_motion: np.ndarray, most: np.ndarray
) -> tuple[np.ndarray, float]:
    """Shares [5] of one joint, and its held-out loss over the best constant's."""
    constant = float(np.quantile(size, quantile))
    none = np.zeros(len(motion)), 1.0
    if constant <= 0:
        return none
    unit = np.maximum(motion.max(1), 1e-12)
    most = np.where(motion.max(1) > NONE, most, 0.0)
    columns = np.concatenate([np.ones((1, size.size)), motion / unit[:, None]])
    found = _quantile_regression(columns, size / constant, quantile, most * unit / constant)
    level = constant * (found[0] + found[1:] @ (fresh_motion / unit[:, None]))
    loss = pinball(fresh - level, quantile) / max(pinball(fresh - constant, quantile), 1e-300)
    return (found[1:] / found[0] / unit, loss) if loss < 1 - WORTH else none


def _quantile_regression(columns: np.ndarray, y: np.ndarray, quantile: float, most: np.ndarray) -> np.ndarray:
    """Coefficients [k + 1] of columns [k + 1, m] for a quantile of y [m]: the first from LEAST on, others in [0, most]."""

    def loss(x: np.ndarray) -> tuple[float, np.ndarray]:
        excess = y - x @ columns
        rounded = SMOOTH * np.logaddexp(0.0, excess / SMOOTH)
        slope = quantile - 1 + expit(excess / SMOOTH)
        scale = 1 / (1 - quantile)  # a loss of about 1
        return scale * float((rounded + (quantile - 1) * excess).mean()), -scale * (columns @ slope) / len(y)

    start = np.r_[1.0, np.minimum(0.05, most)]
    bounds = [(LEAST, None), *((0.0, float(high)) for high in most)]
    return minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 500}).x
