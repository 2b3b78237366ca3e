"""Arithmetic of lanes: per-joint scalars, each a plain number or an array over the scenario axes.

The compiled step is straight-line arithmetic of them; products with the constants 0 and 1 of an arm's geometry are left out
while tracing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from jaxftc.numerics.barrier import stack as join
from jaxftc.numerics.barrier import store
from jaxftc.types import Array

Lane = Any  # float or Array [...]


def stack(values: list[Lane], like: Array) -> Array:
    """Lanes as one array in the shape and precision of ``like`` [n, ...]; a lane may be a plain number."""
    return store(join([jnp.broadcast_to(jnp.asarray(v, like.dtype), like.shape[1:]) for v in values]))


def trailing_constant(values: np.ndarray, like: Array) -> Array:
    """Per-joint numbers [n] in the dtype and with the scenario axes of ``like`` [n, ...]."""
    return jnp.asarray(values, like.dtype).reshape(values.shape + (1,) * (like.ndim - 1))


def mul(a: Lane, b: Lane) -> Lane:
    """A b; nothing is multiplied by 0, 1 or -1."""
    for u, v in ((a, b), (b, a)):
        if isinstance(u, float):
            if u == 0.0:
                return 0.0
            if u == 1.0:
                return v
            if u == -1.0:
                return -v
    return a * b


def add(*terms: Lane) -> Lane:
    """Their sum, zeros left out."""
    total: Lane = 0.0
    for term in terms:
        if isinstance(term, float) and term == 0.0:
            continue
        total = term if isinstance(total, float) and total == 0.0 else total + term
    return total


def minus(a: Lane, b: Lane) -> Lane:
    """A - b."""
    return add(a, -b) if isinstance(a, float) or isinstance(b, float) else a - b


def less_products(a: Lane, u: Sequence[Lane], v: Sequence[Lane]) -> Lane:
    """A less the sum of products.

    Its reverse negates what comes out of a product, not what comes in from behind: XLA subtracts the first while it adds up,
    the other is an array of its own.
    """
    for x, y in zip(u, v, strict=True):
        numbers = isinstance(x, float) or isinstance(y, float)
        a = add(a, mul(mul(-1.0, x), y) if isinstance(x, float) else mul(x, mul(-1.0, y))) if numbers else _less(a, x, y)
    return a


@jax.custom_jvp
def _less(a: Array, u: Array, v: Array) -> Array:
    return a - u * v


def _less_slopes(at: tuple[Any, Any, Any], change: tuple[Any, Any, Any]) -> tuple[Array, Any]:
    (a, u, v), (da, du, dv) = at, change
    parts = [x * -dx for x, dx in ((v, du), (u, dv)) if not isinstance(dx, SymbolicZero)]
    return a - u * v, sum(parts, start=da) if not isinstance(da, SymbolicZero) else sum(parts[1:], start=parts[0])


_less.defjvp(_less_slopes, symbolic_zeros=True)


def dot(u: Sequence[Lane], v: Sequence[Lane]) -> Lane:
    """Sum of products."""
    return add(*(mul(a, b) for a, b in zip(u, v, strict=True)))
