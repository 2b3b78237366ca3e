"""Thresholds for a wanted share of healthy runs with an alarm.

Each joint's threshold starts as the quantile of its own largest statistic in a run, at its share of the wanted rate; one
factor on all of them then makes the rate right for runs as a whole, at the order statistic that a binomial law allows with
the wanted confidence. The fuzzy stage reads the thresholds too, so the runs are repeated with the new ones until they stay.
Fresh runs then say what was reached.

Torque thresholds may follow the motion (``diagnosis/threshold.py``). Constant ones are set first, so that the loop runs as
it will; ``follow.py`` then fits what they follow, and the same runs and the same rule set their height.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxftc.campaigns import follow as following
from jaxftc.campaigns.run import check_set, scores, torque_statistics
from jaxftc.config import Config
from jaxftc.diagnosis import threshold
from jaxftc.evaluation.intervals import Interval, check_shares, share, tolerated
from jaxftc.gains import Gains
from jaxftc.scenarios import reference
from jaxftc.scenarios.scenario import Scenario, take
from jaxftc.schemes.registry import scheme
from jaxftc.types import Array

ROUNDS, SETTLED = 8, 0.02  # at most; relative change of the thresholds that ends them
MOMENTS, EVERY = 1024, 4  # runs whose moments a fit sees, as many that check it; every so many ticks of them
LEAST_TAU = 1e-4  # of the torque limit: no threshold is lower, where a statistic is always 0
LEAST_Q = math.radians(0.01)  # rad; six times the noise of an encoder of 3e-5 rad


class Peaks(NamedTuple):
    """The largest statistics of healthy runs that lasted for an alarm."""

    tau: np.ndarray  # [n, runs] N m
    q: np.ndarray  # [n, runs] rad
    by_check: np.ndarray  # [runs] bool, the sensor check raised an alarm: no threshold prevents that


class Calibration(NamedTuple):
    """Thresholds, and what they reach on runs that they were not set on.

    Attributes:
        gains: With the thresholds.
        wanted: Share of runs with an alarm.
        confidence: That the share is not larger.
        runs: That the thresholds were set on.
        rounds: Times that the thresholds were set, each time with the last ones in force.
        settled: Whether the last round changed them by less than SETTLED.
        fresh: Runs that they were checked on.
        reached: Share of those with an alarm, with its 95 % interval.
        shares: What the torque thresholds follow; None where that was not asked for.
    """

    gains: Gains
    wanted: float
    confidence: float
    runs: int
    rounds: int
    settled: bool
    fresh: int
    reached: Interval
    shares: following.Shares | None = None

    @property
    def met(self) -> bool:
        """Whether the fresh runs agree with the wanted share."""
        return self.reached.low <= self.wanted


def calibrate(
    config: Config,
    gains: Gains,
    scenarios: Scenario,
    key: Array,
    *,
    false_alarms: float = 0.01,
    confidence: float = 0.95,
    follow: bool = False,
    done: Callable[[int], object] = lambda count: None,
) -> Calibration:
    """Set ``gains.diagnosis.alpha_tau`` and ``alpha_q`` on healthy scenarios: faults are left out.

    Half of them set the thresholds, the others check the result.

    Args:
        config: Robot, structure and timing.
        gains: All others stay as they are.
        scenarios: Motions, arms and noises to set them on, with a leading axis.
        key: Of the encoder noise.
        false_alarms: Share of healthy runs that may raise an alarm.
        confidence: With which no more do.
        follow: Fit first what torque thresholds follow of the motion, where the scheme's can; without it they follow what
            the gains say.
        done: Is told after each piece how many runs it had.

    Returns:
        The gains, and what the fresh runs did.

    Raises:
        ValueError: too few scenarios for that share and confidence, or no threshold can reach it.
    """
    check_set(scenarios)
    scenarios = without_faults(scenarios)
    half = enough(len(scenarios.id), false_alarms, confidence)
    parts = take(scenarios, slice(0, half)), take(scenarios, slice(half, None))

    def peaks(gains: Gains, part: int) -> Peaks:
        found = scores(config, gains, parts[part], key, done)
        tau, q = (np.asarray(x, float) for x in (found.healthy_tau, found.healthy_q))
        return Peaks(tau, q, np.isinf(found.healthy_ratio) | found.lost)

    if not follow or not set(threshold.GAINS) <= scheme(config).gains_used(config):
        return _settle(config, gains, peaks, false_alarms, confidence)
    constant = following.with_shares(gains, np.zeros((config.n, len(following.FOLLOW))))
    constant = _settle(config, constant, peaks, false_alarms, confidence).gains
    shares = following.fit(*_moments(config, constant, parts[0], key))
    gains = following.with_shares(constant, shares.values)
    return _settle(config, gains, peaks, false_alarms, confidence)._replace(shares=shares)


def _moments(config: Config, gains: Gains, scenarios: Scenario, key: Array) -> list[following.Moments]:
    """Moments of healthy scenarios with a leading axis: those to fit, and those to check."""
    some = take(scenarios, slice(0, 2 * MOMENTS))
    size = torque_statistics(config, gains, some, key, EVERY)  # [n, ticks, runs]
    start, goal = (jnp.asarray(np.asarray(q).T[:, None]) for q in (some.q_start, some.q_goal))
    t = config.dt * jnp.arange(0, config.ticks, EVERY)[:, None]
    at = np.stack(threshold.motion(config.robot, *reference.cubic(start, goal, config.t_final, t)), 1)  # [n, 5, ticks, runs]
    half = size.shape[-1] // 2
    flat = lambda part: part.reshape(*part.shape[:-2], -1)  # noqa: E731
    halves = slice(0, half), slice(half, None)
    return [following.Moments(flat(size[..., runs]), flat(at[..., runs])) for runs in halves]


def enough(runs: int, false_alarms: float, confidence: float) -> int:
    """The number of runs that set the thresholds: half of them, or one more.

    Raises:
        ValueError: they are too few, or none is left to check the result on.
    """
    half = (runs + 1) // 2
    allowed(half, false_alarms, confidence)
    if runs < 2:
        raise ValueError(f"{runs} healthy run is too few: one sets the thresholds and another checks them; give at least 2")
    return half


def _settle(
    config: Config, gains: Gains, peaks: Callable[[Gains, int], Peaks], false_alarms: float, confidence: float
) -> Calibration:
    """Thresholds from the peaks of part 0, again with the new ones until they stay; then the alarms of part 1."""
    change, rounds, learned = math.inf, 0, 0
    while rounds < ROUNDS and change > SETTLED:
        found = peaks(gains, 0)
        learned = len(found.by_check)
        before = [np.asarray(gains.diagnosis.alpha_tau, float), np.asarray(gains.diagnosis.alpha_q, float)]
        wanted = thresholds(config, found, false_alarms, confidence)
        if not found.q.any():
            wanted[1] = before[1]  # a scheme that does not look at the encoder leaves that channel's thresholds alone
        change = max(float(np.abs(np.log(w / b)).max()) for w, b in zip(wanted, before, strict=True))
        if rounds >= 3:  # to and fro: the higher ones hold the rate as well, and stay
            wanted = [np.maximum(w, b) for w, b in zip(wanted, before, strict=True)]
            change = max(float(np.abs(np.log(w / b)).max()) for w, b in zip(wanted, before, strict=True))
        gains, rounds = with_thresholds(gains, *wanted), rounds + 1
    fresh = peaks(gains, 1)
    levels = np.asarray(gains.diagnosis.alpha_tau)[:, None], np.asarray(gains.diagnosis.alpha_q)[:, None]
    alarms = fresh.by_check | (fresh.tau >= levels[0]).any(0) | (fresh.q >= levels[1]).any(0)
    reached = share(int(alarms.sum()), len(alarms))
    return Calibration(gains, false_alarms, confidence, learned, rounds, change <= SETTLED, len(alarms), reached)


def without_faults(scenarios: Scenario) -> Scenario:
    """The same motions of the same arms, healthy."""
    none = {name: np.zeros_like(getattr(scenarios, name).kind) for name in ("fault_tau", "fault_q")}
    faults = {name: getattr(scenarios, name)._replace(kind=kind) for name, kind in none.items()}
    return scenarios._replace(contact=None, uncommon=None, **faults)


def allowed(runs: int, false_alarms: float, confidence: float) -> int:
    """How many of the runs may raise an alarm.

    Raises:
        ValueError: a share outside (0, 1), or so few runs that none of them may.
    """
    check_shares(false_alarms, confidence)
    count = tolerated(runs, false_alarms, confidence)
    if count < 0:
        least = math.ceil(math.log(1 - confidence) / math.log(1 - false_alarms))
        raise ValueError(
            f"{runs} healthy runs are too few to hold {100 * false_alarms:g} % false alarms with {100 * confidence:g} % "
            f"confidence; at least {least} are needed to set the thresholds on, and as many to check them, or a larger share"
        )
    return count


def thresholds(config: Config, peaks: Peaks, false_alarms: float, confidence: float) -> list[np.ndarray]:
    """alpha_tau [n] N m and alpha_q [n] rad for these peaks.

    Raises:
        ValueError: the sensor check alone raises more alarms than wanted.
    """
    runs = peaks.tau.shape[1]
    count = allowed(runs, false_alarms, confidence)
    if peaks.by_check.sum() > count:
        raise ValueError(
            f"{peaks.by_check.sum()} of {runs} healthy runs raise an alarm that no threshold prevents (frozen or noisy "
            "readings, or a run that diverged); raise observer.jump, or look at such a run with jaxftc simulate"
        )
    limit = np.where(np.isfinite(config.robot.torque_limit), config.robot.torque_limit, 1.0)
    least = np.concatenate([LEAST_TAU * limit, np.full(config.n, LEAST_Q)])
    both = np.concatenate([peaks.tau, peaks.q])
    shape = np.maximum(np.quantile(both[:, ~peaks.by_check], 1 - false_alarms / len(both), axis=1), least)
    worst = np.where(peaks.by_check, np.inf, (both / shape[:, None]).max(0))
    factor = np.nextafter(np.float32(np.sort(worst)[runs - 1 - count]), np.float32(np.inf))  # just above what may not alarm
    level = np.maximum(1.000001 * factor * shape, least)
    return [level[: config.n], level[config.n :]]


def with_thresholds(gains: Gains, alpha_tau: Any, alpha_q: Any) -> Gains:
    """Gains with other thresholds, N m and rad."""
    return gains.replace({"diagnosis.alpha_tau": alpha_tau, "diagnosis.alpha_q": alpha_q})


def by_joint(config: Config, gains: Gains) -> dict[str, dict[str, float]]:
    """Thresholds by joint's name, and what those of the torque follow, where they follow anything."""
    own = gains.diagnosis
    values = {"alpha_tau_nm": np.asarray(own.alpha_tau, float), "alpha_q_deg": np.rad2deg(np.asarray(own.alpha_q, float))}
    shares = {name: np.asarray(getattr(own, name), float) for name in threshold.FOLLOW}
    values |= shares if any(share.any() for share in shares.values()) else {}
    return {key: dict(zip(config.robot.joint_names, value.tolist(), strict=True)) for key, value in values.items()}
