"""Hypotheses about the columns of a log, each with what it leaves unexplained of the torques and the line that says it.

A hypothesis puts columns in another order, sign or unit. ``against_model`` asks which one fits.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize

from jaxftc.compile.jit import jit
from jaxftc.robot import lanes, rigid_body
from jaxftc.robot.model import Robot
from jaxftc.types import Array

TURN, DEGREE = 2 * np.pi, np.pi / 180  # rad
WIDTHS = 0.05, 0.2, 1.0  # of the mean speed, over which friction may change sign
ANY = 0.0, np.inf  # gain on gravity
RIDGE = 1e-6  # of a column's length
WIDE = 1.1  # of a joint's range, that it may reach in a unit


def _gravity(robot: Robot, q: Array) -> Array:
    inertias = rigid_body.nominal_inertias(robot)
    return lanes.stack(rigid_body.newton_euler(robot, inertias, rigid_body.pose(robot, q), None, None), q)


_gravity = jit(_gravity, static_argnums=0)


def gravity(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Torque [T, n] N m that holds the arm at q [T, n]."""
    with jax.enable_x64(True):
        return np.asarray(_gravity(robot, jnp.asarray(q.T, float))).T


def batch(robot: Robot, q: np.ndarray, ways: list[tuple[np.ndarray, np.ndarray]]) -> list[np.ndarray]:
    """Gravity [T, n] of the angles with columns in another order and sign, for each way."""
    size = 1 << (len(q) * len(ways) - 1).bit_length()  # few shapes, so that few programs
    turned = np.concatenate([q[:, order] * sign for order, sign in ways])
    padded = np.concatenate([turned, np.repeat(turned[-1:], size - len(turned), axis=0)])
    return np.split(gravity(robot, padded)[: len(turned)], len(ways))


