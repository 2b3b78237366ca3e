"""The orthonormal Laguerre bank, Eqs. (4), (5), block 1.

Transfer functions ``L_i(z) = sqrt(1 - xi^2) / (z - xi) * ((1 - xi z) / (z - xi))^i``. Each is the one before through an
all-pass, which gives a recursion without matrices::

    x_0(k+1) = xi x_0(k) + sqrt(1 - xi^2) u(k)
    x_i(k+1) = xi x_i(k) + x_{i-1}(k) - xi x_{i-1}(k+1)

It is the state-space form A, b of Eq. (5) row by row, differentiable in the pole.
"""

from __future__ import annotations

from itertools import pairwise

import jax.numpy as jnp

from jaxftc.numerics.barrier import stack, unstack
from jaxftc.types import Array


def advance(xi: Array, x: Array, u: Array) -> Array:
    """One tick of the bank: x [n, order, ...], pole xi [n, ...], input u [n, ...]."""
    now = unstack(x, axis=1)
    rows = [xi * now[0] + jnp.sqrt(1 - xi**2) * u]
    for before, this in pairwise(now):
        rows.append(xi * this + before - xi * rows[-1])
    return stack(rows, axis=1)


def steady_gain(xi: Array) -> Array:
    """Bank state of a constant unit input, the same for every function: sqrt((1 + xi) / (1 - xi))."""
    return jnp.sqrt((1 + xi) / (1 - xi))
