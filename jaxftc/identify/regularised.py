"""Least squares toward the robot file's values, over parameters that a body can have (``consistent.py``).

What is made smallest is ::

    sum_j |Y_j x - g_j tau_j|^2 / sigma_j^2 + |(x - x_file) / (lambda s)|^2

sigma_j is the residual of joint j, made larger by its correlation from row to row. s is the size that a parameter may well
be wrong by, lambda how far the file is trusted in its links.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxftc.identify.consistent import inward, margin, solve
from jaxftc.identify.linear_torque import from_link
from jaxftc.identify.normal_equations import Rows, Sums
from jaxftc.robot.model import Robot

CORRELATED = 20.0  # rows that say the same: residuals of real arms are friction, not noise, and last some tenths of a second
IMPOSSIBLE, EDGE = 1e-9, 1e-6  # margins of a link: no body has it, and too near to that to start from
SHOWN, SURE = 0.01, 0.5  # share of the prior variance that the logs remove: below the first, a parameter stays as it is


class Prior(NamedTuple):
    """What the file says of the p parameters, and how wrong that may be."""

    robot: Robot
    file: np.ndarray  # [p] x_file
    deviation: np.ndarray  # [p] s; of a link's, to be multiplied by lambda


class _Start(NamedTuple):
    """Where the search for a body begins."""

    x: np.ndarray  # [p], with links that a body can have
    links: list[int]  # that are held to what a body can have
    positive: np.ndarray  # [4 n, p], rows of which positive @ x must be positive
    free: np.ndarray  # [p] bool, what may move


def from_file(robot: Robot, rows: Rows) -> Prior:
    """The file's values, and deviations that fit the size of the torques and motions."""
    total = sum(link.mass for link in robot.links)
    parts = []
    for link, length in zip(robot.links, lengths(robot), strict=True):
        mass = max(link.mass, 0.02 * total)
        parts.append(mass * np.repeat([1.0, length, length**2], [1, 3, 6]))
    torque, qd, qdd = (np.sqrt((x**2).mean(0)) for x in (rows.torque, rows.qd, rows.qdd))
    size, fast, hard = torque + 1e-9, qd + 1e-3, qdd + 1e-2
    offset = np.where(rows.one_way, 1e-4, 0.3) * size  # of one direction friction and an offset are the same: it is friction
    motor = np.concatenate([size / hard, size / fast, size, 0.005 * size, offset])
    file = _file(robot)
    return Prior(robot, file, np.concatenate([*parts, np.maximum(motor, np.abs(file[10 * robot.n :]))]))


def _file(robot: Robot) -> np.ndarray:
    mean = 0.5 * (robot.coulomb_positive + robot.coulomb_negative)
    apart = 0.5 * (robot.coulomb_positive - robot.coulomb_negative)
    links = [from_link(link) for link in robot.links]
    return np.concatenate([*links, robot.armature, robot.damping, mean, apart, np.zeros(robot.n)])


def lengths(robot: Robot) -> np.ndarray:
    """Size [n] m of each link: to the next hinge, to its centre of mass, at least 5 cm."""
    out = []
    for i, link in enumerate(robot.links):
        ahead = robot.links[i + 1].offset if i + 1 < robot.n else robot.payload_link.moment
        com = link.moment / link.mass if link.mass > 0 else np.zeros(3)
        out.append(max(0.05, np.linalg.norm(ahead), np.linalg.norm(com)))
    return np.array(out)


def fit(prior: Prior, sums: Sums, trust: float, *, bodies: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Parameters [p], and the share of each's prior variance that the rows remove.

    Args:
        prior: The file's values and how wrong they may be.
        sums: Over all folds that are fitted (``Sums.without``).
        trust: lambda; 0 keeps the file's links.
        bodies: Whether links are held to what a body can have.
    """
    n, file, deviation = prior.robot.n, prior.file, prior.deviation
    scaled = deviation.copy()
    scaled[: 10 * n] *= max(trust, 1e-6)
    model = np.einsum("p,jpq,q->j", file, sums.h, file)
    least = 1e-3 * np.sqrt(np.maximum(sums.c, model) / sums.rows) + 1e-9
    sigma = np.maximum(0.2 * np.sqrt(sums.c / sums.rows), least)
    h, b, x = np.empty(0), np.empty(0), file
    for _ in range(4):  # the weights are what is left
        weight = 1 / (CORRELATED * sigma**2)
        h = np.einsum("j,jpq->pq", weight, sums.h)
        b = np.einsum("j,jp->p", weight, sums.b)
        x = file + scaled * np.linalg.solve(h * np.outer(scaled, scaled) + np.eye(len(file)), scaled * (b - h @ file))
        left = sums.c - 2 * sums.b @ x + np.einsum("p,jpq,q->j", x, sums.h, x)
        sigma = np.maximum(np.sqrt(np.maximum(left, 0) / sums.rows), least)
    values, vectors = np.linalg.eigh(h * np.outer(deviation, deviation))
    shown = (vectors**2) @ (np.maximum(values, 0) / (1 + np.maximum(values, 0)))
    if not bodies:
        return x, shown
    x, links, positive, free = _start(prior, shown)
    if trust == 0:
        x[: 10 * n], links, free[: 10 * n] = file[: 10 * n], [], False
    weight = 1 / scaled**2
    return solve(h + np.diag(weight), b + weight * file, x, links, positive, free), shown


def fit_folds(prior: Prior, sums: Sums, trust: float, *, bodies: bool = True) -> list[np.ndarray]:
    """Parameters [p] by fold, each of a fit that has not seen it."""
    return [fit(prior, sums.without(f), trust, bodies=bodies)[0] for f in range(len(sums.rows))]


def _start(prior: Prior, shown: np.ndarray) -> _Start:
    robot, file, deviation = prior.robot, prior.file, prior.deviation
    n, p = robot.n, len(file)
    x, links, free = file.copy(), [], shown >= SHOWN
    for i, length in enumerate(lengths(robot)):
        place = slice(10 * i, 10 * i + 10)
        inside = margin(file[place], length)
        if inside < -IMPOSSIBLE or not free[place].any():
            continue
        links.append(i)
        if inside < EDGE:
            x[place], free[place] = inward(file[place], length), True
    rows = np.zeros((4 * n, p))
    for j in range(n):
        inertia, viscous, mean, apart = (10 * n + k * n + j for k in range(4))
        rows[4 * j, inertia] = rows[4 * j + 1, viscous] = 1
        rows[4 * j + 2, [mean, apart]] = 1, 1
        rows[4 * j + 3, [mean, apart]] = 1, -1
    for k in range(3):
        place = slice(10 * n + k * n, 10 * n + (k + 1) * n)
        x[place] = np.maximum(x[place], 0.01 * deviation[place])
    apart = slice(13 * n, 14 * n)
    x[apart] = np.clip(x[apart], -0.9 * x[12 * n : 13 * n], 0.9 * x[12 * n : 13 * n])
    free[10 * n :] = True
    return _Start(x, links, rows, free)
