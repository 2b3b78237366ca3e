"""Takagi-Sugeno weights of the observer's rules, Eqs. (8), (9): which channel is at its threshold.

Two inputs, |torque residual| over its threshold and |jump of the reading| over the jump that no torque can cause, each
with the Gaussian sets "zero" and "at threshold". The paper's three rules, and the one it leaves out: (zero, zero).
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.fuzzy.membership import share
from jaxftc.types import Array


class Weights(NamedTuple):
    """Normalised firing of the rules with a torque consequent; (zero, at) is the jump's share, the rest is (zero, zero)."""

    actuator: Array  # [n, ...] (at, zero)
    both: Array  # [n, ...] (at, at)


def jump_share(jump: Array, threshold: Array, centres: Array, widths: Array) -> Array:
    """Grade h_s [n, ...] in 0..1 with which a jump [n, ...] rad can only be the encoder's."""
    return share(jnp.abs(jump) / threshold, centres, widths)


def weights(residual_tau: Array, threshold_tau: Array, h_s: Array, centres: Array, widths: Array) -> Weights:
    """Rule weights by products of shares, from the torque residual [n, ...] N m and the jump's grade h_s."""
    at = share(jnp.abs(residual_tau) / threshold_tau, centres, widths)
    return Weights(actuator=at * (1 - h_s), both=at * h_s)
