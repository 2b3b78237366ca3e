"""Fuzzy factor on the switching gain, Eqs. (31) to (33), block 9."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.fuzzy import rule_table
from jaxftc.gains import ControlGains, Gains, align
from jaxftc.types import Array

GAINS = tuple(f"control.{name}" for name in ("q_centres", "q_widths", "s_centres", "s_widths", "outputs", "floor"))


@box("Block 9: fuzzy switching gain, Eqs. (31) to (33)")
def alpha_online(config: Config, gains: ControlGains, q: Array, s: Array) -> Array:
    """alpha_online [n, ...] in [floor, 3] from q [n, ...] rad and s [n, ...] rad/s, Eq. (33)."""
    table = rule_table.TABLES[config.rules]
    q_sets, s_sets = (gains.q_centres, gains.q_widths), (gains.s_centres, gains.s_widths)
    value = rule_table.infer(table, q, s, q_sets, s_sets, gains.outputs)
    return jnp.maximum(value, gains.floor)


def surface(config: Config, gains: Gains, q: np.ndarray, s: np.ndarray) -> np.ndarray:
    """alpha_online of the first joint over points q rad and s rad/s of any one shape: Table 1 as a surface."""
    points = [jnp.asarray(np.tile(np.ravel(x), (config.n, 1)), gains.control.floor.dtype) for x in (q, s)]
    return np.asarray(alpha_online(config, align(gains, 1).control, *points), float)[0].reshape(np.shape(q))
