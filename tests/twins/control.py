"""Control laws SMC, ESMC and AFESMC, Eqs. (19), (24), (30) and (31), corrected."""

import numpy as np

from .cascade import sign

Array = np.ndarray


def model_acceleration(mass: Array, tau: Array, bias: Array, friction: Array, psi: Array) -> Array:
    """Joint acceleration of Eqs. (1) to (3), corrected, [n] rad/s^2: M^-1 (tau - h - friction) + psi.

    psi rad/s^2 has the sign of the fault; the torque fault is M psi. With psi = 0 it is the observer's input v.
    """
    return np.linalg.solve(mass, tau - bias - friction) + psi


def surface(q_hat: Array, qd_hat: Array, q_ref: Array, qd_ref: Array, lam: Array) -> Array:
    """Sliding surface s = lam error + errord of Eq. (19), [n] rad/s, error = q_hat - q_ref rad, lam 1/s."""
    return lam * (q_hat - q_ref) + (qd_hat - qd_ref)


def acceleration(
    qdd_ref: Array, errord: Array, s: Array, psi: Array, lam: Array, a: Array, k_b: Array, eps: float | None = None
) -> Array:
    """Bracket of the law, [n] rad/s^2: qdd_ref - lam errord - a sgn(s) - k_b s - psi.

    qdd_ref, psi, a rad/s^2; errord, s, eps rad/s; lam, k_b 1/s. It is the acceleration that the nominal model would
    show, hence also the observer's input v while no torque saturates.
    """
    return qdd_ref - lam * errord - a * sign(s, eps) - k_b * s - psi


def torque(mass: Array, bracket: Array, bias: Array, friction: Array) -> Array:
    """Command [n] N m: M bracket + h + friction; mass [n, n] kg m^2, bias h = Coriolis + gravity N m, friction N m."""
    return mass @ bracket + bias + friction


def law(
    control: str,
    y: Array,
    b: Array,
    qd_hat: Array,
    q_ref: Array,
    qd_ref: Array,
    qdd_ref: Array,
    psi: Array,
    mass: Array,
    bias: Array,
    friction: Array,
    *,
    lam: Array,
    a_sm: Array,
    a_sm2: Array,
    k_b: Array,
    alpha_online: Array = 1.0,
    eps: float | None = None,
) -> dict[str, Array]:
    """One control tick: s, bracket and tau of "smc" (19), "esmc" (24) or "afesmc" (30), (31).

    y rad encoder, b rad encoder fault after this tick's update, psi rad/s^2 fault estimate. SMC knows no observer: it
    takes the raw encoder and psi = 0. qd_hat must be filtered from the same position that the law uses. mass, bias
    and friction are those of that position and speed.
    """
    if control == "smc":
        q_hat, psi_used, a = y, np.zeros_like(psi), a_sm
    elif control == "esmc":
        q_hat, psi_used, a = y - b, psi, a_sm2
    elif control == "afesmc":
        q_hat, psi_used, a = y - b, psi, a_sm2 * alpha_online
    else:
        raise ValueError(f"control must be 'smc', 'esmc' or 'afesmc', got {control!r}")
    s = surface(q_hat, qd_hat, q_ref, qd_ref, lam)
    bracket = acceleration(qdd_ref, qd_hat - qd_ref, s, psi_used, lam, a, k_b, eps)
    return {"q_hat": q_hat, "s": s, "a": a, "bracket": bracket, "tau": torque(mass, bracket, bias, friction)}
