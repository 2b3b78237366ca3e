"""Batch least squares on the one-step error: the read-out that explains each reading from the ones before."""

from __future__ import annotations

import jax
import numpy as np

from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.identify.linear_model import data, span
from jaxftc.logs.log import Log
from jaxftc.observer.readout import rounded, with_kappa


def fit_batch(config: Config, gains: Gains, log: Log) -> Gains:
    """Gains whose read-out has the least one-step error on a log, with H_y(1) = 1 exactly; poles and other gains stay.

    Per joint ``w = argmin |q - phi (origin + basis w)|^2``, columns scaled to unit length. On a log without noise it finds
    the exact model. Noise also sits in the regressors, where it biases the read-out: one-step and 50-step errors stay at the
    noise, but the free run does not (see ``fit_multistep``). And more Laguerre functions than the arm needs can fit one
    step to 1e-5 deg and explode in free run, so look at ``errors``, never at the one-step error alone.

    Args:
        config: Robot, time step and the model's orders.
        gains: Poles and a read-out to begin with; everything else in them stays.
        log: A healthy recording that starts at rest and in which every joint moves.

    Returns:
        The gains with another read-out.

    Raises:
        ValueError: the log is refused (shape, length, finiteness, start in motion, a joint that stood still), it does not
            excite a joint's model, or a gain is not allowed.
    """
    phi, q = data(config, gains, log)
    origin, basis = span(config, gains.arx)
    kappa = np.stack(
        [origin[j] + basis @ _solve(j, phi[:, j] @ basis, q[:, j] - phi[:, j] @ origin[j]) for j in range(config.n)]
    )
    with jax.enable_x64(True):
        return with_kappa(config, gains, rounded(config, gains.arx, kappa))


def _solve(joint: int, columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Least squares with scaled columns [T, p]; refuses a log that leaves some of w open."""
    length = np.linalg.norm(columns, axis=0)
    length[length == 0] = 1.0
    w, _, rank, _ = np.linalg.lstsq(columns / length, target, rcond=None)
    if rank < len(length):
        raise ValueError(
            f"the log shows only {rank} of the {len(length)} unknowns of joint {joint + 1}'s model; "
            "record a motion with changing accelerations, or lower order_a and order_b"
        )
    return w / length
