"""Vectors of three lanes."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxftc.robot.lanes import Lane, add, less_products, minus, mul

Vector = tuple[Lane, Lane, Lane]
ZERO: Vector = (0.0, 0.0, 0.0)


def plus(*vectors: Vector) -> Vector:
    """Their sum."""
    return tuple(add(*parts) for parts in zip(*vectors, strict=True))  # pyright: ignore[reportReturnType]


def less(u: Vector, v: Vector) -> Vector:
    """Their difference."""
    return (minus(u[0], v[0]), minus(u[1], v[1]), minus(u[2], v[2]))


def times(s: Lane, v: Vector) -> Vector:
    """A multiple of v."""
    return (mul(s, v[0]), mul(s, v[1]), mul(s, v[2]))


def cross(u: Vector, v: Vector) -> Vector:
    """Their vector product."""
    return tuple(less_products(mul(u[i], v[j]), [u[j]], [v[i]]) for i, j in ((1, 2), (2, 0), (0, 1)))  # pyright: ignore[reportReturnType]


def constant(values: np.ndarray) -> Any:
    """Numbers as lanes that are known when tracing."""
    return tuple(float(v) for v in values)
