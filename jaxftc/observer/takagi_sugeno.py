"""Takagi-Sugeno stage, Eqs. (8) to (10), block 4: adapts to which channel is at fault.

An encoder fault moves the reading in one sample; in that time no torque can move a joint by more than the encoder's noise.
A jump of the reading therefore goes to the encoder-fault estimate b, which moves on nothing else and never leaks (a leak
would let a permanent bias drift into the motion). What does not jump is the actuator's.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.fuzzy import takagi_sugeno
from jaxftc.gains import Gains, ObserverGains
from jaxftc.types import Array, SensorStatus

NAMES = ("alpha_f1", "alpha_f2", "alpha_f3", "leak", "jump", "tau_centres", "tau_widths", "jump_centres", "jump_widths")
GAINS = tuple(f"observer.{name}" for name in NAMES)


class State(NamedTuple):
    """The two estimates of this stage."""

    psi: Array  # [n, ...] rad/s^2, fuzzy share of the actuator fault
    b: Array  # [n, ...] rad, encoder fault


class Jump(NamedTuple):
    """What a jump of the reading is taken for."""

    h_s: Array  # [n, ...] grade in 0..1: no torque can have done it
    side: Array  # [n, ...] -1, 0 or 1: down or up
    moved: Array  # [n, ...] rad, attributed to the encoder
    followed: Array  # [n, ...] rad, by which the model follows a reading that is already held to be wrong


class Inputs(NamedTuple):
    """What a tick takes in."""

    e: Array  # [n, ...] rad, innovation left after the jump
    h_s: Array  # [n, ...] grade with which it jumped
    residual_tau: Array  # [n, ...] N m
    threshold_tau: Array  # [n, ...] N m, of this tick


def init(config: Config, gains: Gains, q: Array) -> State:
    """No fault."""
    del config, gains
    return State(jnp.zeros_like(q), jnp.zeros_like(q))


@box("Block 4: whose jump it is, Eqs. (8), (9)")
def classify_jump(gains: ObserverGains, unexplained: Array, change: Array, b: Array, sensors: SensorStatus) -> Jump:
    """Rules "sensor" and "both" on each reading.

    ``unexplained`` [n, ...] rad is what no acceleration explains of the reading's second difference: it decides. ``change``
    rad is the change of the innovation, less noisy: it says how far. A reading with a velocity transient may only bring b
    back towards zero, otherwise the model follows it: attributing the end of a drift would leave its whole size in b for
    ever. A noisy or coarse reading is left to the innovation: attributed, its jumps would make b a sum of noise or of the
    motion, and followed, they would leave the model's speed to itself.
    """
    h_s = takagi_sugeno.jump_share(unexplained, gains.jump, gains.jump_centres, gains.jump_widths)
    size, noisy = h_s * change, (sensors.noisy > 0) | (sensors.resolution > 0)
    attributed = ((sensors.transient == 0) & ~noisy) | (jnp.abs(b + size) < jnp.abs(b))
    follow = ~attributed & ~noisy
    moved = jnp.where(attributed, gains.alpha_f2 * size, 0.0)
    return Jump(h_s, jnp.sign(unexplained), moved, jnp.where(follow, size, 0.0))


@box("Block 4: Takagi-Sugeno, Eqs. (8) to (10)")
def step(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, Array]:
    """psi_F [n, ...] rad/s^2 of this tick; b has moved already, with its jump.

    psi_F+ = (1 - l) psi_F + (h_act alpha_F1 + h_both alpha_F3) e. Eq. (10) prints delta_fuzzy for psi_F on the right.
    """
    del config
    own = gains.observer
    h = takagi_sugeno.weights(inputs.residual_tau, inputs.threshold_tau, inputs.h_s, own.tau_centres, own.tau_widths)
    drive = (h.actuator * own.alpha_f1 + h.both * own.alpha_f3) * inputs.e  # Eq. (9)
    return state._replace(psi=(1 - own.leak) * state.psi + drive), state.psi
