"""Is the observer stable? The spectral radius of its linear part, joint by joint.

The paper's Lyapunov argument, Eqs. (11), (12), uses a function that is not positive definite and a proof that needs relative
degree one, so it shows nothing here. What can be checked is the matrix that takes model and integrator from tick to tick,

    e = y - kappa x,   x+ = A x + b_y (kappa x + alpha_p e) + b_v psi,   psi+ = psi + alpha_i e,

without the fuzzy stage and with it fully on. For poles xi and the exact model the PI part is stable for
alpha_i < alpha_p^2 (1 - xi)^2 (1 - xi^2) / T^2 (found and checked numerically, not derived). The super-twisting stage is not
linear; simulation covers it.
"""

from __future__ import annotations

import numpy as np

from jaxftc.config import Config
from jaxftc.gains import Gains


def spectral_radius(config: Config, gains: Gains) -> np.ndarray:
    """Largest modulus of a pole of the observer's error, [n]; below 1 is stable.

    Only for ``input="rigid_body"``, where the joints do not couple; gains without scenario axes.
    """
    if config.input != "rigid_body":
        raise ValueError(
            'spectral_radius needs input="rigid_body"; with "torque" the joints couple and the arm closes the loop'
        )
    radii = []
    for j in range(config.n):
        plain = _error_matrix(config, gains, j, fuzzy=False)
        full = _error_matrix(config, gains, j, fuzzy=True)
        radii.append(
            max(np.abs(np.linalg.eigvals(m)).max() for m in ((plain, full) if config.observer == "ts" else (plain,)))
        )
    return np.array(radii)


def bank_matrices(xi: float, order: int) -> tuple[np.ndarray, np.ndarray]:
    """A [order, order] and b [order] of one Laguerre bank, Eq. (5), as matrices."""
    i, j = np.indices((order, order))
    below = (1 - xi**2) * (-xi) ** np.maximum(i - j - 1, 0)
    return np.where(i == j, xi, np.where(j < i, below, 0.0)), np.sqrt(1 - xi**2) * (-xi) ** np.arange(order)


def _error_matrix(config: Config, gains: Gains, joint: int, *, fuzzy: bool) -> np.ndarray:
    """State matrix of (x, psi_PI, psi_F) for a zero reading: what an error turns into in one tick."""

    def value(leaf: object) -> float:
        return float(np.asarray(leaf)[joint])

    (a_a, b_a), (a_b, b_b) = (
        bank_matrices(value(xi), order) for xi, order in ((gains.arx.xi_a, config.order_a), (gains.arx.xi_b, config.order_b))
    )
    na, nb, observer = config.order_a, config.order_b, gains.observer
    kappa = np.concatenate([np.asarray(gains.arx.kappa_a)[joint], np.asarray(gains.arx.kappa_b)[joint, 0]]).astype(float)
    size = na + nb + (2 if fuzzy else 1)
    matrix = np.zeros((size, size))
    matrix[:na, :na], matrix[na : na + nb, na : na + nb] = a_a, a_b
    matrix[:na, : na + nb] += (1 - value(observer.alpha_p)) * np.outer(b_a, kappa)
    matrix[na : na + nb, na + nb :] = b_b[:, None]
    matrix[na + nb, : na + nb], matrix[na + nb, na + nb] = -value(observer.alpha_i) * kappa, 1.0
    if fuzzy:
        matrix[-1, : na + nb] = -max(value(observer.alpha_f1), value(observer.alpha_f3)) * kappa
        matrix[-1, -1] = 1 - value(observer.leak)
    return matrix
