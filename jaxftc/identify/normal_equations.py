"""Rows of logs as summed normal equations, by folds that are held out in turn: all that a search needs of the rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxftc.identify.derivatives import Motion
from jaxftc.identify.linear_torque import regressor
from jaxftc.robot.model import Robot

MOTOR = ("motor_inertia", "viscous", "coulomb", "coulomb_asymmetry", "offset")  # n each, behind the 10 n of the links
PARTS, FOLDS = 12, 4  # a stretch is cut into parts, every fourth of which is held out together
MOVING = 0.01  # rad/s, at which a joint is said to move
MOST_ROWS = 60_000  # rows that are fitted; more say nothing new


class Sums(NamedTuple):
    """Normal equations by held-out fold; p parameters: 10 n of the links, then ``MOTOR``."""

    h: np.ndarray  # [folds, n, p, p]
    b: np.ndarray  # [folds, n, p]
    c: np.ndarray  # [folds, n] (N m)^2
    rows: np.ndarray  # [folds]

    def without(self, fold: int | None) -> Sums:
        """The sums over all folds but one; over all, if None."""
        keep = [k for k in range(len(self.rows)) if k != fold]
        return Sums(*(part[keep].sum(0) for part in self))  # pyright: ignore[reportArgumentType]

    def rms(self, fold: int, x: np.ndarray) -> np.ndarray:
        """What parameters [p] leave of the torques of a fold, rms [n] N m."""
        square = self.c[fold] - 2 * self.b[fold] @ x + np.einsum("p,jpq,q->j", x, self.h[fold], x)
        return np.sqrt(np.maximum(square, 0) / max(self.rows[fold], 1))

    def over_folds(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        """Rms [n] over all folds of an rms [n] by fold."""
        return np.sqrt(sum(r * p**2 for r, p in zip(self.rows, parts, strict=True)) / self.rows.sum())

    def held_out(self, fits: Sequence[np.ndarray]) -> float:
        """What parameters [p] by fold leave of that fold, as a share of the torque."""
        size = np.sqrt(self.c.sum(0) / self.rows.sum())
        return float(self.over_folds([self.rms(f, x) for f, x in enumerate(fits)]).sum() / size.sum())


class Rows(NamedTuple):
    """Rows of several logs, one behind the other."""

    links: np.ndarray  # [T, n, 10 n] regressor of the links
    qd: np.ndarray  # [T, n] rad/s
    qdd: np.ndarray  # [T, n] rad/s^2
    torque: np.ndarray  # [T, n] N m
    fold: np.ndarray  # [T]

    @property
    def one_way(self) -> np.ndarray:
        """Which joints [n] move in one direction only."""
        shares = np.sort([(self.qd > MOVING).mean(0), (self.qd < -MOVING).mean(0)], axis=0)  # of time: the rarer first
        return (shares[0] < 0.02) & (shares[1] > 0.1)

    def summed(self, width: float) -> Sums:
        """The normal equations, with friction that changes sign over ``width`` rad/s."""
        _, n, p = self.links.shape
        motor = motor_columns(self.qd, self.qdd, width)
        folds = np.unique(self.fold)
        h, b = np.zeros((len(folds), n, p + 5 * n, p + 5 * n)), np.zeros((len(folds), n, p + 5 * n))
        c, count = np.zeros((len(folds), n)), np.zeros(len(folds))
        for k, f in enumerate(folds):
            there = self.fold == f
            count[k] = there.sum()
            for j in range(n):
                own = np.concatenate([self.links[there, j], motor[there, j]], axis=1)
                torque = self.torque[there, j]
                place = np.r_[np.arange(p), p + n * np.arange(5) + j]
                h[k, j][np.ix_(place, place)] = own.T @ own
                b[k, j][place] = own.T @ torque
                c[k, j] = torque @ torque
        return Sums(h, b, c, count)


def gather(robot: Robot, motions: list[Motion], gain: np.ndarray) -> Rows:
    """Rows to fit, of motions and torques of ``gain`` [n] N m for one unit of the log's column."""
    every = max(1, sum(len(m.q) for m in motions) // MOST_ROWS)
    taken = [np.flatnonzero(m.inside)[::every] for m in motions]
    q, qd, qdd, tau = (
        np.concatenate([getattr(m, key)[k] for m, k in zip(motions, taken, strict=True)])
        for key in ("q", "qd", "qdd", "tau")
    )
    fold = np.concatenate([f[k] for f, k in zip(_folds(motions), taken, strict=True)])
    return Rows(regressor(robot, q, qd, qdd), qd, qdd, gain * tau, fold)


def motor_columns(qd: np.ndarray, qdd: np.ndarray, width: float) -> np.ndarray:
    """[T, n, 5]: what each of a joint's own parameters is multiplied by, in the order of ``MOTOR``."""
    t = np.tanh(qd / width)
    return np.stack([qdd, qd, t, t * t, np.ones_like(qd)], axis=2)


def _folds(motions: list[Motion]) -> list[np.ndarray]:
    """Fold of every row: a log each if there are several, otherwise parts of each stretch in turn."""
    if len(motions) >= 3:
        return [np.full(len(m.q), k % FOLDS) for k, m in enumerate(motions)]
    out = []
    for m in motions:
        fold = np.zeros(len(m.q), int)
        for k in range(m.stretch.max() + 1):
            there = np.flatnonzero(m.stretch == k)
            fold[there] = (np.arange(len(there)) * PARTS // len(there) + k) % FOLDS
        out.append(fold)
    return out
