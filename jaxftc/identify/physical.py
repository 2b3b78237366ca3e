"""The physical model of an arm from healthy logs: links, motor inertia, friction by direction, torque offset and gain.

Regularised least squares toward the robot file's values (``regularised.py``), over the rows of all logs
(``normal_equations.py``). How far the file is trusted, and the width of the friction's tanh, are chosen on parts of the logs
that are not fitted. Links stay such that a body can have them. What the motions do not show keeps its value.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxftc import checks
from jaxftc.identify.consistent import margin
from jaxftc.identify.derivatives import Motion, motion
from jaxftc.identify.linear_torque import LINK, inverse, to_link
from jaxftc.identify.normal_equations import MOTOR, Rows, Sums, gather, motor_columns
from jaxftc.identify.regularised import IMPOSSIBLE, SHOWN, SURE, Prior, fit, fit_folds, from_file, lengths
from jaxftc.logs.log import Log
from jaxftc.robot.model import Robot

UNIT = {"mass": "kg", "mx": "kg m", "my": "kg m", "mz": "kg m", "motor_inertia": "kg m^2", "viscous": "N m s/rad",
        "coulomb": "N m", "coulomb_asymmetry": "N m", "offset": "N m", "torque_gain": "N m/A"}  # fmt: skip
TRUST = (0.0, 0.03, 0.1, 0.3, 1.0)  # lambda of the links that are tried; 0 keeps the file's links
WIDTHS = (0.1, 0.05, 0.02, 0.01)  # rad/s, widths of the friction's tanh that are tried, the smoothest first
CLOSE = 1.005  # a simpler model is taken where its held-out share is within this of the best


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
    if gain is None and any(log.unit != "N m" for log in logs):
        gain = _first_gain(robot, motions)
        unit = next(log.unit for log in logs if log.unit != "N m")
        what = {"A": "ampere"}.get(unit, unit)
        notes.append(f"torque for one {what}, found on the file's model: {_listed(gain)} N m")
    gain = np.ones(robot.n) if gain is None else np.broadcast_to(np.asarray(gain, float), robot.n)
    data = gather(robot, motions, gain)
    prior = from_file(robot, data)
    width, sums, shown = _width(prior, data)
    tell([(p.name, p.joint) for p in _parameters(robot, prior.file, prior.file, shown) if p.status == "left"])
    trust, fits = _trust(prior, sums)
    held = _share(prior, data, sums, fits)
    if held.after.sum() >= held.before.sum():
        notes.append("no fit explains held-out parts better than the file's model, so that is what you get")
        kept = tuple(_parameters(robot, prior.file, prior.file, np.zeros(len(prior.file))))
        return Identified(robot, gain, np.zeros(robot.n), held._replace(after=held.before), kept, None, tuple(notes))
    x, shown = fit(prior, sums.without(None), trust)
    better, more = _as_robot(robot, x, width)
    notes += more
    if not np.array_equal(robot.damping_positive, robot.damping_negative):
        notes.append("viscous friction is fitted the same in both directions; the file has one for each, which are averaged")
    notes.append(f"links {_moved(trust)}; friction changes sign over {width:g} rad/s; both chosen on held-out parts")
    parameters = tuple(_parameters(robot, prior.file, x, shown))
    return Identified(better, gain, x[-robot.n :], held, parameters, trust, tuple(notes))


def _width(prior: Prior, data: Rows) -> tuple[float, Sums, np.ndarray]:
    """Width of the friction's tanh, rad/s, the sums with it, and what the logs show of each parameter [p]."""
    choices = [(width, data.summed(width)) for width in WIDTHS]
    bodies = bool(data.one_way.any())  # then friction that drives explains the torque as well, and must not be fitted
    shares = [sums.held_out(fit_folds(prior, sums, 0.3, bodies=bodies)) for _, sums in choices]
    shown = fit(prior, choices[1][1].without(None), 1.0, bodies=False)[1]
    return *choices[_simplest(shares)], shown


def _trust(prior: Prior, sums: Sums) -> tuple[float, list[np.ndarray]]:
    """How far the file's links are trusted, and the parameters [p] by held-out fold."""
    tried = [(trust, fit_folds(prior, sums, trust)) for trust in TRUST]
    return tried[_simplest([sums.held_out(fits) for _, fits in tried])]


def _simplest(shares: list[float]) -> int:
    """The first choice, simplest first, that is nearly as good as the best."""
    return next(k for k, share in enumerate(shares) if share <= CLOSE * min(shares))


def _share(prior: Prior, data: Rows, sums: Sums, fits: list[np.ndarray]) -> Share:
    """How well the file's model and the fits explain the folds that they have not seen."""
    file = data.summed(prior.robot.coulomb_speed)
    folds = range(len(sums.rows))
    return Share(
        sums.over_folds([np.sqrt(sums.c[f] / max(sums.rows[f], 1)) for f in folds]),
        sums.over_folds([file.rms(f, prior.file) for f in folds]),
        sums.over_folds([sums.rms(f, fits[f]) for f in folds]),
    )


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
        if log.unit != "N m" and np.all(np.asarray(gain) == 1.0):
            raise ValueError(f"the log has torques in {log.unit}, and the N m for one are not known; give torque_per_ampere")
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
        if log.dt is None:
            raise ValueError(f"log {k} has no sample time; give it, Log(q, tau, dt=...) in s")
        bad = np.argwhere(~np.isfinite(np.asarray(log.q)))
        if len(bad):
            raise ValueError(
                f"log {k}: q is not finite at tick {bad[0][0]} of joint {bad[0][1] + 1}; cut the log there, or read it with "
                "faulty=False"
            )
        if not log.has_torque:
            raise ValueError(
                f"log {k} has no torques, so there is nothing to fit a model to; record them, or say which columns they are "
                "with --columns tau1=NAME"
            )


def _listed(values: np.ndarray) -> str:
    return ", ".join(f"{v:.3g}" for v in values)


def _moved(trust: float) -> str:
    return "as in the file" if trust == 0 else f"moved from the file's by up to {trust:g} of their size"


def _rms(x: np.ndarray) -> np.ndarray:
    """Rms [n] over time of x [T, n]."""
    return np.sqrt((x**2).mean(0))


def _as_robot(robot: Robot, x: np.ndarray, speed: float) -> tuple[Robot, list[str]]:
    """The robot of parameters x [p], friction changing sign over ``speed`` rad/s, and what to say of its links."""
    n, notes = robot.n, []
    links = tuple(to_link(link, x[10 * i : 10 * i + 10]) for i, link in enumerate(robot.links))
    for i, length in enumerate(lengths(robot)):
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
    """Every parameter before [p] and after [p], and how much of it the logs show [p]."""
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
        motor = motor_columns(qd[:, j : j + 1], qdd[:, j : j + 1], 0.05)[:, 0]
        columns = np.column_stack([tau[:, j], -motor])  # gain * tau - motor = model
        scale = np.linalg.norm(columns, axis=0) + 1e-12
        found = np.linalg.lstsq(columns / scale, model[:, j], rcond=None)[0] / scale
        left = model[:, j] - columns @ found
        sure[j] = left.std() < 0.5 * model[:, j].std() and found[0] != 0
        gain[j] = found[0] if sure[j] else 1.0
    if not sure.any():
        raise ValueError("the torque for one ampere cannot be found: no current follows the model; give torque_per_ampere")
    return np.where(sure, gain, np.sign(np.median(gain[sure])) * np.median(np.abs(gain[sure])))
