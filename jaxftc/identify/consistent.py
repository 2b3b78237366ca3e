"""Least squares over parameters that a body can have: links with a positive pseudo-inertia, friction that brakes.

Minimise ``x' H x / 2 - b' x`` while every link's pseudo-inertia (Wensing, Kim and Slotine, 2018) ::

    J = [[tr(I)/2 1 - I, h], [h', m]]

is positive definite and every ``G x`` is positive. The problem is convex. Newton's method on it with a logarithmic barrier
reaches its one solution in some twenty steps.
"""

from __future__ import annotations

import numpy as np

LEAST = 1e-3  # of a link's pseudo-inertia at the start that must be left: torques of nothing would take it all away
BARRIERS = (1.0, 0.1, 1e-2, 1e-3)  # weight of the barrier, in units of the cost (half a squared standard deviation)
STEPS = 50
_BASIS = np.zeros((10, 4, 4))  # J = sum_k theta_k _BASIS[k]
_BASIS[0, 3, 3] = 1.0
for _k in range(3):
    _BASIS[1 + _k, _k, 3] = _BASIS[1 + _k, 3, _k] = 1.0
    _BASIS[4 + _k, :3, :3] = 0.5 * np.eye(3)
    _BASIS[4 + _k, _k, _k] = -0.5
for _k, (_a, _b) in enumerate(((0, 1), (0, 2), (1, 2))):
    _BASIS[7 + _k, _a, _b] = _BASIS[7 + _k, _b, _a] = -1.0


def pseudo_inertia(theta: np.ndarray) -> np.ndarray:
    """J [..., 4, 4] of theta [..., 10]."""
    return np.einsum("...k,kab->...ab", theta, _BASIS)


def from_pseudo_inertia(j: np.ndarray) -> np.ndarray:
    """Theta [10] of J."""
    sigma = j[:3, :3]
    tensor = np.trace(sigma) * np.eye(3) - sigma
    return np.concatenate([[j[3, 3]], j[:3, 3], tensor[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]])


def margin(theta: np.ndarray, length: float) -> float:
    """How far theta [10] is inside what a body can have: smallest over largest eigenvalue of J, in kg and ``length`` m."""
    values = np.linalg.eigvalsh(_scaled(theta, length))
    return float(values[0] / max(values[-1], 1e-12))


def _scaled(theta: np.ndarray, length: float) -> np.ndarray:
    """J [4, 4] of theta [10] in kg and ``length`` m."""
    scale = np.array([1 / length] * 3 + [1.0])
    return pseudo_inertia(theta) * np.outer(scale, scale)


def inward(theta: np.ndarray, length: float, least: float = 1e-3) -> np.ndarray:
    """The nearest theta [10] well inside what a body can have; ``length`` m is the size of the link."""
    scale = np.array([1 / length] * 3 + [1.0])
    values, vectors = np.linalg.eigh(_scaled(theta, length))
    values = np.maximum(values, least * max(values.max(), 1e-9))
    return from_pseudo_inertia((vectors * values) @ vectors.T / np.outer(scale, scale))


def solve(
    h: np.ndarray, b: np.ndarray, x: np.ndarray, links: list[int], positive: np.ndarray, free: np.ndarray
) -> np.ndarray:
    """The parameters [p], from a start that is inside.

    Args:
        h: [p, p] positive definite.
        b: [p].
        x: [p] start; the ten parameters of link i are at 10 i.
        links: Links that must be bodies.
        positive: [m, p] G.
        free: [p] parameters that move; the others stay at the start.
    """
    least = {i: LEAST * pseudo_inertia(x[10 * i : 10 * i + 10]) for i in links}
    for weight in BARRIERS:
        for _ in range(STEPS):
            slope, curve = h @ x - b, h.copy()
            for i, floor in least.items():
                place = slice(10 * i, 10 * i + 10)
                parts = np.linalg.solve(pseudo_inertia(x[place]) - floor, _BASIS)  # [10, 4, 4]
                slope[place] -= weight * np.trace(parts, axis1=1, axis2=2)
                curve[place, place] += weight * np.einsum("kab,lba->kl", parts, parts)
            room = positive @ x
            slope -= weight * positive.T @ (1 / room)
            curve += weight * (positive.T / room**2) @ positive
            step, curve = np.zeros_like(x), curve[np.ix_(free, free)]
            scale = 1 / np.sqrt(np.diag(curve))
            step[free] = -scale * np.linalg.solve(curve * np.outer(scale, scale), scale * slope[free])
            fall = -slope @ step
            if fall < 1e-6 * weight:
                break
            x = _line_search(h, b, x, step, fall, weight, least, positive)
    return x


def _line_search(h, b, x, step, fall, weight, least, positive):
    start, size = _cost(h, b, x, weight, least, positive), 1.0
    while size > 1e-9:
        tried = x + size * step
        if _cost(h, b, tried, weight, least, positive) <= start - 1e-4 * size * fall:
            return tried
        size *= 0.5
    return x


def _cost(h, b, x, weight, least, positive) -> float:
    room = positive @ x
    if (room <= 0).any():
        return np.inf
    total = 0.5 * x @ h @ x - b @ x - weight * np.log(room).sum()
    for i, floor in least.items():
        try:
            root = np.linalg.cholesky(pseudo_inertia(x[10 * i : 10 * i + 10]) - floor)
        except np.linalg.LinAlgError:
            return np.inf
        total -= 2 * weight * np.log(np.diag(root)).sum()
    return float(total)
