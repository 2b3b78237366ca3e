"""The equations as the paper prints them, where the other modules deviate from them.

None of these is used for control. Each has a test that shows on numbers why it cannot be meant.
"""

from collections.abc import Callable

import numpy as np

from .cascade import gaussian

Array = np.ndarray


def acceleration_eq1(mass: Array, tau: Array, bias: Array, psi: Array) -> Array:
    """Eq. (1) solved for qdd, rad/s^2: Gamma = A qdd + W + G + Psi makes Psi a torque [N m] that brakes."""
    return np.linalg.solve(mass, tau - bias - psi)


def acceleration_eq2(mass: Array, tau: Array, bias: Array, psi: Array) -> Array:
    """Eq. (2) under the integrals, rad/s^2: the same symbol Psi is an acceleration [rad/s^2] that drives."""
    return np.linalg.solve(mass, tau - bias) + psi


def acceleration_eq3(mass: Array, tau: Array, bias: Array, psi: Array) -> Array:
    """Right side of Eq. (3), A^-1 U + omega + Psi with omega = W + G: the sum of rad/s^2 and N m."""
    return np.linalg.solve(mass, tau) + bias + psi


def output_eq4(kappa_y: Array, kappa_v: Array, x_y: Array, x_v: Array) -> Array:
    """Eq. (4), [T]: filter outputs x_y = l * y [T, N_a], x_v = l * v [T, N_b], each times "filter output" chi = x."""
    return (kappa_y * x_y * x_y).sum(axis=1) + (kappa_v * x_v * x_v).sum(axis=1)


def next_output_eq5(kappa: Array, x: Array) -> Array:
    """Eq. (5), second line: Y(k + 1) = kappa^T X(k), rad."""
    return x @ kappa


def advance_eq6(
    x: Array, y_hat: Array, e: Array, v: Array, psi: Array, a: Array, b_y: Array, b_v: Array, alpha_p: float
) -> Array:
    """Eqs. (5) to (7), (10), first line, [n, N]: the scalars Psi [rad/s^2] and alpha_p e [rad] go into every state."""
    x_next = np.zeros_like(x)
    for j in range(len(y_hat)):
        x_next[j] = a @ x[j] + b_y * y_hat[j] + b_v * v[j] + psi[j] + alpha_p * e[j]
    return x_next


def psi_pi_eq6(psi: float, e: float, alpha_i: float) -> float:
    """Eqs. (6), (16): Psi_PI(k + 1) = Psi(k) + alpha_i e with the whole estimate Psi, rad/s^2, on the right."""
    return psi + alpha_i * e


def psi_sm_eq7(e: float, alpha_sm: float, alpha_sm0: float) -> float:
    """Eqs. (7), (16): Psi_SM(k + 1) with gamma = -alpha_SM0 sgn e taken at once, not summed, rad/s^2."""
    gamma = -alpha_sm0 * np.sign(e)
    return alpha_sm * np.sqrt(abs(e)) * np.sign(e) - gamma


def psi_fuzzy_eq10(delta: float, e: float, alpha_f: float) -> float:
    """Eqs. (10), (16): Psi_fuzzy(k + 1) = delta_fuzzy(k) + alpha_F e; delta_fuzzy is defined nowhere."""
    return delta + alpha_f * e


def lyapunov_eq11(e: float, psi: float, alpha_i: float, alpha_sm: float) -> float:
    """V of Eq. (11), term by term."""
    root = np.sqrt(abs(e)) * np.sign(e)
    return 2 * alpha_i * abs(e) + 0.5 * psi**2 + alpha_sm * root - psi**2


def lyapunov_matrix_eq12(alpha_sm: float) -> Array:
    """Matrix [2, 2] of the first quadratic form of Eq. (12)."""
    return alpha_sm / 2 * np.array([[alpha_sm**2, -alpha_sm], [-alpha_sm, 1.0]])


def lyapunov_rate_eq12(e: float, psi: float, alpha_sm: float) -> float:
    """V-dot of Eq. (12) with Delta Psi = 0: plus sign, e != 0."""
    zeta = np.array([np.sqrt(abs(e)) * np.sign(e), psi])
    return float(zeta @ lyapunov_matrix_eq12(alpha_sm) @ zeta / np.sqrt(abs(e)))


def condition_matrix_eq12(alpha_sm: float, delta_psi: float) -> Array:
    """Matrix [2, 2] below Eq. (12) whose positive definiteness is the paper's condition for convergence."""
    upper = [alpha_sm**2 - alpha_sm * delta_psi, -alpha_sm]
    lower = [-(alpha_sm + 2 * delta_psi), 1.0]
    return alpha_sm / 2 * np.array([upper, lower])


