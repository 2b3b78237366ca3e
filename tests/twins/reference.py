"""Desired motion, Eqs. (34) to (36), corrected."""

import numpy as np

Array = np.ndarray

Q_START_DEG = np.array([30.0, 120.0, 30.0, 120.0, 50.0, 180.0])  # Eq. (36), deg
Q_FINAL_DEG = np.array([180.0, 30.0, 330.0, -50.0, 280.0, 16.0])  # Eq. (36), deg


def coefficients(q_0: Array, q_f: Array, t_final: float) -> tuple[Array, Array, Array, Array]:
    """Coefficients a_0..a_3 of the cubic, Eq. (35) with the minus sign in a_3; rad, rad/s, rad/s^2, rad/s^3."""
    travel = q_f - q_0
    return q_0, np.zeros_like(travel), 3 * travel / t_final**2, -2 * travel / t_final**3


def cubic(t: float, q_0: Array, q_f: Array, t_final: float) -> tuple[Array, Array, Array]:
    """Reference (q, qd, qdd), [n] in rad, rad/s, rad/s^2, at t >= 0 s, Eq. (34); at rest in q_f from t_final on."""
    if t >= t_final:
        return np.array(q_f, dtype=float), np.zeros_like(q_f, dtype=float), np.zeros_like(q_f, dtype=float)
    a_0, a_1, a_2, a_3 = coefficients(np.asarray(q_0, dtype=float), np.asarray(q_f, dtype=float), t_final)
    q = a_0 + a_1 * t + a_2 * t**2 + a_3 * t**3
    qd = a_1 + 2 * a_2 * t + 3 * a_3 * t**2
    qdd = 2 * a_2 + 6 * a_3 * t
    return q, qd, qdd
