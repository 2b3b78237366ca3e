"""Arrays put together from rows and taken apart again, with a barrier where XLA would repeat or scatter the work.

XLA:CPU compiles a step of thousands of small operations into loops, and draws the arithmetic of a value into the loop that
reads it. Where rows with arithmetic of their own are joined in that loop, or a computed array is taken apart in it, the loop
becomes a function with branches for every number and is no longer vectorised: five to ten times slower, in the forward run
and in its reverse. The same goes for a sum or an ``any`` over joints: its inner loop is that over joints, and all that is
drawn into it is computed number by number. So rows are computed before they are joined, and an array before it is taken
apart or reduced. ``store`` is ``lax.optimization_barrier``: it changes numbers by rounding at most, and it survives
``vmap`` and ``grad``. XLA:CPU strips barriers before it fuses, unless it is told not to (``compile/xla.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jax.core import Tracer

T = TypeVar("T")


def store(values: T) -> T:
    """The same pytree, its traced arrays computed before anything that reads them; numbers and concrete arrays pass."""
    leaves, tree = jax.tree.flatten(values)
    traced = [k for k, leaf in enumerate(leaves) if isinstance(leaf, Tracer)]
    if not traced:
        return values
    for k, leaf in zip(traced, lax.optimization_barrier([leaves[k] for k in traced]), strict=True):
        leaves[k] = leaf
    return jax.tree.unflatten(tree, leaves)


def stack(rows: Sequence[Any], axis: int = 0) -> jax.Array:
    """``jnp.stack`` of rows that are computed first, each in a loop of its own."""
    return jnp.stack(store(list(rows)), axis=axis)


def unstack(x: jax.Array, axis: int = 0) -> list[jax.Array]:
    """Slices of x along an axis, the axis dropped, of an array that is computed first.

    By one split, whose reverse mode is one join, of rows that are computed first again; that of indexing would be a padded
    sum for each slice.
    """
    parts = lax.split(store(x), [1] * x.shape[axis], axis)
    return _slopes_stored([lax.squeeze(part, [axis]) for part in parts])


@jax.custom_jvp
def _slopes_stored(rows: list[jax.Array]) -> list[jax.Array]:
    """The rows as they are, their derivatives stored: the reverse of ``unstack`` joins rows, as ``stack`` does."""
    return rows


@_slopes_stored.defjvp
def _(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
    return primals[0], store(tangents[0])
