"""Columns held against the model: at slow motion a torque is gravity, friction and an offset, and little else.

A hypothesis (as the file says; joint 3 negated; joints 2 and 4 swapped) explains each torque column by gravity at the
angles, times a gain, plus friction and offset. One that explains far more than what the file says is named.
"""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.compile.xla import jit
from jaxftc.robot import lanes, rigid_body
from jaxftc.robot.model import Robot
from jaxftc.types import Array

SAMPLES = 400  # rows looked at
SLOWEST = 0.5  # the slowest share of the rows, by joint speed
BAD, BETTER = 0.6, 0.5  # a column is doubted above this share unexplained; a hypothesis is named below this part of it
WEAK = 0.2  # of the torque's spread: gravity that spreads less says nothing about a column


def _gravity(robot: Robot, q: Array) -> Array:
    inertias = rigid_body.nominal_inertias(robot)
    return lanes.stack(rigid_body.newton_euler(robot, inertias, rigid_body.pose(robot, q), None, None), q)


_gravity = jit(_gravity, static_argnums=0)


def gravity(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Torque [T, n] N m that holds the arm at q [T, n]."""
    with jax.enable_x64(True):
        return np.asarray(_gravity(robot, jnp.asarray(q.T, float))).T


def doubts(robot: Robot, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, *, amperes: bool = False) -> tuple[list[str], list[str]]:
    """What is wrong with columns, and what is only noticed, one line each; from angles, speeds and torques [T, n].

    ``amperes`` says that the torques are currents, with a gain that is not known.
    """
    dead = [j for j in range(robot.n) if np.ptp(tau[:, j]) == 0 and np.ptp(q[:, j]) > 0]
    lines = [
        f"column of torque {j + 1} ({robot.joint_names[j]}) is {tau[0, j]:g} in every row while the joint moves: it is dead"
        for j in dead
    ]
    speed = (np.abs(qd) / (np.abs(qd).max(0) + 1e-12)).max(1)
    slow = np.flatnonzero(speed <= np.quantile(speed, SLOWEST))
    slow = slow[np.linspace(0, len(slow) - 1, min(SAMPLES, len(slow))).astype(int)]
    q, qd, tau = q[slow], qd[slow], tau[slow]
    plain = _batch(robot, q, [(range(robot.n), np.ones(robot.n))])[0]
    rest, gain = _unexplained(plain, qd, tau)
    doubted = [j for j in np.flatnonzero(rest > BAD) if j not in dead]
    if not doubted:
        return lines, _unit(robot, gain, rest, amperes)
    found = _torques(robot, plain, qd, tau, rest, doubted) or _angles(robot, q, qd, tau, rest, doubted)
    if found is None and not amperes and len(doubted) == robot.n:
        found = "no torque column follows the model's gravity at slow motion; are they torques of this arm?"
        return lines, [found]
    return (lines + [found], []) if found else (lines, [])


def _batch(robot: Robot, q: np.ndarray, ways: list[tuple[object, np.ndarray]]) -> list[np.ndarray]:
    """Gravity [T, n] of the angles with columns in another order and sign, for each way."""
    size = 1 << (len(q) * len(ways) - 1).bit_length()  # few shapes, so that few programs
    turned = np.concatenate([q[:, list(order)] * sign for order, sign in ways])  # pyright: ignore[reportArgumentType, reportCallIssue]
    padded = np.concatenate([turned, np.repeat(turned[-1:], size - len(turned), axis=0)])
    return np.split(gravity(robot, padded)[: len(turned)], len(ways))


def _unexplained(held: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Share of each torque's spread [n] that a positive gain on gravity, friction and an offset leave; and the gain.

    1 where gravity says nothing, unless the column goes against it.
    """
    n = tau.shape[1]
    rest, gain = np.zeros(n), np.full(n, np.nan)
    for j in range(n):
        spread = tau[:, j].std()
        columns = np.stack([np.tanh(qd[:, j] / 0.05), qd[:, j], np.ones(len(qd))], 1)
        left = tau[:, j] - columns @ np.linalg.lstsq(columns, tau[:, j], rcond=None)[0]
        pull = held[:, j] - columns @ np.linalg.lstsq(columns, held[:, j], rcond=None)[0]
        if spread == 0 or np.linalg.norm(pull) < 1e-9 or pull.std() < WEAK * spread:
            continue
        gain[j] = float(pull @ left) / float(pull @ pull)
        rest[j] = np.sqrt(np.mean((left - max(gain[j], 0.0) * pull) ** 2)) / spread
        if gain[j] < 0 and np.sqrt(np.mean((left - gain[j] * pull) ** 2)) < 0.5 * left.std():
            rest[j] = max(rest[j], 1.0)  # as far from the model as it can be
    return rest, gain


def _torques(
    robot: Robot, held: np.ndarray, qd: np.ndarray, tau: np.ndarray, rest: np.ndarray, doubted: list[int]
) -> str | None:
    names = robot.joint_names
    for j in doubted:
        flipped, _ = _unexplained(held, qd, tau * np.where(np.arange(robot.n) == j, -1, 1))
        if flipped[j] < BETTER * rest[j] and flipped[j] < BAD:
            return (
                f"column of torque {j + 1} ({names[j]}) goes against gravity at slow motion: its sign is turned round; give "
                f"--columns with a minus before its name (tau{j + 1}=-NAME)"
            )
    for j, k in itertools.combinations(range(robot.n), 2):
        if j not in doubted and k not in doubted:
            continue
        order = np.arange(robot.n)
        order[[j, k]] = k, j
        swapped, _ = _unexplained(held, qd, tau[:, order])
        if swapped[[j, k]].sum() < BETTER * rest[[j, k]].sum() and swapped[[j, k]].max() < BAD:
            return (
                f"columns of torque {j + 1} and {k + 1} ({names[j]}, {names[k]}) fit each other's joint at slow motion: they "
                "are swapped; give --columns with the right ones"
            )
    return None


def _angles(robot: Robot, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, rest: np.ndarray, doubted: list[int]) -> str | None:
    n, names = robot.n, robot.joint_names
    pairs = list(itertools.combinations(range(n), 2))
    ways = [(np.arange(n), np.where(np.arange(n) == j, -1.0, 1.0)) for j in range(n)]
    for j, k in pairs:
        order = np.arange(n)
        order[[j, k]] = k, j
        ways.append((order, np.ones(n)))
    scores = [
        _unexplained(held, qd[:, list(order)] * sign, tau)[0].sum()
        for held, (order, sign) in zip(_batch(robot, q, ways), ways, strict=True)
    ]
    best = int(np.argmin(scores))
    if scores[best] > BETTER * rest.sum():
        return None
    if best < n:
        return (
            f"column of angle {best + 1} ({names[best]}) makes the torques fit when its sign is turned round; give --columns "
            f"with a minus before its name (q{best + 1}=-NAME)"
        )
    j, k = pairs[best - n]
    return (
        f"columns of angle {j + 1} and {k + 1} ({names[j]}, {names[k]}) make the torques fit when they are swapped; give "
        "--columns with the right ones"
    )


def _unit(robot: Robot, gain: np.ndarray, rest: np.ndarray, amperes: bool) -> list[str]:
    sure = np.isfinite(gain) & (rest < BAD)
    if amperes or sure.sum() < 2 or not ((gain[sure] < 0.4).all() or (gain[sure] > 2.5).all()):
        return []
    said = ", ".join(f"{1 / gain[j]:.3g} for joint {j + 1}" for j in np.flatnonzero(sure))
    return [
        f"the torque columns look like another unit, currents perhaps: the model has {said} N m for one of theirs; give "
        "--torque-per-ampere"
    ]
