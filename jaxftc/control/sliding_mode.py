"""Sliding-mode control laws, Eqs. (19), (24), (30), blocks 8 and 9.

All three command an acceleration,

    qdd_ref - lam d(error)/dt - alpha sgn(s) - k_b s - psi,

and one Newton-Euler pass turns it into torque. SMC sees the raw reading and no psi; ESMC takes both faults out (the
printed U_C = +A psi would double the actuator fault); AFESMC scales ESMC's switching gain by Table 1.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.config import Config
from jaxftc.control import fuzzy_gain
from jaxftc.control.surface import Surface
from jaxftc.gains import ControlGains
from jaxftc.numerics import smooth
from jaxftc.numerics.barrier import store
from jaxftc.stages import Stages, either
from jaxftc.types import Array, Reference


class Command(NamedTuple):
    """What the law asks for."""

    qdd: Array  # [n, ...] rad/s^2
    alpha_online: Array  # [n, ...] 1


def law(
    config: Config, gains: ControlGains, surface: Surface, q: Array, psi: Array, reference: Reference, on: Stages
) -> Command:
    """Commanded acceleration at angle q [n, ...] rad, with the estimated fault psi [n, ...] rad/s^2."""
    psi, alpha = either(on.raw, (jnp.zeros_like(psi), gains.alpha_sm), (psi, gains.alpha_sm2))
    factor = jnp.ones_like(q)
    if on.online is not False:
        factor = either(on.online, fuzzy_gain.alpha_online(config, gains, q, surface.s), factor)
    switching = alpha * factor * smooth.sign(surface.s, gains.eps, hard=config.sign == "hard")  # U_a
    equivalent = reference.qdd - gains.lam * surface.errord - gains.k_b * surface.s  # U_b
    return store(Command(equivalent - switching - psi, factor))  # U_C = -A psi
