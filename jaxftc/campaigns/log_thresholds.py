"""Thresholds from recordings of a healthy arm, however short they are.

The diagnosis runs over the logs with thresholds that nothing reaches. Of every second the largest statistics are kept; logs
of less than ten seconds are cut in ten. Each joint and channel is scaled by its own largest one; what is left is one
series, the largest of all, and one factor.

* The factor is the order statistic that a binomial law allows with the wanted confidence, where the logs hold enough runs.
* Otherwise it comes from a fitted tail: what lies above a high quantile follows a generalised Pareto law. That is an
  extrapolation and marked as one; it is kept within bounds, and what the tail says at them is reported.

The rate of the momentum observer is chosen for each joint: slow, it averages what the model has wrong of friction and
acceleration; fast, it sees a fault sooner. That rate is taken whose threshold is smallest, its delay counted in:
alpha (1 + WAIT / rate). Beside it stands the fastest, with so small a weight that healthy motions raise it as far. The jump
is set above what healthy readings show, and above what a torque may do to a joint in one sample time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy import stats

from jaxftc import checks
from jaxftc.campaigns.return_level import ReturnLevel
from jaxftc.config import Config
from jaxftc.evaluation.intervals import check_shares
from jaxftc.gains import Gains
from jaxftc.logs.diagnose import Stream
from jaxftc.logs.log import Log
from jaxftc.schemes.diagnoser import FAST, FASTEST, SLOW, Diagnosis, stiction

BLOCK, SHORTEST = 1.0, 0.4  # s, over which the largest statistic is taken; that of logs too short for enough of these
RATES = np.array([5.0, 8.0, 12.0, FAST])  # 1/s, of the momentum observer; what a model has wrong lasts longer than that
WAIT = 2.0  # 1/s
LEAST_JUMP = 1e-5  # rad, of w
NEVER = 1e9  # a threshold that nothing reaches
LEAST_BLOCKS = 10
LEAST_TAU, LEAST_Q = 1e-4, math.radians(0.2)  # of the torque limit; rad
PUSHES = 2.0  # times the acceleration of healthy motions, which a torque fault is taken to reach


class Promise(NamedTuple):
    """What the healthy time allows to say."""

    healthy_s: float  # s of logs
    run_s: float  # s, length of a run
    wanted: float  # share of runs with an alarm
    confidence: float
    method: str  # "sample", or "tail" where the level is extrapolated
    wanted_per_hour: float  # alarms, for that share
    fitted_per_hour: float | None  # alarms at the thresholds found, by the fitted tail; None where runs were counted
    seen: int  # alarms on the logs with the thresholds found
    at_most_per_hour: float  # alarms, with that confidence, by the healthy time alone
    needed_s: float  # s of logs without an alarm that would show what is wanted, with that confidence


class LogCalibration(NamedTuple):
    """Thresholds and what they promise."""

    gains: Gains
    promise: Promise
    noise: np.ndarray  # [n] rad, standard deviation of the readings


class _Peaks(NamedTuple):
    tau: np.ndarray  # [blocks, n, rates] N m
    w: np.ndarray  # [blocks, n] rad
    psi: np.ndarray  # [n] rad/s^2, largest acceleration of the arm


def reading_noise(config: Config, gains: Gains, logs: list[Log]) -> np.ndarray:
    """Standard deviation [n] rad of the readings, steps of the encoder included, from what no acceleration explains."""
    return _noise_and_stiction(config, gains, logs)[0]


def _noise_and_stiction(config: Config, gains: Gains, logs: list[Log]) -> tuple[np.ndarray, np.ndarray]:
    """The noise, and what standing joints may hold by friction [n] N m; of a joint that never moved the usual share."""
    logs = [log._replace(jitter=None) for log in logs]  # what uneven stamps make of a motion is noise to the observer
    jumps, fastest = [], np.zeros(config.n)
    for _, _, said in _diagnosed(config, _open(config, gains), logs):
        jumps.append(np.abs(said.jump[..., 0]))
        fastest = np.maximum(fastest, np.abs(said.qd_hat[..., 0]).max(0))
    noise = np.maximum(np.quantile(np.concatenate(jumps), 0.95, axis=0) / (1.96 * math.sqrt(6)), 1e-9)
    known, usual = stiction(config.robot)
    return noise, np.where(fastest > SLOW, known, np.maximum(known, usual))


def calibrate_on_logs(
    config: Config,
    gains: Gains,
    logs: list[Log],
    *,
    false_alarms: float = 0.01,
    confidence: float = 0.95,
    run: float | None = None,
) -> LogCalibration:
    """Set thresholds, the jump and the momentum observer's rate on logs of a healthy arm, for the ``Diagnoser``.

    Args:
        config: Robot and sample time, the logs'.
        gains: Where it begins: ``default_gains(config, noise=reading_noise(...))``.
        logs: Of the healthy arm, in motions like those to come.
        false_alarms: Share of healthy runs that may raise an alarm.
        confidence: That the share is not larger.
        run: s, length of a run; that of a log, on average, if not given.

    Raises:
        ValueError: a share outside (0, 1), logs that are too short, or statistics that are not finite.
    """
    check_shares(false_alarms, confidence)
    if not logs:
        raise ValueError("logs must be at least one, got none; record the healthy arm")
    healthy = sum(len(log.q) for log in logs) * config.dt
    run = healthy / len(logs) if run is None else run
    checks.positive("run", run, "seconds")
    block = min(BLOCK, healthy / LEAST_BLOCKS)
    if block < SHORTEST:
        raise ValueError(
            f"the logs hold {healthy:.3g} s; at least {LEAST_BLOCKS * SHORTEST:g} s of healthy motion are needed"
        )
    noise, stiction = _noise_and_stiction(config, gains, logs)
    gains = gains.replace({"diagnosis.stiction": stiction})
    found = _peaks(config, _open(config, gains), logs, block)
    torques = any(np.isfinite(log.tau).any() for log in logs)
    if torques:
        gains = gains.replace(_bandwidths(config, found))
        found = _peaks(config, _alike(config, gains), logs, block)
    level = ReturnLevel(false_alarms, confidence, len(found.w), max(1, round(run / block)))
    gains = gains.replace(_thresholds(config, found, level, torques))
    seen = _alarms(config, gains, logs)
    rate = -math.log1p(-false_alarms) / (run / 3600)
    promise = Promise(
        healthy_s=healthy,
        run_s=run,
        wanted=false_alarms,
        confidence=confidence,
        method=level.method,
        wanted_per_hour=rate,
        fitted_per_hour=level.rate * 3600 / block if level.method == "tail" else None,
        seen=seen,
        at_most_per_hour=float(stats.chi2.ppf(confidence, 2 * (seen + 1)) / 2 / (healthy / 3600)),
        needed_s=-3600 * math.log1p(-confidence) / rate,
    )
    return LogCalibration(gains, promise, noise)


def _bandwidths(config: Config, found: _Peaks) -> dict[str, np.ndarray]:
    """The rate of each joint, and the weight of the fastest beside it."""
    largest = _largest(config, found)
    which = _best(largest, _rates(config))
    return {
        "diagnosis.rate": _rates(config)[which],
        "diagnosis.fast": np.take_along_axis(largest, which[:, None], 1)[:, 0] / largest[:, -1],
    }


def _thresholds(config: Config, found: _Peaks, level: ReturnLevel, torques: bool) -> dict[str, np.ndarray | float]:
    """Thresholds and the jump by gain: the largest statistics seen with the bandwidths chosen, times the level's factor.

    Logs without ``torques`` say nothing of the torque channel, which stays as it is.
    """
    widest = np.maximum(found.w.max(0), LEAST_JUMP)
    half_jump = np.maximum(widest * level.factor(np.maximum(found.w, LEAST_JUMP)), PUSHES * found.psi * config.dt**2)
    of_readings: dict[str, np.ndarray | float] = {
        "diagnosis.alpha_q": np.maximum(half_jump, LEAST_Q),
        "observer.jump": 2 * half_jump,
    }
    if not torques:
        return of_readings
    alpha_tau = _largest(config, found)[:, 0] * level.factor(found.tau[..., 0])
    return of_readings | {"diagnosis.alpha_tau": alpha_tau, "diagnosis.lam_tau": 1.0}


def _largest(config: Config, found: _Peaks) -> np.ndarray:
    """The largest torque statistic [n, rates] N m, and no less than a motor can have wrong."""
    limit = np.where(np.isfinite(config.robot.torque_limit), config.robot.torque_limit, 1.0)
    return np.maximum(found.tau.max(0), (LEAST_TAU * limit)[:, None])


def _rates(config: Config) -> np.ndarray:
    """The rates that are tried, 1/s; always as many, so that one program serves every sample time."""
    return np.minimum(RATES, FASTEST / config.dt)


def _best(largest: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Which rate [n] has the smallest threshold with its delay counted in; largest [n, rates] N m."""
    return (largest * (1 + WAIT / rates)).argmin(1)


