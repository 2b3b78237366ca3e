"""Fuzzy factor on the switching gain, Eqs. (31) to (33), block 9."""

from __future__ import annotations

import jax.numpy as jnp

from jaxftc.config import Config
from jaxftc.fuzzy import rules
from jaxftc.gains import ControlGains
from jaxftc.types import Array


def alpha_online(config: Config, gains: ControlGains, q: Array, s: Array) -> Array:
    """alpha_online [n, ...] in [floor, 3] from q [n, ...] rad and s [n, ...] rad/s, Eq. (33)."""
    table = rules.TABLES[config.rules]
    value = rules.infer(table, q, s, (gains.q_centres, gains.q_widths), (gains.s_centres, gains.s_widths), gains.outputs)
    return jnp.maximum(value, gains.floor)
