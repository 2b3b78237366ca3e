"""Gaussian membership, normalised over the sets of one input, Eqs. (8) to (10) and (33)."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp

from jaxftc.types import Array, unstack


def shares(x: Array, centres: Array, widths: Array) -> list[Array]:
    """Share of each set in the grade of x: as many arrays [n, ...] as there are sets, adding up to 1.

    ``x`` [n, ...] saturates at the outermost centres; ``centres`` and ``widths`` are [sets, ...]. With product rules and a
    centre average, the rule weights are products of these shares, so that they need no normalising of their own. Computed
    as a softmax of the exponents: finite however narrow the sets are. Set by set, because a compiler that fuses takes the
    largest exponent and the sum anew for every set of a stacked array.
    """
    x = jnp.clip(x, centres[0], centres[-1])
    exponents = [-0.5 * ((x - c) / w) ** 2 for c, w in zip(unstack(centres), unstack(widths), strict=True)]
    largest = jax.lax.stop_gradient(functools.reduce(jnp.maximum, exponents))
    grades = [jnp.exp(exponent - largest) for exponent in exponents]
    scale = 1 / sum(grades)
    return [grade * scale for grade in grades]
