"""Gaussian membership, normalised over the sets of one input, Eqs. (8) to (10) and (33)."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxftc.types import Array


def shares(x: Array, centres: Array, widths: Array) -> Array:
    """Share of each set in the grade of x: [sets, n, ...], adding up to 1.

    ``x`` [n, ...] saturates at the outermost centres; ``centres`` and ``widths`` are [sets, ...]. With product rules and a
    centre average, the rule weights are products of these shares, so that they need no normalising of their own. Computed
    as a softmax of the exponents: finite however narrow the sets are.
    """
    axes = (slice(None), None)  # [sets, ...] -> [sets, 1, ...]: one set of sets for all joints
    x = jnp.clip(x, centres[0], centres[-1])
    return jax.nn.softmax(-0.5 * ((x[None] - centres[axes]) / widths[axes]) ** 2, axis=0)
