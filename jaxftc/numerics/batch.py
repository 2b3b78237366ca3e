"""Scenario axes: inside, arrays are [n, ...], joints first and scenarios trailing."""

from __future__ import annotations

from jaxftc.types import Array


def trailing(leaf: Array, rank: int, axes: int) -> Array:
    """Give a constant of own rank ``rank`` the singleton scenario axes it lacks: [n] -> [n, 1, ...].

    A leaf that has scenario axes of its own keeps them. What is known when tracing, a NumPy array, stays known.
    """
    return leaf.reshape(leaf.shape + (1,) * max(rank + axes - leaf.ndim, 0))
