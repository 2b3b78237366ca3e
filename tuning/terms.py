"""The terms of the tuning objective: plain functions of a simulated run, each a unit-free number per scenario.

A term takes a ``Run`` and returns [...], one value a scenario, small when all is well. Alarms are graded instead of
decided, so that every term has a gradient: the grade is the logistic function of how far a statistic is above its
threshold. Verdicts themselves carry no gradient; what the sensor check held of a reading (``out.suspect``) enters as data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc import checks
from jaxftc.config import Config
from jaxftc.evaluation.metrics import SETTLE
from jaxftc.gains import Gains
from jaxftc.observer import stability as poles
from jaxftc.scenarios.scenario import Scenario
from jaxftc.simulation.closed_loop import Trace
from jaxftc.stages import Stages
from jaxftc.types import Array

SMALL_TORQUE = 0.05  # of the torque limit: the smallest actuator fault of the preset ``standard``
SMALL_ANGLE = np.deg2rad(0.2)  # rad, its smallest encoder bias
TRACKING = np.deg2rad(0.1)  # rad
CHATTERING = 5.0  # 1/s, torque travel over the limit
SOFTNESS = 0.1  # of a graded alarm: at 1.1 of the threshold the grade is 0.73
DELAY_WINDOW = 0.1  # s after onset within which detection is graded
HEADROOM = 0.9  # of the threshold, which a healthy statistic should stay below
SLOWEST = 0.9999  # modulus of the slowest pole of the observer that is free of charge


class Run(NamedTuple):
    """What a term may look at: a simulated batch and the gains it was simulated with."""

    config: Config
    gains: Gains
    scenario: Scenario = None  # pyright: ignore[reportAssignmentType] # trailing axes; None for a term of gains alone
    trace: Trace = None  # pyright: ignore[reportAssignmentType] # None for a term of gains alone
    stages: Stages | None = None  # what runs, where one program serves every observer and controller; else the config's


Function = Callable[[Run], Array]


class Term(NamedTuple):
    """One weighted part of the objective.

    Attributes:
        weight: In the objective, 1.
        value: Function of a ``Run``: [...], unit-free.
        gains_only: Its run has neither scenario nor trace; found once for all scenarios with the
            same gains.
    """

    weight: float
    value: Function
    gains_only: bool = False


def _rms(x: Array, unit: Array | float) -> Array:
    """Root mean square of x [T, n, ...] over ticks and joints, in a unit [n, 1...] each; finite slope at 0."""
    return jnp.sqrt(((x * x).mean(0) / unit**2).mean(0) + 1e-12)


def _limit(run: Run) -> Array:
    """Torque limits [n, 1...] N m; 1 where there is none."""
    limit = np.where(np.isfinite(run.config.robot.torque_limit), run.config.robot.torque_limit, 1.0)
    return jnp.asarray(limit, run.trace.q.dtype).reshape(-1, *[1] * (run.trace.q.ndim - 2))


def _share(x: Array) -> Array:
    """Share x / (1 + x), any shape, of an error over its tolerance; below 1: hopeless runs do not outvote the others."""
    return x / (1 + x)


def fault_tau(run: Run) -> Array:
    """Error of the torque-fault estimate, rms, against the smallest fault of ``standard``."""
    true = run.trace.fault_tau
    true = true if run.scenario.contact is None else true + run.trace.contact_tau
    return _share(_rms(run.trace.out.fault_tau_hat - true, SMALL_TORQUE * _limit(run)))


def fault_q(run: Run) -> Array:
    """Error of the encoder-fault estimate, rms, against the smallest bias of ``standard``."""
    return _share(_rms(run.trace.out.fault_q_hat - run.trace.fault_q, SMALL_ANGLE))


def tracking(run: Run) -> Array:
    """True angle from the reference, rms, against 0.1 deg."""
    return _share(_rms(run.trace.q - run.trace.q_ref, TRACKING))


def chattering(run: Run) -> Array:
    """Torque travel per second over the torque limit, mean over joints, against 5 1/s."""
    travel = (jnp.abs(jnp.diff(run.trace.out.tau, axis=0)).sum(0) / _limit(run)).mean(0)
    return _share(travel / (run.config.ticks * run.config.dt) / CHATTERING)


def effort(run: Run) -> Array:
    """Torque over its limit, rms."""
    return _rms(run.trace.out.tau, _limit(run))


class Alarms(NamedTuple):
    """Graded alarms of a run, and what is true of it."""

    tau: Array  # [T, n, ...] grade of the actuator bit of the verdict, Eq. (18)
    q: Array  # [T, n, ...] grade of the sensor bit
    ratios: tuple[Array, Array]  # [T, n, ...] statistic over threshold, torque and encoder channel
    faulty_tau: Array  # [n, ...] bool, an actuator fault in this run, or more of a contact than its threshold
    faulty_q: Array  # [n, ...] bool, an encoder fault
    since: Array  # [T, ...] s since the first onset; -inf in a healthy run
    left: Array  # [T, ...] s until the last clearance


def alarms(run: Run) -> Alarms:
    """Graded alarms, as ``diagnosis.decision`` would combine them, and the scenario's truth, which only tuning may see."""
    out, scenario = run.trace.out, run.scenario
    ratios = jnp.abs(out.statistic_tau) / out.threshold_tau, jnp.abs(out.statistic_q) / out.threshold_q
    grade_tau, grade_q = (jax.nn.sigmoid((ratio - 1) / SOFTNESS) for ratio in ratios)
    trusted = 1 - jax.lax.stop_gradient(out.suspect)
    faults, contact = (scenario.fault_tau, scenario.fault_q), scenario.contact
    faulty = [fault.kind > 0 for fault in faults]
    onset = jnp.stack([jnp.where(f, fault.onset, jnp.inf) for f, fault in zip(faulty, faults, strict=True)]).min((0, 1))
    clear = jnp.stack([jnp.where(f, fault.clear, -jnp.inf) for f, fault in zip(faulty, faults, strict=True)]).max((0, 1))
    if contact is not None:
        pushed = (jnp.abs(run.trace.contact_tau) >= out.threshold_tau).any(0)
        onset = jnp.minimum(onset, jnp.where(pushed.any(0), contact.onset, jnp.inf))
        clear = jnp.maximum(clear, jnp.where(pushed.any(0), contact.clear, -jnp.inf))
        faulty[0] = faulty[0] | pushed
    t = run.trace.t.reshape(-1, *[1] * onset.ndim)
    return Alarms(grade_tau * trusted, 1 - (1 - grade_q) * trusted, ratios, faulty[0], faulty[1], t - onset, clear - t)


