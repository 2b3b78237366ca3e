"""The physical model of an arm from healthy logs: links, motor inertia, friction by direction, torque offset and gain.

Regularised least squares toward the robot file's values (``linear_torque`` has the equation), over all logs::

    sum_j |Y_j x - g_j tau_j|^2 / sigma_j^2 + |(x - x_file) / (lambda s)|^2

sigma_j is the residual of joint j, made larger by its correlation from row to row. s is the size that a parameter may well
be wrong by, lambda how far the file is trusted; it and the width of the friction's tanh are chosen on parts of the logs that
are not fitted. Links stay such that a body can have them (``consistent``). What the motions do not show keeps its value.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxftc import checks
from jaxftc.identify.consistent import inward, margin, solve
from jaxftc.identify.derivatives import Motion, motion
from jaxftc.identify.linear_torque import LINK, from_link, inverse, regressor, to_link
from jaxftc.logs.log import Log
from jaxftc.robot.model import Robot

MOTOR = ("motor_inertia", "viscous", "coulomb", "coulomb_asymmetry", "offset")  # n each, behind the 10 n of the links
UNIT = {"mass": "kg", "mx": "kg m", "my": "kg m", "mz": "kg m", "motor_inertia": "kg m^2", "viscous": "N m s/rad",
        "coulomb": "N m", "coulomb_asymmetry": "N m", "offset": "N m", "torque_gain": "N m/A"}  # fmt: skip
TRUST = (0.0, 0.03, 0.1, 0.3, 1.0)  # lambda of the links that are tried; 0 keeps the file's links
MOVING = 0.01  # rad/s, at which a joint is said to move
SPEEDS = (0.1, 0.05, 0.02, 0.01)  # rad/s, widths of the friction's tanh that are tried, the smoothest first
CLOSE = 1.005  # a simpler model is taken where its held-out share is within this of the best
PARTS, FOLDS = 12, 4  # a stretch is cut into parts, every fourth of which is held out together
MOST_ROWS = 60_000  # rows that are fitted; more say nothing new
IMPOSSIBLE, EDGE = 1e-9, 1e-6  # margins of a link: no body has it, and too near to that to start from
SHOWN, SURE = 0.01, 0.5  # share of the file's doubt that the logs remove: below the first, a parameter stays as it is


class Share(NamedTuple):
    """How well a model explains torques, rms by joint [n] in N m."""

    torque: np.ndarray  # of the torque as recorded
    before: np.ndarray  # of what the file's model leaves
    after: np.ndarray  # of what the identified model leaves

    @property
    def share_before(self) -> float:
        """Sum over joints of what is left, over that of the torque."""
        return float(self.before.sum() / self.torque.sum())

    @property
    def share_after(self) -> float:
        """The same of the identified model."""
        return float(self.after.sum() / self.torque.sum())


class Parameter(NamedTuple):
    """One parameter before and after."""

    name: str  # such as mass
    joint: int  # from 1; a link's parameters are those of the link that the joint moves
    unit: str
    before: float
    after: float
    shown: float  # 0..1, share of the doubt about the file's value that these logs remove
    status: str  # fitted, combined (only a sum with others is sure), or left


class Identified(NamedTuple):
    """An arm's model from its logs."""

    robot: Robot  # with the links, motor inertia and friction that were found
    gain: np.ndarray  # [n] N m for one unit of the log's torque column
    offset: np.ndarray  # [n] N m; model + offset = gain * recorded
    held_out: Share  # on parts of the logs, each by a fit that had not seen it
    parameters: tuple[Parameter, ...]
    trust: float | None  # lambda that was chosen; None: no fit was better than the file
    notes: tuple[str, ...]


class _Sums(NamedTuple):
    """Normal equations of held-out folds: everything that the search needs of the rows."""

    h: np.ndarray  # [folds, n, p, p]
    b: np.ndarray  # [folds, n, p]
    c: np.ndarray  # [folds, n]
    rows: np.ndarray  # [folds]

    def without(self, fold: int | None) -> _Sums:
        keep = [k for k in range(len(self.rows)) if k != fold]
        return _Sums(*(part[keep].sum(0) for part in self))  # pyright: ignore[reportArgumentType]

    def rms(self, fold: int, x: np.ndarray) -> np.ndarray:
        square = self.c[fold] - 2 * self.b[fold] @ x + np.einsum("p,jpq,q->j", x, self.h[fold], x)
        return np.sqrt(np.maximum(square, 0) / max(self.rows[fold], 1))


