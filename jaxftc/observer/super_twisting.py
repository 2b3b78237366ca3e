"""Sliding-mode extended-state stage, Eq. (7), block 3: super-twisting on the innovation."""

from __future__ import annotations

from typing import NamedTuple

from jaxftc.gains import ObserverGains
from jaxftc.numerics import smooth
from jaxftc.types import Array


class State(NamedTuple):
    """The super-twisting integral; of the printed form, which has none, psi_SM of the coming tick."""

    gamma: Array  # [n, ...] rad/s^2


def step(gains: ObserverGains, state: State, e: Array, h_s: Array | float, dt: float, *, hard: bool) -> tuple[State, Array]:
    """psi_SM of this tick [n, ...] rad/s^2; e [n, ...] rad, h_s [n, ...] the grade with which the innovation jumped.

    psi_SM = alpha_SM |e|^1/2 sgn(e) (1 - h_s) + gamma, gamma+ = gamma + T alpha_SM0 sgn(e). Eq. (7) prints gamma as
    -alpha_SM0 sgn(e) itself, which is a relay. The finite-time proof of the super-twisting algorithm needs relative degree
    one, which an angle driven by an acceleration does not have: no such claim is made here.
    """
    sgn = smooth.sign(e, gains.eps, hard=hard)
    psi = gains.alpha_sm * smooth.magnitude_root(e) * sgn * (1 - h_s) + state.gamma  # Eq. (7), corrected
    return State(state.gamma + dt * gains.alpha_sm0 * sgn), psi


def step_printed(gains: ObserverGains, state: State, e: Array, *, hard: bool) -> tuple[State, Array]:
    """psi_SM [n, ...] rad/s^2 as Eq. (7) prints it, for comparison; alpha_SM0 counts in rad/s^2 here.

    psi_SM+ = alpha_SM |e|^1/2 sgn(e) - gamma, gamma = -alpha_SM0 sgn(e): a relay, and a tick late.
    """
    sgn = smooth.sign(e, gains.eps, hard=hard)
    gamma = -gains.alpha_sm0 * sgn
    return State(gains.alpha_sm * smooth.magnitude_root(e) * sgn - gamma), state.gamma  # Eq. (7), as printed