def delay(run: Run) -> Array:
    """Share of the first 0.1 s after onset that passes without an alarm of the faulty joint, mean over faulty joints.

    An alarm that was up before onset says nothing: such a joint's detection does not count. 0 in a healthy run.
    """
    a = alarms(run)
    alarm = 1 - (1 - a.tau) * (1 - a.q)
    since = a.since[:, None]
    seen = _so_far(jnp.where(since >= 0, alarm, 0.0))
    before = jnp.where(since < 0, alarm, 0.0).max(0)
    window = (since >= 0) & (since < DELAY_WINDOW)
    late = _mean(1 - seen * (1 - before), window, 0)
    faulty = a.faulty_tau | a.faulty_q
    return _mean(late, faulty, 0)


def false_alarm(run: Run) -> Array:
    """How far healthy statistics come above 0.9 of their thresholds, as a logarithm, added up over joints and channels.

    Healthy is the time before onset. It does not saturate: a threshold ten times too low still has a slope.
    """
    a = alarms(run)
    peaks = jnp.stack([jnp.where(a.since[:, None] < 0, ratio, 0.0).max(0) for ratio in a.ratios])
    over = jnp.log((peaks + 1e-6) / HEADROOM)
    return (SOFTNESS * jax.nn.softplus(over / SOFTNESS)).sum((0, 1))


def isolation(run: Run) -> Array:
    """Brier score of both bits of every joint's verdict, from 60 ms after onset for 0.1 s; in a healthy run all the time."""
    a = alarms(run)
    wrong = (a.tau - a.faulty_tau) ** 2 + (a.q - a.faulty_q) ** 2
    healthy = ~(a.faulty_tau | a.faulty_q).any(0)
    scored = (a.since >= SETTLE) & (a.since < SETTLE + DELAY_WINDOW) & (a.left >= 0)
    return _mean(wrong.sum(1), scored | healthy, 0)


def stability(run: Run) -> Array:
    """By how much the observer's slowest pole is outside 0.9999, in thousandths, mean over joints, Eqs. (11), (12).

    0 with ``input="torque"``, whose joints couple.
    """
    if run.config.input != "rigid_body":
        return jnp.zeros(())
    fuzzy = None if run.stages is None else run.stages.fuzzy
    return jax.nn.relu((poles.smooth_radius(run.config, run.gains, fuzzy) - SLOWEST) / 1e-3).mean(0)


def _so_far(x: Array) -> Array:
    """Largest value up to each tick, of x [T, ...] >= 0; ``cummax`` goes over all of it ten times, and back."""

    def later(largest: Array, now: Array) -> tuple[Array, Array]:
        largest = jnp.maximum(largest, now)
        return largest, largest

    return jax.lax.scan(later, jnp.zeros_like(x[0]), x)[1]


def _mean(x: Array, where: Array, axis: int) -> Array:
    """Mean of x along ``axis`` over the entries of ``where``, which broadcasts to it; 0 where there is none."""
    where = jnp.broadcast_to(where, x.shape)
    return jnp.where(where, x, 0.0).sum(axis) / jnp.maximum(where.sum(axis), 1)


def weighted(objective: Mapping[str, Term], weights: Mapping[str, float]) -> dict[str, Term]:
    """An objective with other weights for some of its terms.

    Args:
        objective: Terms by name, as ``OBJECTIVE``.
        weights: New weights by name, 1, not negative.

    Returns:
        The objective; its other terms are as they were.

    Raises:
        ValueError: a term that is not there, or a weight that is negative or not finite.
    """
    check_terms("weight", objective, weights)
    return {name: term._replace(weight=float(weights.get(name, term.weight))) for name, term in objective.items()}


def check_terms(what: str, objective: Mapping[str, Term], values: Mapping[str, float]) -> None:
    """Refuse numbers of terms that are not there, and those that are negative or not finite.

    Raises:
        ValueError: naming the term, what came and what is allowed.
    """
    for name, value in values.items():
        checks.one_of(f"the term of a {what}", name, tuple(objective))
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"the {what} of {name} must be finite and not negative, got {value!r}")


OBJECTIVE: dict[str, Term] = {
    "fault_tau": Term(1.0, fault_tau),
    "fault_q": Term(1.0, fault_q),
    "tracking": Term(1.0, tracking),
    "chattering": Term(1.0, chattering),
    "effort": Term(0.1, effort),  # the motion decides it
    "delay": Term(1.0, delay),
    "false_alarm": Term(2.0, false_alarm),  # a diagnosis that cries wolf is switched off
    "isolation": Term(1.0, isolation),
    "stability": Term(1.0, stability, gains_only=True),
}
