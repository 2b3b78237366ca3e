"""Cosine and sine by polynomials, which a CPU computes eight or sixteen at a time.

XLA's CPU backend calls the C library for each single number instead, and that was an eighth of a closed loop's time. In
float32 only; other precisions take ``jnp.cos`` and ``jnp.sin``.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp

from jaxftc.types import Array

# pi/2 in three parts. The first two have so few digits that their products with a count of quarter turns are exact.
_QUARTER = (1.5703125, 4.83751296997e-4, 7.54978995489e-8)
# Minimax polynomials on [-pi/4, pi/4] in the square of the angle, highest power first (Moshier's Cephes, sinf and cosf).
_SIN = (-1.9515295891e-4, 8.3321608736e-3, -1.6666654611e-1)
_COS = (2.443315711809948e-5, -1.388731625493765e-3, 4.166664568298827e-2)


@jax.custom_jvp
def cos_sin(x: Array) -> tuple[Array, Array]:
    """Cosine and sine of x rad, any shape, to 1.2e-7 up to a thousand turns; never above 1 by more."""
    if x.dtype != jnp.float32:
        return jnp.cos(x), jnp.sin(x)
    turns = jnp.round(x * (2 / math.pi))  # quarter turns
    rest = x
    for part in _QUARTER:
        rest = rest - turns * part
    rest = jnp.clip(rest, -0.8, 0.8)  # an angle with no digits left of a turn gets some cosine, not a huge one
    square = rest * rest
    sine = rest + rest * square * polynomial(_SIN, square)
    cosine = 1 - 0.5 * square + square * square * polynomial(_COS, square)
    quadrant = turns - 4 * jnp.floor(turns * 0.25)
    odd, sin_sign = (quadrant == 1) | (quadrant == 3), jnp.where(quadrant >= 2, -1.0, 1.0)
    cos_sign = jnp.where((quadrant == 1) | (quadrant == 2), -1.0, 1.0)
    return cos_sign * jnp.where(odd, sine, cosine), sin_sign * jnp.where(odd, cosine, sine)


@cos_sin.defjvp
def _derivative(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
    cosine, sine = cos_sin(*primals)
    (turning,) = tangents
    return (cosine, sine), (-sine * turning, cosine * turning)


def polynomial(coefficients: tuple[float, ...], x: Array) -> Array:
    """Value of a polynomial from its coefficients, highest power first."""
    total = jnp.full_like(x, coefficients[0])
    for coefficient in coefficients[1:]:
        total = total * x + coefficient
    return total
