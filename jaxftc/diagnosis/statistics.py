"""Thresholds, Eq. (14), block 6.

Reading of TH = alpha sgn(lambda r + sum r): (1) compare r with alpha sgn(S) as printed, (2) compare |S| with alpha, where
S = w r + (1 - w) z and z is a leaky mean of r. We take (2): (1) calls any negative residual faulty, adds a residual to a sum
of residuals of another unit, and lets the sum grow without end.

In the torque channel r is M (psi + lead e): psi integrates the innovation e, and lead e is the proportional part beside it.
It brings the alarm forward without making psi, and with it the motors, restless.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.gains import DiagnosisGains
from jaxftc.types import Array


class State(NamedTuple):
    """Leaky means of the residuals."""

    z_tau: Array  # [n, ...] N m
    z_q: Array  # [n, ...] rad


def init(q: Array) -> State:
    """No residual yet."""
    return State(jnp.zeros_like(q), jnp.zeros_like(q))


def step(gains: DiagnosisGains, state: State, r_tau: Array, r_q: Array) -> tuple[State, tuple[Array, Array]]:
    """Statistics S [n, ...] of both channels, N m and rad, to be held against alpha_tau and alpha_q."""
    s_tau = gains.lam_tau * r_tau + (1 - gains.lam_tau) * state.z_tau  # Eq. (14), in one unit
    s_q = gains.lam_q * r_q + (1 - gains.lam_q) * state.z_q
    state_next = State(
        z_tau=(1 - gains.leak_tau) * state.z_tau + gains.leak_tau * r_tau,
        z_q=(1 - gains.leak_q) * state.z_q + gains.leak_q * r_q,
    )
    return state_next, (s_tau, s_q)
