"""Statistics that are held against the thresholds, Eq. (14), block 6.

Reading of TH = alpha sgn(lambda r + sum r): (1) compare r with alpha sgn(S) as printed, (2) compare |S| with alpha, where
S = w r + (1 - w) z and z is a leaky mean of r. We take (2): (1) calls any negative residual faulty, adds a residual to a sum
of residuals of another unit, and lets the sum grow without end.

In the torque channel r is M (psi + lead e): psi integrates the innovation e, and lead e is the proportional part beside it.
It brings the alarm forward without making psi, and with it the motors, restless.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.types import Array


class State(NamedTuple):
    """Leaky means of the residuals."""

    z_tau: Array  # [n, ...] N m
    z_q: Array  # [n, ...] rad


class Inputs(NamedTuple):
    """What a tick takes in."""

    tau: Array  # [n, ...] N m, residual of the torque channel
    q: Array  # [n, ...] rad, of the encoder channel


class Statistics(NamedTuple):
    """S of both channels, to be held against the thresholds."""

    tau: Array  # [n, ...] N m
    q: Array  # [n, ...] rad


def init(config: Config, gains: Gains, q: Array) -> State:
    """No residual yet."""
    del config, gains
    return State(jnp.zeros_like(q), jnp.zeros_like(q))


@box("Block 6: thresholds, Eq. (14)")
def step(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, Statistics]:
    """S = w r + (1 - w) z, Eq. (14) in one unit, and the leaky means."""
    del config
    own, (r_tau, r_q) = gains.diagnosis, inputs
    found = Statistics(
        tau=own.lam_tau * r_tau + (1 - own.lam_tau) * state.z_tau,
        q=own.lam_q * r_q + (1 - own.lam_q) * state.z_q,
    )
    means = State(
        z_tau=(1 - own.leak_tau) * state.z_tau + own.leak_tau * r_tau,
        z_q=(1 - own.leak_q) * state.z_q + own.leak_q * r_q,
    )
    return means, found
