"""Sign, saturation and magnitude root with finite values and gradients at their kinks (design choice, Eqs. 7, 14, 19).

Nothing here knows robots. ``hard=True`` gives the printed sgn, for scoring; it has no useful gradient.
"""

from __future__ import annotations

import jax.numpy as jnp

from jaxftc.types import Array


def sign(x: Array, width: Array, *, hard: bool = False) -> Array:
    """sgn(x) as tanh(x / width), any shape; the hard form is the printed one."""
    return jnp.sign(x) if hard else jnp.tanh(x / width)


def magnitude_root(x: Array) -> Array:
    """|x|^(1/2), any shape, with gradient 0 at x = 0, where the true one is infinite."""
    nonzero = x != 0
    return jnp.where(nonzero, jnp.sqrt(jnp.abs(jnp.where(nonzero, x, 1.0))), 0.0)


def saturate(x: Array, limit: Array | float) -> Array:
    """Clip x to [-limit, limit]; gradient 1 inside, 0 outside."""
    return jnp.clip(x, -limit, limit)