def _open(config: Config, gains: Gains) -> Gains:
    """Gains with every rate side by side and alone, and thresholds that nothing reaches."""
    return _never(config, gains, np.tile(_rates(config), (config.n, 1)), np.zeros(config.n))


def _alike(config: Config, gains: Gains) -> Gains:
    """The gains' own rate, as often as there are rates, so that it is the same program; and the same thresholds."""
    rate = np.repeat(np.asarray(gains.diagnosis.rate)[:, None], len(RATES), 1)
    return _never(config, gains, rate, np.asarray(gains.diagnosis.fast))


def _never(config: Config, gains: Gains, rate: np.ndarray, fast: np.ndarray) -> Gains:
    never = {"diagnosis.alpha_tau": NEVER, "diagnosis.alpha_q": NEVER, "observer.jump": NEVER, "diagnosis.lam_tau": 1.0}
    return gains.replace(never | {"diagnosis.rate": rate, "diagnosis.fast": fast})


def _diagnosed(config: Config, gains: Gains, logs: list[Log]) -> Iterator[tuple[int, int, Diagnosis]]:
    """Which log, the tick of it that some of its diagnosis begins at, and that."""
    stream = Stream(config, gains)
    for k, log in enumerate(logs):
        for first, said in stream.feed(log):
            for name in ("statistic_tau", "statistic_q", "jump"):
                bad = ~np.isfinite(getattr(said, name))
                if bad.any():
                    tick = first + int(np.argwhere(bad)[0][0])
                    raise ValueError(f"log {k + 1}: {name} is not finite at {tick * config.dt:.4g} s; look at the log there")
            yield k, first, said


