"""Figures of merit of a run, kept while it lasts: a campaign stores no trajectory.

``init`` and ``step`` follow one tick after the other, ``total`` comes last. The truth is the scenario's: a fault is there
from the first onset to the last clearance. ``Score`` has one number a scenario; ``table`` makes columns of it.

An alarm is false before the first onset and in a healthy run; up to ``RECOVERY`` after the last clearance it is excused. A
fault is found by an alarm that rises in that time: one that is up from before has found nothing. A fault that would begin
after the run's end is none. A verdict is scored twice: soon after the alarm, and when it has had time to settle. What could
be seen by then is beside it (``oracle.py``).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxftc.config import Config
from jaxftc.evaluation import oracle
from jaxftc.evaluation.metrics import RECOVERY, SETTLE
from jaxftc.gains import Gains
from jaxftc.numerics import barrier
from jaxftc.numerics.batch import trailing
from jaxftc.robot import lanes
from jaxftc.scenarios.scenario import Scenario
from jaxftc.simulation.closed_loop import Trace
from jaxftc.types import Array, Verdict

SETTLED = 0.300  # s after the alarm at which the verdict has settled; at clearance, if that comes first
ISOLATED = 0.020  # s for which every joint's verdict must stay right to count as isolated
ROUGH = 50.0  # Hz, above which torque counts as rough
LEVELS = np.geomspace(1 / 4, 4, 25)  # threshold scales of the ROC; the middle one is 1


class Truth(NamedTuple):
    """What is true of a run, which only the scoring may know."""

    wanted: Array  # [n, ...] int32, the verdict that is right while the faults are there
    healthy: Array  # [...] bool
    onset: Array  # [...] s, first onset; 0 in a healthy run
    clear: Array  # [...] s, last clearance; infinite in a healthy run


class Score(NamedTuple):
    """One run. Sums run over joints and ticks; times are infinite where the thing did not happen."""

    se_tau: Array  # (N m)^2, of the torque-fault estimate's error; a contact's torque counts as one
    se_q: Array  # rad^2, of the encoder-fault estimate's error
    ise: Array  # rad^2, true angle against the reference
    iae: Array  # rad
    itae: Array  # rad s
    track_max: Array  # rad, largest of any joint
    effort: Array  # 1, squared torque over its limit
    travel: Array  # 1, change of torque over its limit
    rough: Array  # 1, squared torque over its limit above ROUGH
    saturated: Array  # joint-ticks at the torque limit
    peak: Array  # 1, largest torque over its limit
    false_ticks: Array  # ticks with a false alarm
    false_events: Array  # times that a false alarm rose
    false_at: Array  # s, first alarm that is not excused
    began: Array  # s, first tick at or after onset
    alarm_at: Array  # s, first alarm of a joint and channel that rises at or after onset and is excused
    isolated_at: Array  # s, from when on every verdict was right for ISOLATED, at or after onset
    quiet_at: Array  # s, first tick after clearance without an alarm
    verdict: Array  # [n, ...] int32, SETTLE after alarm_at; of a healthy run all that was ever said
    settled: Array  # [n, ...] int32, SETTLED after alarm_at, or at clearance; of a healthy run all that was ever said
    complete_at: Array  # s, first time that the verdict names every faulty joint and channel by alarms since onset
    visible_at: Array  # s, first time that an oracle sees a fault
    visible: Array  # [n, ...] int32, what an oracle has seen when ``verdict`` is scored; without an alarm, ever
    visible_late: Array  # [n, ...] int32, the same for ``settled``
    unsure: Array  # bool, any joint's part of ``verdict`` was a guess; not of a healthy run
    unsure_late: Array  # bool, the same of ``settled``
    force: Array  # N, largest estimate of a contact's force in the tick that ``verdict`` is scored
    crossed: Array  # [levels, ...] s, when the alarm would have come with all thresholds times LEVELS
    healthy_tau: Array  # [n, ...] N m, largest statistic that lasted for an alarm before onset, over its threshold's rise
    healthy_q: Array  # [n, ...] rad
    healthy_ratio: Array  # 1, largest of them over its threshold; infinite where the sensor check alarmed first
    lost: Array  # bool, the arm diverged


_SUMS = ("se_tau", "se_q", "ise", "iae", "itae", "effort", "travel", "rough", "saturated")  # over joints, at the end
_LARGEST = ("track_max", "peak", "lost")  # of the joints, at the end
_TIMES = ("false_at", "began", "alarm_at", "isolated_at", "quiet_at", "complete_at", "visible_at")  # infinite before


class State(NamedTuple):
    """The score so far and what the next tick needs."""

    score: Score  # [n, ...] where ``total`` is yet to put the joints together
    tau: Array  # [n, ...] 1, last torque over its limit
    verdict: Array  # [n, ...] int32, of the last tick
    risen: Array  # [n, ...] int32, what of it rose at or after onset
    ratio: Array  # 1, largest statistic over its threshold, of the last tick
    rough: Array  # [2, n, ...] 1, states of the high-pass filter
    held: Array  # [alarm_ticks - 1, n, ...] N m, last torque statistics, over what their thresholds had risen by
    right: Array  # ticks in a row with every verdict right
    top: Array  # 1, largest statistic over its threshold so far, before onset and from then on


def truth(config: Config, scenario: Scenario) -> Truth:
    """What the scenario says of its faults; scenario axes trailing."""
    faults, contact = (scenario.fault_tau, scenario.fault_q), scenario.contact
    faulty = [(fault.kind > 0) & (fault.onset <= (config.ticks - 1) * config.dt) for fault in faults]
    ill = (faulty[0] | faulty[1]).any(0)
    wanted = faulty[0].astype(jnp.int32) + 2 * faulty[1].astype(jnp.int32)
    onset = jnp.stack([jnp.where(f, fault.onset, jnp.inf) for f, fault in zip(faulty, faults, strict=True)]).min((0, 1))
    clear = jnp.stack([jnp.where(f, fault.clear, -jnp.inf) for f, fault in zip(faulty, faults, strict=True)]).max((0, 1))
    if contact is not None:
        pushed = (contact.size > 0) & (contact.link > 0) & (contact.onset <= (config.ticks - 1) * config.dt)
        onset = jnp.minimum(onset, jnp.where(pushed, contact.onset, jnp.inf))
        clear = jnp.maximum(clear, jnp.where(pushed, contact.clear, -jnp.inf))
        bears = pushed & (lanes.trailing_constant(np.arange(1, config.n + 1), faulty[0]) <= contact.link)
        ill, wanted = ill | pushed, wanted + Verdict.CONTACT * bears.astype(jnp.int32)
    return Truth(wanted, ~ill, jnp.where(ill, onset, 0.0), jnp.where(ill, clear, jnp.inf))


def init(config: Config, like: Array) -> State:
    """Nothing scored yet; ``like`` [n, ...] gives scenario axes and precision."""
    zero, never = jnp.zeros_like(like[0]), jnp.full_like(like[0], jnp.inf)
    scores = {name: zero for name in Score._fields}
    scores |= {name: never for name in _TIMES}
    scores |= {name: jnp.zeros_like(like) for name in (*_SUMS, *_LARGEST)}
    scores |= {name: jnp.zeros(like.shape, jnp.int32) for name in ("verdict", "settled", "visible", "visible_late")}
    scores |= {
        "crossed": jnp.full((len(LEVELS), *zero.shape), jnp.inf, like.dtype),
        "healthy_tau": jnp.zeros_like(like),
        "healthy_q": jnp.zeros_like(like),
        "lost": jnp.zeros(like.shape, bool),
        "unsure": zero > 0,
        "unsure_late": zero > 0,
    }
    held = jnp.zeros((config.alarm_ticks - 1, *like.shape), like.dtype)
    rough = jnp.zeros((2, *like.shape), like.dtype)
    none = scores["verdict"]
    return State(Score(**scores), jnp.zeros_like(like), none, none, zero, rough, held, right=zero, top=zero)


def total(state: State) -> Score:
    """The score of runs that are through: joints are put together once, not every tick."""
    score = state.score
    whole = {name: getattr(score, name).sum(0) for name in _SUMS} | {name: getattr(score, name).max(0) for name in _LARGEST}
    return score._replace(**whole)


def step(config: Config, gains: Gains, true: Truth, state: State, tick: Trace) -> State:
    """One tick: ``tick`` is a ``Trace`` of a moment, [n, ...]."""
    before = (tick.t < true.onset) | true.healthy
    excused = (tick.t >= true.onset) & (tick.t <= true.clear + RECOVERY)
    arm, tau, rough = _arm(config, state, tick)
    alarms = _alarms(true, state, tick, before, excused)
    verdicts, risen, right = _verdicts(config, true, state, tick, alarms["alarm_at"], excused)
    margins, held, ratio, top = _margins(config, gains, true, state, tick, before, excused)
    return State(
        score=state.score._replace(**arm, **alarms, **verdicts, **margins),
        tau=tau,
        verdict=tick.out.verdict,
        risen=risen,
        ratio=ratio,
        rough=rough,
        held=held,
        right=right,
        top=top,
    )


def _arm(config: Config, state: State, tick: Trace) -> tuple[dict[str, Array], Array, Array]:
    """How well the arm does: scores by name, torque over its limit [n, ...], states of the high-pass filter."""
    score, out, t = state.score, tick.out, tick.t
    limited = lanes.trailing_constant(np.isfinite(config.robot.torque_limit), tick.q) > 0
    tau = out.tau / scale(config, tick.q)
    change = jnp.where(t > 0, tau - state.tau, 0.0)
    filtered, rough = _high_pass(config, state.rough, tau, t)
    error = tick.q - tick.q_ref
    size = jnp.abs(error)
    found = {
        "se_tau": score.se_tau + (out.fault_tau_hat - (tick.fault_tau + tick.contact_tau)) ** 2,
        "se_q": score.se_q + (out.fault_q_hat - tick.fault_q) ** 2,
        "ise": score.ise + error * error,
        "iae": score.iae + size,
        "itae": score.itae + t * size,
        "track_max": jnp.maximum(score.track_max, size),
        "effort": score.effort + tau * tau,
        "travel": score.travel + jnp.abs(change),
        "rough": score.rough + rough * rough,
        "saturated": score.saturated + ((jnp.abs(tau) >= 1 - 1e-6) & limited),
        "peak": jnp.maximum(score.peak, jnp.abs(tau)),
        "lost": score.lost | ~jnp.isfinite(tick.q),
    }
    return found, tau, filtered


def _alarms(true: Truth, state: State, tick: Trace, before: Array, excused: Array) -> dict[str, Array]:
    """False alarms, and the times of the others; ``before`` onset [...] bool, ``excused`` [...] bool."""
    score, out, t = state.score, tick.out, tick.t
    false = out.detected & before
    rises = (out.verdict & ~state.verdict > 0).any(0)
    return {
        "false_ticks": score.false_ticks + false,
        "false_events": score.false_events + (false & (state.verdict == 0).all(0)),
        "false_at": _earliest(score.false_at, out.detected & (true.healthy | ~excused), t),
        "began": _earliest(score.began, t >= true.onset, t),
        "alarm_at": _earliest(score.alarm_at, rises & excused, t),
        "quiet_at": _earliest(score.quiet_at, ~out.detected & (t > true.clear), t),
    }


def _verdicts(
    config: Config, true: Truth, state: State, tick: Trace, alarm_at: Array, excused: Array
) -> tuple[dict[str, Array], Array, Array]:
    """What was said, and what could be seen: scores by name, alarms since onset [n, ...], ticks in a row that were right."""
    score, out, t = state.score, tick.out, tick.t
    right = jnp.where((t >= true.onset) & (out.verdict == true.wanted).all(0), state.right + 1, 0.0)
    enough = round(ISOLATED / config.dt)
    until = alarm_at + SETTLE + 0.5 * config.dt
    until_late = jnp.maximum(alarm_at, jnp.minimum(alarm_at + SETTLED, true.clear)) + 0.5 * config.dt
    scoring, settling = (true.healthy | (t <= end) & (alarm_at <= t) for end in (until, until_late))
    said = jnp.where(true.healthy, score.verdict, 0)  # of a healthy run everything counts
    risen = jnp.where(t >= true.onset, out.verdict & (state.risen | ~state.verdict), 0)
    complete = (risen & true.wanted == true.wanted).all(0) & excused & ~true.healthy
    sight = oracle.step(
        oracle.Sight(score.visible_at, score.visible, score.visible_late), tick, true.wanted, until, until_late
    )
    unsure = (out.unsure > 0).any(0)
    found = {
        "isolated_at": _earliest(score.isolated_at, right >= enough, t - (enough - 1) * config.dt),
        "verdict": jnp.where(scoring, said | out.verdict, score.verdict),
        "settled": jnp.where(settling, said | out.verdict, score.settled),
        "complete_at": _earliest(score.complete_at, complete, t),
        "visible_at": sight.at,
        "visible": sight.early,
        "visible_late": sight.late,
        "unsure": jnp.where(scoring & ~true.healthy, unsure, score.unsure),
        "unsure_late": jnp.where(settling & ~true.healthy, unsure, score.unsure_late),
        "force": jnp.where(scoring & ~true.healthy, out.force.max(0), score.force),
    }
    return found, risen, right


def _margins(
    config: Config, gains: Gains, true: Truth, state: State, tick: Trace, before: Array, excused: Array
) -> tuple[dict[str, Array], Array, Array, Array]:
    """Statistics against their thresholds: scores by name, and ``held``, ``ratio`` and ``top`` of the state."""
    score, out, t = state.score, tick.out, tick.t
    at_rest = trailing(gains.diagnosis.alpha_tau, 1, tick.q.ndim - 1)
    size_tau, size_q = jnp.abs(out.statistic_tau) * (at_rest / out.threshold_tau), jnp.abs(out.statistic_q)
    history = jnp.concatenate([state.held, size_tau[None]])
    lasting = history.min(0)
    ratio = jnp.maximum(lasting / at_rest, size_q / out.threshold_q).max(0)
    top = jnp.where((t >= true.onset) & (t - config.dt < true.onset), 0.0, state.top)
    by_check = (out.suspect > 0).any(0) & (jnp.maximum(top, ratio) < 1)  # after an alarm it may be that alarm's own
    ratio = jnp.where(by_check, jnp.inf, ratio)
    levels = trailing(jnp.asarray(LEVELS, t.dtype), 1, ratio.ndim)
    found = {
        "crossed": _earliest(score.crossed, excused & (ratio >= levels) & (state.ratio < levels), t),
        "healthy_tau": jnp.where(before, jnp.maximum(score.healthy_tau, lasting), score.healthy_tau),
        "healthy_q": jnp.where(before, jnp.maximum(score.healthy_q, size_q), score.healthy_q),
        "healthy_ratio": jnp.where(before, jnp.maximum(score.healthy_ratio, ratio), score.healthy_ratio),
    }
    return found, history[1:], ratio, jnp.maximum(top, ratio)


def _earliest(so_far: Array, there: Array, t: Array) -> Array:
    """The first time [...] s at which something was there."""
    return jnp.minimum(so_far, jnp.where(there, t, jnp.inf))


def scale(config: Config, like: Array) -> Array:
    """Torque limits [n, ...] N m; 1 where there is none."""
    limit = np.where(np.isfinite(config.robot.torque_limit), config.robot.torque_limit, 1.0)
    return lanes.trailing_constant(limit, like)


def _high_pass(config: Config, state: Array, x: Array, t: Array) -> tuple[Array, Array]:
    """(state [2, n, ...], x above ROUGH [n, ...]): second-order Butterworth by the bilinear transform, at rest at t = 0.

    Nothing is above ROUGH where the sample rate is too low for it.
    """
    if 2 * ROUGH * config.dt >= 1:
        return state, jnp.zeros_like(x)
    k = math.tan(math.pi * ROUGH * config.dt)
    b = 1 / (1 + math.sqrt(2) * k + k * k)
    a1, a2 = 2 * (k * k - 1) * b, (1 - math.sqrt(2) * k + k * k) * b
    moved = b * x
    first, second = (jnp.where(t > 0, old, rest) for old, rest in zip(state, (-moved, moved), strict=True))
    y = moved + first
    return barrier.stack([second - 2 * moved - a1 * y, moved - a2 * y]), y