def residuals_eq13(y: Array, y_hat: Array) -> tuple[Array, Array]:
    """Eq. (13): one r = Y - Y_hat, rad, that must serve as r_a and as r_s."""
    r = y - y_hat
    return r, r


def threshold_eq14(r: Array, r_sum: Array, alpha: float, lam: float) -> Array:
    """Eq. (14): TH = alpha sgn(lambda r + sum r)."""
    return alpha * np.sign(lam * r + r_sum)


def faulty_eq17(r: Array, threshold: Array) -> Array:
    """Eqs. (17), (18): the channel is faulty when r >= TH, without a magnitude."""
    return r >= threshold


def torque_eq19(
    mass: Array,
    omega: Callable[[Array], Array],
    qd: Array,
    qd_ref: Array,
    qdd_ref: Array,
    r: Array,
    rd: Array,
    lam: float,
    a_sm: float,
) -> Array:
    """Eq. (19), U_a + U_b: surface from the residual r of Eq. (13) and its rate rd; omega is a function of qd alone."""
    switching = -mass @ (a_sm * np.sign(lam * r + rd))
    return switching + mass @ (qdd_ref - lam * (qd - qd_ref) - omega(qd))


def surface_rate_eq19(acceleration: Array, qdd_ref: Array, q: Array, qd_ref: Array, lam: float) -> Array:
    """S-dot of Eq. (19): acceleration - qdd_ref + lambda (X - Xd-dot), which takes a speed from a position."""
    return acceleration - qdd_ref + lam * (q - qd_ref)


def lyapunov_rate_eq21(s: Array, psi: Array, a_sm: float, k_beta: float) -> float:
    """V-dot of Eq. (21): inertia and its rate are gone, K_beta appears although the law has no such term."""
    return float(s @ (psi - a_sm * np.sign(s)) - k_beta * s @ s)


def torque_eq24(mass: Array, bracket_without_psi: Array, psi_hat: Array, bias: Array) -> Array:
    """Eqs. (24), (30): U_C = +A Psi_hat; the rest of the law in its corrected form, N m."""
    return mass @ bracket_without_psi + bias + mass @ psi_hat


def condition_eq27(s: float, psi: float, a_sm2: float) -> bool:
    """Eq. (27): S (Psi - alpha_SM2 sgn S) <= 0 with the whole fault Psi, rad/s^2."""
    return s * (psi - a_sm2 * np.sign(s)) <= 0


def bound_eq29(psi: Array, psi_hat: Array, threshold: float) -> Array:
    """Eq. (29), second line: in the faulty condition |Psi - Psi_hat| > TH at all times; one unit for all three."""
    return np.abs(psi - psi_hat) > threshold


def output_height_eq33(centre: float, width: float) -> float:
    """X_alpha of Eq. (33): the maximum of the grade of one output set over [0, 3]."""
    universe = np.append(np.linspace(0.0, 3.0, 301), centre)
    return float(gaussian(universe, centre, width).max())


def coefficients_eq35(q_0: Array, q_f: Array, t_final: float) -> tuple[Array, Array, Array, Array]:
    """Eq. (35): a_3 = +2 (q_f - q_0) / t_f^3."""
    travel = q_f - q_0
    return q_0, np.zeros_like(travel), 3 * travel / t_final**2, 2 * travel / t_final**3


# Algorithm 1 in its printed order: what a step needs of this tick, what it gives.
ALGORITHM_1 = (
    ("model", (), ("x",)),
    ("pi observer", ("x",), ("e", "psi_pi")),
    ("sliding observer", ("e",), ("psi_sm",)),
    ("fuzzy observer", ("e", "r", "threshold"), ("psi_fuzzy",)),
    ("residual", ("e", "psi_fuzzy"), ("r",)),
    ("threshold", ("r",), ("threshold",)),
    ("fault estimate", ("psi_pi", "psi_sm", "psi_fuzzy"), ("psi",)),
    ("detection", ("r", "threshold"), ("detected",)),
    ("identification", ("r", "threshold"), ("verdict",)),
)

# Eqs. (37) to (39) and the thresholds above them: number and unit, by channel.
FAULTS_EQ37 = {"actuator": (1.5, "deg"), "sensor": (5.0, "N m")}
THRESHOLDS_EQ37 = {"actuator": (1.0, "deg"), "sensor": (2.0, "N m")}