def dynamics(
    robot: Robot,
    logs: Log | Sequence[Log],
    *,
    gain: np.ndarray | Sequence[float] | None = None,
    tell: Callable[[list[tuple[str, int]]], object] = lambda left: None,
) -> Identified:
    """The physical model of an arm, from logs of the healthy arm.

    Args:
        robot: The file's model; what the logs do not show keeps its values.
        logs: One or more, of ``logs.read``.
        gain: [n] N m for one unit of the torque column; 1 if not given, or found where the logs have currents.
        tell: Called before the fit with the names and joints (from 1) of parameters that these motions do not determine.

    Returns:
        The model, how well it explains held-out parts, and what became of every parameter. It never explains them worse
        than the file's model: then it is that.

    Raises:
        ValueError: a log without torques, of another arm, or in which nothing moves.
    """
    logs = [logs] if isinstance(logs, Log) else list(logs)
    _check(robot, logs)
    motions = [motion(log) for log in logs]
    notes = [f"band of the motion: {_listed(np.min([m.band for m in motions], axis=0))} Hz by joint"]
    if gain is None and any(log.unit == "A" for log in logs):
        gain = _first_gain(robot, motions)
        notes.append(f"torque for one ampere, found on the file's model: {_listed(gain)} N m")
    gain = np.ones(robot.n) if gain is None else np.broadcast_to(np.asarray(gain, float), robot.n)
    folds = _folds(motions)
    every = max(1, sum(len(m.q) for m in motions) // MOST_ROWS)
    taken = [np.flatnonzero(m.inside)[::every] for m in motions]
    q, qd, qdd, tau = (
        np.concatenate([getattr(m, key)[k] for m, k in zip(motions, taken, strict=True)])
        for key in ("q", "qd", "qdd", "tau")
    )
    fold = np.concatenate([f[k] for f, k in zip(folds, taken, strict=True)])
    links = regressor(robot, q, qd, qdd)
    torque = gain * tau
    file = _file(robot)
    doubt = _doubt(robot, torque, qd, qdd)
    one_way = bool(_one_way(qd).any())  # then friction that drives explains the torque as well, and must not be fitted
    choices: list[tuple[float, float, float, _Sums]] = []
    for speed in SPEEDS:
        sums = _sums(links, _motor_columns(robot.n, qd, qdd, speed), torque, fold)
        fits = _fit_folds(robot, sums, file, doubt, 0.3, bodies=one_way)
        choices.append((_held_out(sums, fits), 0.3, speed, sums))
    shown = _fit(robot, choices[1][3].without(None), file, doubt, 1.0, bodies=False)[1]
    tell([(p.name, p.joint) for p in _parameters(robot, file, file, shown) if p.status == "left"])
    best = min(choice[0] for choice in choices)
    _, _, speed, sums = next(choice for choice in choices if choice[0] <= CLOSE * best)
    tried = [(trust, _fit_folds(robot, sums, file, doubt, trust)) for trust in TRUST]
    shares = [_held_out(sums, fits) for _, fits in tried]
    k = next(k for k, share in enumerate(shares) if share <= CLOSE * min(shares))
    trust, fits = tried[k]
    before_sums = _sums(links, _motor_columns(robot.n, qd, qdd, robot.coulomb_speed), torque, fold)
    n_folds = len(sums.rows)
    held = Share(*(_rms_over(sums, [part(f) for f in range(n_folds)]) for part in (
        lambda f: np.sqrt(sums.c[f] / max(sums.rows[f], 1)),
        lambda f: before_sums.rms(f, file),
        lambda f: sums.rms(f, fits[f]),
    )))  # fmt: skip
    if held.after.sum() >= held.before.sum():
        notes.append("no fit explains held-out parts better than the file's model, so that is what you get")
        kept = tuple(_parameters(robot, file, file, np.zeros(len(file))))
        return Identified(robot, gain, np.zeros(robot.n), held._replace(after=held.before), kept, None, tuple(notes))
    x, shown = _fit(robot, sums.without(None), file, doubt, trust)
    found, more = _as_robot(robot, x, speed)
    notes += more
    notes.append(f"links {_moved(trust)}; friction changes sign over {speed:g} rad/s; both chosen on held-out parts")
    return Identified(found, gain, x[-robot.n :], held, tuple(_parameters(robot, file, x, shown)), trust, tuple(notes))


def judge(robot: Robot, logs: Log | Sequence[Log], *, gain: Any = 1.0, offset: Any = 0.0, added: Any = 0.0) -> Share:
    """How well a model explains the torques of logs; nothing is fitted, so before and after are the same.

    Args:
        robot: The model.
        logs: One or more, of ``logs.read``.
        gain: [n] or one number, N m for one unit of the torque column.
        offset: [n] or one number, N m; model + offset = gain * recorded.
        added: [n] or one number, N m that reading added to the torques; taken off for the size of the torque as recorded.

    Raises:
        ValueError: a log without torques, of another arm, or of currents whose gain is not known.
    """
    logs = [logs] if isinstance(logs, Log) else list(logs)
    _check(robot, logs)
    left, torque = [], []
    for log in logs:
        if log.unit == "A" and np.all(np.asarray(gain) == 1.0):
            raise ValueError("the log has currents, and the N m for one ampere are not known; give torque_per_ampere")
        tau = np.broadcast_to(np.asarray(gain, float), robot.n) * np.asarray(log.tau, float)
        m = motion(log)  # at the ends of a stretch its speed is not known
        left.append((tau - np.asarray(offset, float) - torques(robot, m))[m.inside])
        torque.append((tau - np.asarray(added, float))[m.inside])
    after = _rms(np.concatenate(left))
    return Share(_rms(np.concatenate(torque)), after, after)


def torques(robot: Robot, m: Motion) -> np.ndarray:
    """Torque [T, n] N m that a model needs for a motion, friction and motor inertia included."""
    return inverse(robot, m.q, m.qd, m.qdd)


def _check(robot: Robot, logs: list[Log]) -> None:
    checks.instance("robot", robot, Robot)
    if not logs:
        raise ValueError("at least one log is needed; record a motion of every joint")
    for k, log in enumerate(logs, start=1):
        if np.shape(log.q) != np.shape(log.tau) or np.ndim(log.q) != 2 or np.shape(log.q)[1] != robot.n:
            raise ValueError(f"log {k} must have q and tau of [T, {robot.n}], got {np.shape(log.q)} and {np.shape(log.tau)}")
        if not log.has_torque:
            raise ValueError(f"log {k} has no torques, so there is nothing to fit a model to; record them")


def _listed(values: np.ndarray) -> str:
    return ", ".join(f"{v:.3g}" for v in values)


def _moved(trust: float) -> str:
    return "as in the file" if trust == 0 else f"moved from the file's by up to {trust:g} of their size"


def _rms(x: np.ndarray) -> np.ndarray:
    return np.sqrt((x**2).mean(0))


def _rms_over(sums: _Sums, parts: list[np.ndarray]) -> np.ndarray:
    return np.sqrt(sum(r * p**2 for r, p in zip(sums.rows, parts, strict=True)) / sums.rows.sum())


def _folds(motions: list[Motion]) -> list[np.ndarray]:
    """Fold of every row: a log each if there are several, otherwise parts of each stretch in turn."""
    if len(motions) >= 3:
        return [np.full(len(m.q), k % FOLDS) for k, m in enumerate(motions)]
    out = []
    for m in motions:
        fold = np.zeros(len(m.q), int)
        for k in range(m.stretch.max() + 1):
            rows = np.flatnonzero(m.stretch == k)
            fold[rows] = (np.arange(len(rows)) * PARTS // len(rows) + k) % FOLDS
        out.append(fold)
    return out


def _motor_columns(n: int, qd: np.ndarray, qdd: np.ndarray, speed: float) -> np.ndarray:
    """[T, n, 5]: what each of a joint's own parameters is multiplied by, in the order of MOTOR."""
    t = np.tanh(qd / speed)
    return np.stack([qdd, qd, t, t * t, np.ones_like(qd)], axis=2)


def _sums(links: np.ndarray, motor: np.ndarray, torque: np.ndarray, fold: np.ndarray) -> _Sums:
    _, n, p = links.shape
    folds = np.unique(fold)
    h, b = np.zeros((len(folds), n, p + 5 * n, p + 5 * n)), np.zeros((len(folds), n, p + 5 * n))
    c, count = np.zeros((len(folds), n)), np.zeros(len(folds))
    for k, f in enumerate(folds):
        there = fold == f
        count[k] = there.sum()
        for j in range(n):
            own = np.concatenate([links[there, j], motor[there, j]], axis=1)
            place = np.r_[np.arange(p), p + n * np.arange(5) + j]
            h[k, j][np.ix_(place, place)] = own.T @ own
            b[k, j][place] = own.T @ torque[there, j]
            c[k, j] = torque[there, j] @ torque[there, j]
    return _Sums(h, b, c, count)


def _file(robot: Robot) -> np.ndarray:
    mean = 0.5 * (robot.coulomb_positive + robot.coulomb_negative)
    apart = 0.5 * (robot.coulomb_positive - robot.coulomb_negative)
    links = [from_link(link) for link in robot.links]
    return np.concatenate([*links, robot.armature, robot.damping, mean, apart, np.zeros(robot.n)])


def _lengths(robot: Robot) -> np.ndarray:
    """Size [n] m of each link: to the next hinge, to its centre of mass, at least 5 cm."""
    out = []
    for i, link in enumerate(robot.links):
        ahead = robot.links[i + 1].offset if i + 1 < robot.n else robot.payload_link.moment
        com = link.moment / link.mass if link.mass > 0 else np.zeros(3)
        out.append(max(0.05, np.linalg.norm(ahead), np.linalg.norm(com)))
    return np.array(out)


def _doubt(robot: Robot, torque: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Size [p] that the file's value may be wrong by; of a link's, to be multiplied by lambda."""
    total = sum(link.mass for link in robot.links)
    parts = []
    for link, length in zip(robot.links, _lengths(robot), strict=True):
        mass = max(link.mass, 0.02 * total)
        parts.append(mass * np.repeat([1.0, length, length**2], [1, 3, 6]))
    size = _rms(torque) + 1e-9
    fast, hard = _rms(qd) + 1e-3, _rms(qdd) + 1e-2
    offset = np.where(_one_way(qd), 1e-4, 0.3) * size  # of one direction friction and an offset are the same: it is friction
    motor = np.concatenate([size / hard, size / fast, size, 0.005 * size, offset])
    return np.concatenate([*parts, np.maximum(motor, np.abs(_file(robot)[10 * robot.n :]))])


def _one_way(qd: np.ndarray) -> np.ndarray:
    """Which joints [n] move in one direction only; speeds [T, n] rad/s."""
    ahead, back = ((sign * qd > MOVING).mean(0) for sign in (1, -1))
    return (np.maximum(ahead, back) > 0.1) & (np.minimum(ahead, back) < 0.02)


def _start(
    robot: Robot, file: np.ndarray, doubt: np.ndarray, shown: np.ndarray
) -> tuple[np.ndarray, list[int], np.ndarray, np.ndarray]:
    """A start that a body can have, links that are held to it, rows that must be positive, and what may move."""
    n, p = robot.n, len(file)
    x, links, free = file.copy(), [], shown >= SHOWN
    for i, length in enumerate(_lengths(robot)):
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
        x[place] = np.maximum(x[place], 0.01 * doubt[place])
    apart = slice(13 * n, 14 * n)
    x[apart] = np.clip(x[apart], -0.9 * x[12 * n : 13 * n], 0.9 * x[12 * n : 13 * n])
    free[10 * n :] = True
    return x, links, rows, free


def _fit(
    robot: Robot, sums: _Sums, file: np.ndarray, doubt: np.ndarray, trust: float, *, bodies: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters, and the share of the doubt about each that the rows remove; from summed normal equations."""
    n = robot.n
    scaled = doubt.copy()
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
    values, vectors = np.linalg.eigh(h * np.outer(doubt, doubt))
    shown = (vectors**2) @ (np.maximum(values, 0) / (1 + np.maximum(values, 0)))
    if not bodies:
        return x, shown
    x, links, positive, free = _start(robot, file, doubt, shown)
    if trust == 0:
        x[: 10 * n], links, free[: 10 * n] = file[: 10 * n], [], False
    prior = 1 / scaled**2
    return solve(h + np.diag(prior), b + prior * file, x, links, positive, free), shown


CORRELATED = 20.0  # rows that say the same: residuals of real arms are friction, not noise, and last some tenths of a second


def _fit_folds(
    robot: Robot, sums: _Sums, file: np.ndarray, doubt: np.ndarray, trust: float, *, bodies: bool = True
) -> list[np.ndarray]:
    return [_fit(robot, sums.without(f), file, doubt, trust, bodies=bodies)[0] for f in range(len(sums.rows))]


def _held_out(sums: _Sums, fits: list[np.ndarray]) -> float:
    parts = [sums.rms(f, x) for f, x in enumerate(fits)]
    size = np.sqrt(sums.c.sum(0) / sums.rows.sum())
    return float(_rms_over(sums, parts).sum() / size.sum())


def _as_robot(robot: Robot, x: np.ndarray, speed: float) -> tuple[Robot, list[str]]:
    n, notes = robot.n, []
    links = tuple(to_link(link, x[10 * i : 10 * i + 10]) for i, link in enumerate(robot.links))
    for i, length in enumerate(_lengths(robot)):
        if margin(x[10 * i : 10 * i + 10], length) < -IMPOSSIBLE:
            notes.append(
                f"link {robot.link_names[i]!r} is none that a body can have, as in the file; see that M(q) is positive"
            )
    inertia, viscous, mean, apart = x[10 * n : 14 * n].reshape(4, n)
    positive, negative = np.maximum(mean + apart, 0), np.maximum(mean - apart, 0)
    found = robot.replace(
        links=links, armature=inertia, damping_positive=viscous, damping_negative=viscous, coulomb_positive=positive,
        coulomb_negative=negative, coulomb_speed=speed,
    )  # fmt: skip
    return found, notes


def _parameters(robot: Robot, file: np.ndarray, x: np.ndarray, shown: np.ndarray) -> list[Parameter]:
    n, out = robot.n, []
    names = [(name, i) for i in range(n) for name in LINK] + [(name, j) for name in MOTOR for j in range(n)]
    for k, (name, joint) in enumerate(names):
        status = "fitted" if shown[k] >= SURE else "combined" if shown[k] >= SHOWN else "left"
        unit = UNIT.get(name, "kg m^2")
        out.append(Parameter(name, joint + 1, unit, float(file[k]), float(x[k]), float(shown[k]), status))
    return out


def _first_gain(robot: Robot, motions: list[Motion]) -> np.ndarray:
    """N m for one unit of the torque column [n], from the file's links: what explains gravity and inertia.

    A joint without load that shows gets the mean of the others.
    """
    gain, sure = np.ones(robot.n), np.zeros(robot.n, bool)
    model = np.concatenate([torques(robot, m) for m in motions])
    qd, qdd, tau = (np.concatenate([getattr(m, key) for m in motions]) for key in ("qd", "qdd", "tau"))
    for j in range(robot.n):
        motor = _motor_columns(1, qd[:, j : j + 1], qdd[:, j : j + 1], 0.05)[:, 0]
        columns = np.column_stack([tau[:, j], -motor])  # gain * tau - motor = model
        scale = np.linalg.norm(columns, axis=0) + 1e-12
        found = np.linalg.lstsq(columns / scale, model[:, j], rcond=None)[0] / scale
        left = model[:, j] - columns @ found
        sure[j] = left.std() < 0.5 * model[:, j].std() and found[0] != 0
        gain[j] = found[0] if sure[j] else 1.0
    if not sure.any():
        raise ValueError("the torque for one ampere cannot be found: no current follows the model; give torque_per_ampere")
    return np.where(sure, gain, np.sign(np.median(gain[sure])) * np.median(np.abs(gain[sure])))
