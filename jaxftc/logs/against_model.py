"""Columns held against the model: at slow motion a torque is gravity, friction and an offset, and little else.

A hypothesis (as the file says; joint 3 negated; joints 2 and 4 swapped) explains each torque column by gravity at the
angles, times a gain, plus friction and an offset; gain and friction are positive. One that leaves far less than what the
file says is named.
"""

from __future__ import annotations

import numpy as np

from jaxftc.logs.hypotheses import ANY, Fit, angles, batch, orders, torques, unexplained, units
from jaxftc.robot.model import Robot
from jaxftc.schemes.diagnoser import stiction

SAMPLES = 400  # rows looked at
SLOWEST = 0.5  # the slowest share of the rows, by joint speed
BAD, BETTER = 0.5, 0.5  # a column is doubted above this share unexplained; a hypothesis is named below this part of all
EVEN = 0.95  # of what is left, below which a unit that is as likely is taken
GOOD = 0.3  # share unexplained, above which another unit explains nothing: a quick motion is inertia throughout
WORSE = 0.05  # unexplained, that another unit of an angle may add to a joint
LOOK = 0.15  # of all columns together, above which their order is looked at
SPEED = 0.02  # rad/s, both ways in a tenth of the rows, at which friction is seen
GAINS = 0.4, 2.5  # of the model's gravity, in which torques in N m are
FAR = 20.0  # times, by which torques surely are in another unit
HELD = 1.5  # times what friction may hold, that the torque of a joint that stands never changes by beyond gravity
WEAK = 0.2  # of the torque's spread: gravity that spreads less says nothing about a column


def doubts(
    robot: Robot,
    q: np.ndarray,
    qd: np.ndarray,
    tau: np.ndarray,
    *,
    raw: bool = False,
    degrees: bool = False,
    named: bool = False,
) -> tuple[list[str], list[str]]:
    """What is wrong with columns, and what is only noticed, one line each; from angles, speeds and torques [T, n].

    ``raw`` says that the N m for one of the torques are not known, as with currents; ``degrees`` that the file has its
    angles in degrees, ``named`` that it says in which unit they are.
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
    plain = batch(robot, q, [(np.arange(robot.n), np.ones(robot.n))])[0]
    rest, gain = unexplained(plain, qd, tau)
    lines += [] if raw else _dead_angles(robot, q, tau, rest)
    turns = (np.quantile(qd, [0.1, 0.9], axis=0) * [[-1.0], [1.0]] > SPEED).all(0)
    shows = turns | (plain.std(0) > WEAK * tau.std(0))  # friction changes sign, or gravity changes
    doubted = [int(j) for j in np.flatnonzero((rest > BAD) & shows) if j not in dead]
    unit = ([], []) if raw else _unit(plain, tau, gain, rest)
    other = None if named else _angle_unit(robot, q, qd, tau, plain, raw, degrees, any(unit))
    fits = not doubted and (rest.mean() < LOOK or not shows.all())
    ways = [] if fits else orders(robot, q, qd, tau)
    if doubted:
        ways = torques(robot, plain, qd, tau, doubted) + angles(robot, q, qd, tau) + ways
    # a tie is the torque's: those come first
    score, name = min(ways, key=lambda way: round(way[0], 2), default=(np.inf, ""))
    if score < BETTER * rest.sum() and (other is None or score < other.free.sum()):
        return [*lines, name], []
    if other is not None:
        return [*lines, other.line], []
    if not doubted:
        return lines + unit[0], unit[1]
    if not raw and len(doubted) == shows.sum():
        return lines, ["no torque column follows the model's gravity at slow motion; are they torques of this arm?"]
    return lines, []


def _angle_unit(
    robot: Robot,
    q: np.ndarray,
    qd: np.ndarray,
    tau: np.ndarray,
    held: np.ndarray,
    raw: bool,
    degrees: bool,
    strange: bool,
) -> Fit | None:
    """The unit of angles that explains the torques far better than the one they were taken for, or None."""
    gains = ANY if raw else GAINS
    now, free = (unexplained(held, qd, tau, most)[0] for most in (gains, ANY))
    if (now < LOOK).all():
        return None
    left, close = free.sum(), free.sum() + WORSE if strange else 0.0  # where torques are far off, angles may be the cause
    ways = [
        way
        for way in units(robot, q, qd, tau, gains, degrees=degrees)
        if way.bound.sum() < max(close, EVEN * now.sum() if way.even else 0.0)
        or (way.free.sum() < left and _halves(way, now))
    ]
    return min(ways, key=lambda way: round(way.bound.sum(), 2)) if ways else None


def _halves(way: Fit, now: np.ndarray) -> bool:
    """Whether another unit leaves far less of a joint's torque, by gravity, and hardly more of any."""
    better = (way.bound < np.minimum(BETTER * now, GOOD)) & (now > LOOK) & (way.weight > WEAK)
    return bool(better.any() and (way.bound < now + WORSE).all())


def _dead_angles(robot: Robot, q: np.ndarray, tau: np.ndarray, rest: np.ndarray) -> list[str]:
    """A line for each joint that cannot have stood as its angle says: friction does not hold what its torque changes by."""
    changes, (known, usual) = rest * tau.std(0), stiction(robot)
    most = HELD * np.where(usual > 0, np.maximum(known, usual), np.inf)
    return [
        f"column of angle {j + 1} ({robot.joint_names[j]}) is {q[0, j]:.4g} rad in every row while its torque changes by "
        f"{np.ptp(tau[:, j]):.3g} N m, which no joint that stands holds: it is dead"
        for j in np.flatnonzero((np.ptp(q, axis=0) == 0) & (changes > most))
    ]


def _unit(held: np.ndarray, tau: np.ndarray, gain: np.ndarray, rest: np.ndarray) -> tuple[list[str], list[str]]:
    """What is wrong with the unit of the torques, and what is only noticed of it."""
    sure = (gain > 0) & (rest < BAD) & (gain * held.std(0) > WEAK * tau.std(0))
    if sure.sum() < 2 or not ((gain[sure] < GAINS[0]).all() or (gain[sure] > GAINS[1]).all()):
        return [], []
    said = ", ".join(f"{1 / gain[j]:.3g} for joint {j + 1}" for j in np.flatnonzero(sure))
    line = (
        f"the torque columns look like another unit, currents perhaps: the model has {said} N m for one of theirs; give "
        "--torque-per-ampere"
    )
    if (gain[sure] < 1 / FAR).all() or (gain[sure] > FAR).all():
        line = line.replace(
            "currents perhaps", "torques on the motor's side of the gear or shares of a rated torque perhaps"
        )
        return [f"{line} with N m for one of each joint"], []
    return [], [line]
