"""Takagi-Sugeno stage, Eqs. (8) to (10), block 4: adapts to which channel is at fault.

An encoder fault moves the reading in one sample; in that time no torque can move a joint by more than the encoder's noise.
A jump of the innovation therefore goes to the encoder-fault estimate b, which moves on nothing else and never leaks (a leak
would let a permanent bias drift into the motion). What does not jump is the actuator's.
"""

from __future__ import annotations

from typing import NamedTuple

from jaxftc.fuzzy import ts
from jaxftc.gains import ObserverGains
from jaxftc.types import Array


class State(NamedTuple):
    """The two estimates of this stage."""

    psi: Array  # [n, ...] rad/s^2, fuzzy share of the actuator fault
    b: Array  # [n, ...] rad, encoder fault


class Jump(NamedTuple):
    """What a jump of the innovation is taken for."""

    h_s: Array  # [n, ...] grade in 0..1: the encoder's
    moved: Array  # [n, ...] rad, booked as encoder fault


def book_jump(gains: ObserverGains, jump: Array) -> Jump:
    """Rules "sensor" and "both": share of the jump [n, ...] rad that goes to the encoder-fault estimate."""
    h_s = ts.jump_share(jump, gains.jump, gains.jump_centres, gains.jump_widths)
    return Jump(h_s, gains.alpha_f2 * h_s * jump)


def step(gains: ObserverGains, state: State, e: Array, jump: Jump, residual_tau: Array, threshold_tau: Array) -> State:
    """Estimates of the next tick, from the innovation e [n, ...] rad left after the jump.

    psi_F+ = (1 - l) psi_F + (h_act alpha_F1 + h_both alpha_F3) e. Eq. (10) prints delta_fuzzy for psi_F on the right.
    """
    h = ts.weights(residual_tau, threshold_tau, jump.h_s, gains.tau_centres, gains.tau_widths)
    drive = (h.actuator * gains.alpha_f1 + h.both * gains.alpha_f3) * e  # Eq. (9)
    return State(psi=(1 - gains.leak) * state.psi + drive, b=state.b + jump.moved)