def _peaks(config: Config, gains: Gains, logs: list[Log], block: float) -> _Peaks:
    """Largest statistics of every ``block`` s, or so nearly that a stretch is cut into equal ones."""
    size = max(1, round(block / config.dt))
    which, count = [], 0
    for log in logs:
        ids = np.zeros(len(log.q), int)
        for start, stop in log.stretches:
            parts = max(1, round((stop - start) / size))
            ids[start:stop] = count + np.arange(stop - start) * parts // (stop - start)
            count += parts
        which.append(ids)
    tau, w = np.zeros((count, config.n, len(RATES))), np.zeros((count, config.n))
    speed = np.zeros(config.n)
    for k, first, said in _diagnosed(config, gains, logs):
        rise = said.threshold_tau / np.float32(NEVER)  # by the motion; 1 where thresholds are constant
        ids = which[k][first : first + len(rise)]
        _keep_largest(tau, ids, np.abs(said.statistic_tau) / rise)
        _keep_largest(w, ids, np.abs(said.jump[..., 0]))
        if len(rise) > 1:
            rate = np.abs(np.diff(said.qd_hat[..., 0], axis=0)) / config.dt
            speed = np.maximum(speed, np.quantile(rate, 0.99, axis=0))
    return _Peaks(tau, w, speed)


def _keep_largest(largest: np.ndarray, ids: np.ndarray, values: np.ndarray) -> None:
    """Raise ``largest`` [blocks, ...] to ``values`` [T, ...] of the blocks ``ids`` [T], which do not fall."""
    edges = np.flatnonzero(np.diff(ids, prepend=-1))
    largest[ids[edges]] = np.maximum(largest[ids[edges]], np.maximum.reduceat(values, edges))


def _alarms(config: Config, gains: Gains, logs: list[Log]) -> int:
    """How often an alarm of the arm begins."""
    count, before = 0, False
    for k, first, said in _diagnosed(config, gains, logs):
        up = np.any(np.asarray(said.verdict) > 0, axis=1)
        before = before and all(first != start for start, _ in logs[k].stretches)  # a stretch begins anew
        count += int((up & ~np.r_[before, up[:-1]]).sum())
        before = bool(up[-1])
    return count
