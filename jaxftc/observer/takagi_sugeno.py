"""Takagi-Sugeno stage, Eqs. (8) to (10), block 4: adapts to which channel is at fault.

An encoder fault moves the reading in one sample; in that time no torque can move a joint by more than the encoder's noise.
A jump of the reading therefore goes to the encoder-fault estimate b, which moves on nothing else and never leaks (a leak
would let a permanent bias drift into the motion). What does not jump is the actuator's.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.fuzzy import takagi_sugeno
from jaxftc.gains import ObserverGains
from jaxftc.types import Array


class State(NamedTuple):
    """The two estimates of this stage."""

    psi: Array  # [n, ...] rad/s^2, fuzzy share of the actuator fault
    b: Array  # [n, ...] rad, encoder fault


class Jump(NamedTuple):
    """What a jump of the reading is taken for."""

    h_s: Array  # [n, ...] grade in 0..1: no torque can have done it
    side: Array  # [n, ...] -1, 0 or 1: down or up
    moved: Array  # [n, ...] rad, booked as encoder fault
    followed: Array  # [n, ...] rad, by which the model follows a reading that is already held to be wrong


def judge(gains: ObserverGains, strange: Array, change: Array, b: Array, kicked: Array, noisy: Array) -> Jump:
    """Rules "sensor" and "both" on each reading.

    ``strange`` [n, ...] rad is what no acceleration explains of the reading's second difference: it decides. ``change`` rad
    is the change of the innovation, less noisy: it says how far. A reading whose speed is held to be wrong (``kicked`` 1)
    may only bring b back towards zero, otherwise the model follows it: booking the end of a drift would leave its whole size
    in b for ever. A reading held to be ``noisy`` is left to the innovation: booked, its jumps would make b a sum of noise,
    and followed, they would leave the model's speed to itself.
    """
    h_s = takagi_sugeno.jump_share(strange, gains.jump, gains.jump_centres, gains.jump_widths)
    size = h_s * change
    book = ((kicked == 0) & (noisy == 0)) | (jnp.abs(b + size) < jnp.abs(b))
    follow = ~book & (noisy == 0)
    return Jump(h_s, jnp.sign(strange), jnp.where(book, gains.alpha_f2 * size, 0.0), jnp.where(follow, size, 0.0))


def step(gains: ObserverGains, state: State, e: Array, jump: Jump, residual_tau: Array, threshold_tau: Array) -> State:
    """Psi_F of the next tick, from the innovation e [n, ...] rad left after the jump.

    psi_F+ = (1 - l) psi_F + (h_act alpha_F1 + h_both alpha_F3) e. Eq. (10) prints delta_fuzzy for psi_F on the right.
    """
    h = takagi_sugeno.weights(residual_tau, threshold_tau, jump.h_s, gains.tau_centres, gains.tau_widths)
    drive = (h.actuator * gains.alpha_f1 + h.both * gains.alpha_f3) * e  # Eq. (9)
    return state._replace(psi=(1 - gains.leak) * state.psi + drive)  # b has moved already, with its jump
