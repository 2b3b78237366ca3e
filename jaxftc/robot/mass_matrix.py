"""The mass matrix M(q): products with it and solutions of M x = b, by lanes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax

from jaxftc.numerics.barrier import stack as join
from jaxftc.numerics.barrier import unstack as lanes
from jaxftc.robot.lanes import Lane, less_products, mul, stack
from jaxftc.types import Array


@dataclasses.dataclass(frozen=True)
class MassMatrix:
    """M(q) [n, n] kg m^2, symmetric and positive definite; lives inside one tick, ``packed`` between two."""

    rows: list[list[Lane]]

    @classmethod
    def of(cls, matrix: Array) -> MassMatrix:
        """From an array [n, n, ...]."""
        return cls([lanes(row) for row in lanes(matrix)])

    @classmethod
    def unpacked(cls, triangle: Array) -> MassMatrix:
        """From its lower triangle [n (n + 1) / 2, ...], row after row."""
        below, rows = iter(lanes(triangle)), []
        for n in range(math.isqrt(2 * len(triangle))):
            rows.append([next(below) for _ in range(n + 1)])
        return cls([[rows[max(i, j)][min(i, j)] for j in range(len(rows))] for i in range(len(rows))])

    def packed(self, like: Array) -> Array:
        """Its lower triangle [n (n + 1) / 2, ...], each entry in the shape of ``like``'s [n, ...]."""
        return stack([entry for i, row in enumerate(self.rows) for entry in row[: i + 1]], like)

    def plus_diagonal(self, diagonal: Sequence[Lane]) -> MassMatrix:
        """M + diag(n lanes)."""
        return MassMatrix(
            [[entry + diagonal[i] if i == j else entry for j, entry in enumerate(row)] for i, row in enumerate(self.rows)]
        )

    def diagonal(self, like: Array) -> Array:
        """Its diagonal [n, ...]."""
        return stack([row[i] for i, row in enumerate(self.rows)], like)

    def matvec(self, qdd: Array) -> Array:
        """M qdd [n, ...] N m."""
        parts = lanes(qdd)
        return join([sum(m * a for m, a in zip(row, parts, strict=True)) for row in self.rows])

    def solve(self, tau: Array) -> Array:
        """M^-1 tau [n, ...] rad/s^2; each row of tau may have axes of its own between joints and scenarios."""
        return join(solve(self.rows, lanes(tau)))


def solve(matrix: list[list[Lane]], right: list[Lane]) -> list[Lane]:
    """X of M x = b for a symmetric positive definite M, by an unrolled LDL^T without square roots.

    Derivatives are solutions with the same factors, M dx = db - dM x: a quarter of what the elimination's own would cost.
    """
    below = {(i, j): entry for i, row in enumerate(matrix) for j, entry in enumerate(row[: i + 1])}
    numbers = {place: entry for place, entry in below.items() if isinstance(entry, float)}

    @jax.custom_jvp
    def solution(entries: dict[tuple[int, int], Lane], right: list[Lane]) -> list[Lane]:
        return _substitute(_factors(entries | numbers, len(right)), right)

    @solution.defjvp
    def _(at: tuple[Any, Any], change: tuple[Any, Any]) -> tuple[list[Lane], list[Lane]]:
        factors = _factors(at[0] | numbers, len(right))
        x, slopes = _substitute(factors, at[1]), list(change[1])
        for (i, j), slope in change[0].items():
            slopes[i] = slopes[i] + x[j] * -slope
            if i != j:
                slopes[j] = slopes[j] + x[i] * -slope
        return x, _substitute(factors, slopes)

    return solution({place: entry for place, entry in below.items() if place not in numbers}, right)


class _Factors(NamedTuple):
    """M = L D L^T."""

    low: list[list[Lane]]  # L below its diagonal of ones
    inverse: list[Lane]  # 1 / D


def _factors(below: dict[tuple[int, int], Lane], n: int) -> _Factors:
    low: list[list[Lane]] = [[0.0] * n for _ in range(n)]
    scaled: list[list[Lane]] = [[0.0] * n for _ in range(n)]
    inverse: list[Lane] = [0.0] * n
    for j in range(n):
        inverse[j] = 1.0 / less_products(below[j, j], low[j][:j], scaled[j][:j])
        for i in range(j + 1, n):
            scaled[i][j] = less_products(below[i, j], scaled[i][:j], low[j][:j])
            low[i][j] = mul(scaled[i][j], inverse[j])
    return _Factors(low, inverse)


def _substitute(factors: _Factors, right: list[Lane]) -> list[Lane]:
    low, n = factors.low, len(right)
    x: list[Lane] = []
    for i in range(n):
        x.append(less_products(right[i], low[i][:i], x))
    x = [mul(part, inverse) for part, inverse in zip(x, factors.inverse, strict=True)]
    for i in reversed(range(n)):
        x[i] = less_products(x[i], [low[k][i] for k in range(i + 1, n)], x[i + 1 :])
    return x
