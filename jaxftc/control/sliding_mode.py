"""Sliding-mode control laws, Eqs. (19), (24), (30), blocks 8 and 9.

All three command an acceleration,

    qdd_ref - lam d(error)/dt - alpha sgn(s) - k_b s - psi,

and one Newton-Euler pass turns it into torque. SMC sees the raw reading and no psi; ESMC takes both faults out (the
printed U_C = +A psi would double the actuator fault); AFESMC scales ESMC's switching gain by Table 1.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.control import fuzzy_gain, surface
from jaxftc.control.surface import Surface
from jaxftc.gains import ControlGains, Gains
from jaxftc.numerics import smooth
from jaxftc.numerics.barrier import store
from jaxftc.stages import Stages, either
from jaxftc.types import Array, Reference


class State(NamedTuple):
    """The motion of the last tick."""

    q: Array  # [n, ...] rad, angle the speed was taken from
    qd: Array  # [n, ...] rad/s


class Inputs(NamedTuple):
    """What a tick takes in."""

    q: Array  # [n, ...] rad, angle that the law sees
    acceleration: Array  # [n, ...] rad/s^2, of the last tick
    model_reset: Array  # [n, ...] rad, by which the angle was moved without a motion
    psi: Array  # [n, ...] rad/s^2, actuator fault to take out
    reference: Reference
    on: Stages


class Command(NamedTuple):
    """What the law asks for."""

    qdd: Array  # [n, ...] rad/s^2
    qd_hat: Array  # [n, ...] rad/s, speed that it sees
    s: Array  # [n, ...] rad/s, sliding surface
    alpha_online: Array  # [n, ...] 1


def init(config: Config, gains: Gains, q: Array) -> State:
    """At rest in q [n, ...] rad."""
    del config, gains
    return State(q, jnp.zeros_like(q))


@box("Block 8: sliding-mode control, Eqs. (19), (24), (30)")
def step(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, Command]:
    """Speed, surface and law of this tick."""
    before = state.q + inputs.model_reset
    weight = gains.control.speed_weight
    qd = surface.speed(weight, state.qd, inputs.acceleration, before, inputs.q, config.dt)
    at = surface.surface(gains.control, inputs.q, qd, inputs.reference)
    qdd, factor = law(config, gains.control, at, inputs.q, inputs.psi, inputs.reference, inputs.on)
    return State(inputs.q, qd), Command(qdd, qd, at.s, factor)


def law(
    config: Config, gains: ControlGains, surface: Surface, q: Array, psi: Array, reference: Reference, on: Stages
) -> tuple[Array, Array]:
    """Commanded acceleration [n, ...] rad/s^2 and alpha_online at angle q [n, ...] rad, with the estimated fault psi."""
    psi, alpha = either(on.raw, (jnp.zeros_like(psi), gains.alpha_sm), (psi, gains.alpha_sm2))
    factor = jnp.ones_like(q)
    if on.online is not False:
        factor = either(on.online, fuzzy_gain.alpha_online(config, gains, q, surface.s), factor)
    switching = alpha * factor * smooth.sign(surface.s, gains.eps, hard=config.sign == "hard")  # U_a
    equivalent = reference.qdd - gains.lam * surface.errord - gains.k_b * surface.s  # U_b
    return store((equivalent - switching - psi, factor))  # U_C = -A psi
