"""Columns held against the model: at slow motion a torque is gravity, friction and an offset, and little else.

A hypothesis (as the file says; joint 3 negated; joints 2 and 4 swapped) explains each torque column by gravity at the
angles, times a gain, plus friction and an offset; gain and friction are positive. One that leaves far less than what the
file says is named.
"""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize

from jaxftc.compile.jit import jit
from jaxftc.robot import lanes, rigid_body
from jaxftc.robot.model import Robot
from jaxftc.types import Array

SAMPLES = 400  # rows looked at
SLOWEST = 0.5  # the slowest share of the rows, by joint speed
BAD, BETTER = 0.5, 0.5  # a column is doubted above this share unexplained; a hypothesis is named below this part of all
LOOK = 0.15  # of all columns together, above which their order is looked at
SPEED = 0.02  # rad/s, both ways in a tenth of the rows, at which friction is seen
WEAK = 0.2  # of the torque's spread: gravity that spreads less says nothing about a column


def _gravity(robot: Robot, q: Array) -> Array:
    inertias = rigid_body.nominal_inertias(robot)
    return lanes.stack(rigid_body.newton_euler(robot, inertias, rigid_body.pose(robot, q), None, None), q)


_gravity = jit(_gravity, static_argnums=0)


def gravity(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Torque [T, n] N m that holds the arm at q [T, n]."""
    with jax.enable_x64(True):
        return np.asarray(_gravity(robot, jnp.asarray(q.T, float))).T


def doubts(
    robot: Robot, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, *, amperes: bool = False
) -> tuple[list[str], list[str]]:
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
    plain = _batch(robot, q, [(np.arange(robot.n), np.ones(robot.n))])[0]
    rest, gain = _unexplained(plain, qd, tau)
    turns = (np.quantile(qd, [0.1, 0.9], axis=0) * [[-1.0], [1.0]] > SPEED).all(0)
    shows = turns | (plain.std(0) > WEAK * tau.std(0))  # friction changes sign, or gravity changes
    doubted = [int(j) for j in np.flatnonzero((rest > BAD) & shows) if j not in dead]
    if not doubted and (rest.mean() < LOOK or not shows.all()):
        return lines, _unit(robot, plain, tau, gain, rest, amperes)
    ways = _orders(robot, q, qd, tau)
    if doubted:
        ways = _torques(robot, plain, qd, tau, doubted) + _angles(robot, q, qd, tau) + ways
    score, name = min(ways, key=lambda way: round(way[0], 2))  # a tie is the torque's: those come first
    if score < BETTER * rest.sum():
        return [*lines, name], []
    if not doubted:
        return lines, _unit(robot, plain, tau, gain, rest, amperes)
    if not amperes and len(doubted) == shows.sum():
        return lines, ["no torque column follows the model's gravity at slow motion; are they torques of this arm?"]
    return lines, []


def _batch(robot: Robot, q: np.ndarray, ways: list[tuple[np.ndarray, np.ndarray]]) -> list[np.ndarray]:
    """Gravity [T, n] of the angles with columns in another order and sign, for each way."""
    size = 1 << (len(q) * len(ways) - 1).bit_length()  # few shapes, so that few programs
    turned = np.concatenate([q[:, order] * sign for order, sign in ways])
    padded = np.concatenate([turned, np.repeat(turned[-1:], size - len(turned), axis=0)])
    return np.split(gravity(robot, padded)[: len(turned)], len(ways))


def _unexplained(held: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Share of each torque's spread [n] that gravity, friction and an offset leave, and gravity's gain."""
    n, one = tau.shape[1], np.ones(len(tau))
    rest, gain = np.zeros(n), np.zeros(n)
    for j in range(n):
        spread = tau[:, j].std()
        if spread == 0:
            continue
        columns = np.stack([held[:, j], np.tanh(qd[:, j] / 0.05), qd[:, j], one, -one], axis=1)
        scale = np.linalg.norm(columns, axis=0) + 1e-12
        found, left = optimize.nnls(columns / scale, tau[:, j])
        rest[j], gain[j] = left / np.sqrt(len(tau)) / spread, found[0] / scale[0]
    return rest, gain


def _torques(robot: Robot, held: np.ndarray, qd: np.ndarray, tau: np.ndarray, doubted: list[int]) -> list[tuple[float, str]]:
    """Hypotheses about torque columns, each with what it leaves unexplained."""
    n, names, out = robot.n, robot.joint_names, []
    if len(doubted) > 1:
        line = (
            "the torques of all joints go against gravity and friction at slow motion: their sign is turned round; give "
            "--columns with a minus before each name (tau1=-NAME)"
        )
        out.append((float(_unexplained(held, qd, -tau)[0].sum()), line))
    for j in doubted:
        flipped = _unexplained(held, qd, tau * np.where(np.arange(n) == j, -1, 1))[0].sum()
        line = (
            f"column of torque {j + 1} ({names[j]}) goes against gravity and friction at slow motion: its sign is turned "
            f"round; give --columns with a minus before its name (tau{j + 1}=-NAME)"
        )
        out.append((float(flipped), line))
    for j, k in itertools.combinations(range(n), 2):
        if j in doubted or k in doubted:
            order = np.arange(n)
            order[[j, k]] = k, j
            line = (
                f"columns of torque {j + 1} and {k + 1} ({names[j]}, {names[k]}) fit each other's joint at slow motion: "
                "they are swapped; give --columns with the right ones"
            )
            out.append((float(_unexplained(held, qd, tau[:, order])[0].sum()), line))
    return out


def _angles(robot: Robot, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> list[tuple[float, str]]:
    """Hypotheses about angle columns, each with what it leaves unexplained."""
    n, names = robot.n, robot.joint_names
    ways = [(np.arange(n), -np.ones(n))]
    lines = [
        "the angles of all joints make the torques fit when their sign is turned round; give --columns with a minus before "
        "each name (q1=-NAME)"
    ]
    for j in range(n):
        ways.append((np.arange(n), np.where(np.arange(n) == j, -1.0, 1.0)))
        lines.append(
            f"column of angle {j + 1} ({names[j]}) makes the torques fit when its sign is turned round; give --columns with "
            f"a minus before its name (q{j + 1}=-NAME)"
        )
    for j, k in itertools.combinations(range(n), 2):
        order = np.arange(n)
        order[[j, k]] = k, j
        ways.append((order, np.ones(n)))
        lines.append(
            f"columns of angle {j + 1} and {k + 1} ({names[j]}, {names[k]}) make the torques fit when they are swapped; "
            "give --columns with the right ones"
        )
    held = _batch(robot, q, ways)
    return [
        (float(_unexplained(pull, qd[:, order] * sign, tau)[0].sum()), line)
        for pull, (order, sign), line in zip(held, ways, lines, strict=True)
    ]


def _orders(robot: Robot, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> list[tuple[float, str]]:
    """Hypotheses about joints in another order, angles and torques alike, each with what it leaves unexplained."""
    n, names = robot.n, robot.joint_names
    ways = {"the other way round": np.arange(n)[::-1], "in the order of their names": np.argsort(np.argsort(names))}
    ways |= {f"shifted by {k}": np.roll(np.arange(n), -k) for k in range(1, n)}
    for j, k in itertools.combinations(range(n), 2):
        ways[f"with {j + 1} and {k + 1} ({names[j]}, {names[k]}) swapped"] = order = np.arange(n)
        order[[j, k]] = k, j
    ways = {name: order for name, order in ways.items() if (order != np.arange(n)).any()}
    held = _batch(robot, q, [(order, np.ones(n)) for order in ways.values()])
    return [
        (
            float(_unexplained(pull, qd[:, order], tau[:, order])[0].sum()),
            f"angles and torques fit the model when the joints are taken {name}: joint 1 is number {order[0] + 1} of the "
            "file, and so on; give --columns in the arm's order",
        )
        for pull, (name, order) in zip(held, ways.items(), strict=True)
    ]


def _unit(robot: Robot, held: np.ndarray, tau: np.ndarray, gain: np.ndarray, rest: np.ndarray, amperes: bool) -> list[str]:
    sure = (gain > 0) & (rest < BAD) & (gain * held.std(0) > WEAK * tau.std(0))
    if amperes or sure.sum() < 2 or not ((gain[sure] < 0.4).all() or (gain[sure] > 2.5).all()):
        return []
    said = ", ".join(f"{1 / gain[j]:.3g} for joint {j + 1}" for j in np.flatnonzero(sure))
    return [
        f"the torque columns look like another unit, currents perhaps: the model has {said} N m for one of theirs; give "
        "--torque-per-ampere"
    ]