def unexplained(
    held: np.ndarray, qd: np.ndarray, tau: np.ndarray, gains: tuple[float, float] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Share of each torque's spread [n] that gravity, friction and an offset leave, and gravity's gain.

    With ``gains`` that is kept between them, and the unit of the speeds makes no difference.
    """
    n, one = tau.shape[1], np.ones(len(tau))
    rest, gain = np.zeros(n), np.zeros(n)
    for j in range(n):
        spread = tau[:, j].std()
        if spread == 0:
            continue
        widths = [0.05] if gains is None else [part * np.abs(qd[:, j]).mean() + 1e-12 for part in WIDTHS]
        columns = np.stack([held[:, j], *(np.tanh(qd[:, j] / w) for w in widths), qd[:, j], one, -one], axis=1)
        scale = np.linalg.norm(columns, axis=0) + 1e-12
        found, left = _nonnegative(columns / scale, tau[:, j])
        gain[j] = found[0] / scale[0]
        if gains is not None and not gains[0] <= gain[j] <= gains[1]:
            gain[j] = np.clip(gain[j], *gains)
            left = _nonnegative(columns[:, 1:] / scale[1:], tau[:, j] - gain[j] * held[:, j])[1]
        rest[j] = left / np.sqrt(len(tau)) / spread
    return rest, gain


def _nonnegative(columns: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, float]:
    """Weights of columns [T, k], none negative, and what is left; with a trace of a ridge, as columns may be alike."""
    found, left = optimize.nnls(
        np.concatenate([columns, RIDGE * np.eye(columns.shape[1])]), np.append(tau, np.zeros(columns.shape[1]))
    )
    return found, float(left)


def torques(robot: Robot, held: np.ndarray, qd: np.ndarray, tau: np.ndarray, doubted: list[int]) -> list[tuple[float, str]]:
    """Hypotheses about torque columns, each with what it leaves unexplained."""
    n, names, out = robot.n, robot.joint_names, []
    if len(doubted) > 1:
        line = (
            "the torques of all joints go against gravity and friction at slow motion: their sign is turned round; give "
            "--columns with a minus before each name (tau1=-NAME)"
        )
        out.append((float(unexplained(held, qd, -tau)[0].sum()), line))
    for j in doubted:
        flipped = unexplained(held, qd, tau * np.where(np.arange(n) == j, -1, 1))[0].sum()
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
            out.append((float(unexplained(held, qd, tau[:, order])[0].sum()), line))
    return out


def angles(robot: Robot, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> list[tuple[float, str]]:
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
    held = batch(robot, q, ways)
    return [
        (float(unexplained(pull, qd[:, order] * sign, tau)[0].sum()), line)
        for pull, (order, sign), line in zip(held, ways, lines, strict=True)
    ]


def orders(robot: Robot, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> list[tuple[float, str]]:
    """Hypotheses about joints in another order, angles and torques alike, each with what it leaves unexplained."""
    n, names = robot.n, robot.joint_names
    ways = {"the other way round": np.arange(n)[::-1], "in the order of their names": np.argsort(np.argsort(names))}
    ways |= {f"shifted by {k}": np.roll(np.arange(n), -k) for k in range(1, n)}
    for j, k in itertools.combinations(range(n), 2):
        ways[f"with {j + 1} and {k + 1} ({names[j]}, {names[k]}) swapped"] = order = np.arange(n)
        order[[j, k]] = k, j
    ways = {name: order for name, order in ways.items() if (order != np.arange(n)).any()}
    held = batch(robot, q, [(order, np.ones(n)) for order in ways.values()])
    return [
        (
            float(unexplained(pull, qd[:, order], tau[:, order])[0].sum()),
            f"angles and torques fit the model when the joints are taken {name}: joint 1 is number {order[0] + 1} of the "
            "file, and so on; give --columns in the arm's order",
        )
        for pull, (name, order) in zip(held, ways.items(), strict=True)
    ]


class Fit(NamedTuple):
    """What a unit of the angles leaves unexplained, joint by joint."""

    free: np.ndarray  # [n] of the torque's spread, with any gain on gravity
    bound: np.ndarray  # [n] with a gain that torques in N m may have
    weight: np.ndarray  # [n] of the torque's spread, what is gravity
    even: bool  # as likely beforehand as what the angles were taken for
    line: str


def units(
    robot: Robot, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, gains: tuple[float, float], *, degrees: bool
) -> list[Fit]:
    """Hypotheses about units of angles; ``degrees`` says what they were taken for.

    An angle that is too small by far is explained by a gravity that is too large, so gains count. Speeds stay as they are:
    only gravity may tell.
    """
    n, one = robot.n, np.eye(robot.n, dtype=bool)
    size, most = np.abs(q).max(0), WIDE * np.maximum(np.abs(robot.q_low), np.abs(robot.q_high))
    if degrees:
        alone = [j for j in range(n) if size[j] / DEGREE > most[j]]  # the joints that said so
        ways = [(np.where(one[j], 1.0, 1 / DEGREE), _in_unit(robot, j, "deg", "the others are in rad")) for j in alone]
        ways.append((np.full(n, 1 / DEGREE), "the angles of all joints make the torques fit in rad; give --degrees False"))
        ways += [
            (np.where(one[j], 1 / DEGREE, 1.0), _in_unit(robot, j, "rad", "the others are in degrees")) for j in range(n)
        ]
    else:
        whole = "the angles of all joints make the torques fit in"
        ways = [
            (np.full(n, DEGREE), f"{whole} degrees; give --degrees True"),
            (np.full(n, TURN), f"{whole} turns; name the unit in the head, such as q1 [rev]"),
        ]
        ways += [(np.where(one[j], DEGREE, 1.0), _in_unit(robot, j, "deg", "the others are in rad")) for j in range(n)]
        ways += [(np.where(one[j], TURN, 1.0), _in_unit(robot, j, "rev", "the others are in rad")) for j in range(n)]
    ways = [(scale, line) for scale, line in ways if (scale * size <= np.maximum(most, size)).all()]
    if not ways:
        return []
    held = batch(robot, q, [(np.arange(n), scale) for scale, _ in ways])
    out = []
    for pull, (_, line) in zip(held, ways, strict=True):
        (free, _), (bound, gain) = (unexplained(pull, qd, tau, most) for most in (ANY, gains))
        even = degrees and "the others are in rad" in line  # as likely as all in degrees, where its numbers allow it
        out.append(Fit(free, bound, gain * pull.std(0) / (tau.std(0) + 1e-12), even, line))
    return out


def _in_unit(robot: Robot, j: int, unit: str, rest: str) -> str:
    what = {"rad": "rad", "deg": "degrees", "rev": "turns"}[unit]
    return (
        f"column of angle {j + 1} ({robot.joint_names[j]}) makes the torques fit in {what} while {rest}; name the unit of "
        f"every angle in the head, such as q{j + 1} [{unit}]"
    )
