"""Gaussian membership in the sets of one input, Eqs. (8) to (10) and (33).

Rules multiply grades and are averaged by their weights, so that grades, and their derivatives, matter up to a common factor
only: all are taken relative to the largest, a constant to the derivative, and stay finite in narrow sets. Set by set instead
of in one array: a compiler that fuses would take the largest grade anew for each set.
"""

from __future__ import annotations

import functools
import math

import jax
import jax.numpy as jnp

from jaxftc.numerics.barrier import unstack
from jaxftc.types import Array


def grades(x: Array, centres: Array, widths: Array) -> list[Array]:
    """Grade of x [n, ...] in each set, [n, ...] each, over the largest of them.

    ``x`` saturates at the outermost centres; ``centres`` and ``widths`` are [sets, ...], one set of sets for all joints.
    """
    exponents = _exponents(x, centres, widths)
    largest = jax.lax.stop_gradient(functools.reduce(jnp.maximum, exponents))
    return [jnp.exp(exponent - largest) for exponent in exponents]


def share(x: Array, centres: Array, widths: Array) -> Array:
    """Grade [n, ...] in the second of two sets over the sum of both grades; like ``grades``."""
    first, second = _exponents(x, centres, widths)
    return jax.nn.sigmoid(second - first)


def _exponents(x: Array, centres: Array, widths: Array) -> list[Array]:
    """Logarithm [...] of each set's grade of x [...], held within the outermost centres; a list over sets."""
    x, scales = jnp.clip(x, centres[0], centres[-1]), unstack(math.sqrt(0.5) / widths)
    return [-(((x - centre) * scale) ** 2) for centre, scale in zip(unstack(centres), scales, strict=True)]
