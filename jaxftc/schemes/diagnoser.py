"""Observer and diagnosis under somebody else's controller: readings and torques in, verdicts out, no reference, no command.

The sensor channel is ``observer.kinematic``: it needs no model of the arm. The torque channel is the momentum observer
(``schemes.momentum``): it needs no acceleration, and never divides by an inertia, which of an identified model may be far
from the arm's although its torques are right. What is measured of a torque is its value now, so the momentum balance takes
the mean of two. Statistics, alarms and verdicts are the cascade's.

* A joint that stands, or turns round, holds an unknown torque by friction, up to ``diagnosis.stiction``. What the residual
  exceeds that by is judged. Once it has stood for a while, so are changes of what it held.
* What is wrong with a model lasts, so a slow residual has the lower threshold, and a fast one sees a large fault sooner.
  ``diagnosis.fast`` is the slow one's threshold over the fast one's; of a joint that moves, whichever is more of its
  threshold is judged.
* The torque threshold follows the estimated motion, low-passed as the residual is: a model that is off by b |qd| gives a
  residual of at most b times the low-passed |qd|. A fault moves the arm too, so while there is an alarm of a joint its
  threshold may fall and not rise.
* A reading that is held to be wrong explains the torque residuals of all joints: their model was evaluated at it. A jump is
  taken out of the reading and explains nothing.

Left out: the velocity transient of ``sensor_check``. A short peak of the torque residual is friction more often than a
drift.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxftc import checks
from jaxftc.config import Config
from jaxftc.diagnosis import alarm, contact, decision, statistics, threshold
from jaxftc.gains import Gains, align
from jaxftc.gains import check as check_gains
from jaxftc.observer import kinematic, stability
from jaxftc.robot import rigid_body
from jaxftc.robot.model import Robot
from jaxftc.schemes import momentum
from jaxftc.types import Array

SETTLE = 0.3  # s in which nothing is said of torques, at the start and after a reading that was wrong
SLOW = 0.03  # rad/s, below which friction is not known but for its limit
FAST, FASTEST = 20.0, 0.3  # 1/s, bandwidth of the fast residual, and in shares of the sample rate, at most
OFFSET = 1.0  # s for which a joint that came to rest may hold anything by friction, and in which that is learned afterwards
HELD = 0.06  # of the torque limit: what gears hold by friction, where the model does not say


class State(NamedTuple):
    """What the next tick needs."""

    tracker: kinematic.State
    residual: momentum.Observer
    tau: Array  # [n, ...] N m, last torque; not finite where it was not known
    offset: Array  # [n, ...] N m, part of the residual that friction holds
    fast: Array  # [n, ...] N m, the same residual with the bandwidth FAST, of a joint that moves
    carried: Array  # [n, ...] N m, what the residual exceeded friction by when the joint slowed down, as far as it remembers
    slow: Array  # [n, ...] s since the joint came to rest, or turned round
    age: Array  # [n, ...] ticks since the torque residual began
    statistics: statistics.State
    motion: threshold.Motion  # low-passed
    alarm: alarm.State

    @property
    def q(self) -> Array:
        """Angle [n, ...] rad that the arm is taken to be at."""
        return self.tracker.q1


class Diagnosis(NamedTuple):
    """What one tick says of the arm."""

    verdict: Array  # [n, ...] int32, a Verdict's number, Eq. (18)
    detected: Array  # [...] bool, any joint not normal
    fault_tau_hat: Array  # [n, ...] N m, estimated actuator fault
    fault_q_hat: Array  # [n, ...] rad, estimated encoder fault
    statistic_tau: Array  # [n, ...] N m, alarm when |S| reaches threshold_tau
    statistic_q: Array  # [n, ...] rad
    threshold_tau: Array  # [n, ...] N m
    threshold_q: Array  # [n, ...] rad
    suspect: Array  # [n, ...] 1 where the reading is held to be wrong, beyond a jump that was taken out
    jump: Array  # [n, ...] rad, what no acceleration explains of the reading
    q_hat: Array  # [n, ...] rad, reading less its estimated fault
    qd_hat: Array  # [n, ...] rad/s
    force: Array  # [n, ...] N, size of a force on the link that the joint moves, where that is found, else 0


class Measurement(NamedTuple):
    """What a tick takes in."""

    q: Array  # [n, ...] rad, encoder; not finite where there is no reading
    tau: Array  # [n, ...] N m, torque at this reading, measured or commanded; not finite where it is not known
    jitter: Array | float = 0.0  # [n, ...] s, by which the time between readings may be wrong


def init(config: Config, gains: Gains, q: Array) -> State:
    """Nothing known but the reading q [n, ...] rad; the arm may be in motion."""
    zero = jnp.zeros_like(q)
    return State(
        tracker=kinematic.init(config, gains, q),
        residual=momentum.Observer(zero, *momentum.momentum(config.robot, q, zero)),
        tau=jnp.full_like(q, jnp.nan),
        offset=zero,
        fast=zero,
        carried=zero,
        slow=zero,
        age=zero,
        statistics=statistics.init(config, gains, q),
        motion=threshold.Motion(*[zero] * len(threshold.FOLLOW)),
        alarm=alarm.init(config, gains, q),
    )


def step(config: Config, gains: Gains, state: State, measurement: Measurement) -> tuple[State, Diagnosis]:
    """One tick: pure, jit-able, vmap-able."""
    reading = kinematic.Inputs(measurement.q, state.alarm.q > 0, state.alarm.tau > 0, measurement.jitter)
    tracker, seen = kinematic.step(config, gains, state.tracker, reading)
    residual, fast, age = _balance(config, gains, state, seen, measurement.tau)
    offset, carried, slow = _offset(config, gains, state, residual.r, seen.qd_hat)
    settled = age * config.dt >= SETTLE
    watched = statistics.Inputs(jnp.where(settled, residual.r - offset, 0.0), seen.b)
    means, slower = statistics.step(config, gains, state.statistics, watched)
    fast = jnp.where(slow > 0, residual.r - offset, fast)
    slower = slower._replace(tau=jnp.where(settled, slower.tau, 0.0))
    soon = jnp.where(settled, gains.diagnosis.fast * fast, 0.0)
    statistic = slower._replace(tau=jnp.where(jnp.abs(soon) > jnp.abs(slower.tau), soon, slower.tau))
    motion, level = state.motion, jnp.broadcast_to(gains.diagnosis.alpha_tau, seen.q_hat.shape)
    if threshold.follows(gains.diagnosis):
        motion = _motion(config, gains, state, seen, tracker.psi)
        level = threshold.torque(gains.diagnosis, motion)
    alarms_next, alarms = alarm.step(config, gains, state.alarm, alarm.Inputs(statistic, level))
    lost = ~(jnp.isfinite(statistic.tau) & jnp.isfinite(statistic.q))  # cannot be judged, which is not normal
    bits = decision.verdict(alarms.tau | lost, alarms.q | seen.wrong | lost)
    pose = rigid_body.pose(config.robot, seen.q_hat)
    verdict, force = contact.judge(config, contact.Inputs(pose, slower.tau, level, bits))
    said = Diagnosis(
        verdict=verdict,
        detected=(verdict > 0).any(0),
        fault_tau_hat=watched.tau,
        fault_q_hat=seen.fault_q,
        statistic_tau=statistic.tau,
        statistic_q=statistic.q,
        threshold_tau=level,
        threshold_q=jnp.broadcast_to(gains.diagnosis.alpha_q, verdict.shape),
        suspect=seen.wrong.astype(watched.tau.dtype),
        jump=seen.w,
        q_hat=seen.q_hat,
        qd_hat=seen.qd_hat,
        force=force,
    )
    return State(tracker, residual, measurement.tau, offset, fast, carried, slow, age, means, motion, alarms_next), said


def _balance(
    config: Config, gains: Gains, state: State, seen: kinematic.Estimate, tau: Array
) -> tuple[momentum.Observer, Array, Array]:
    """Momentum residual of this tick [n, ...] N m, the fast one, and their age in ticks.

    A tick with a jump, or without a torque or a reading, tells nothing of the momentum. At first the residual is a mean of
    what there is; after a reading that was wrong, or a start in motion, it begins anew.
    """
    now, before = momentum.momentum(config.robot, seen.q_hat, seen.qd_hat), state.residual
    middle = before._replace(drift=0.5 * (before.drift + now[1]))
    quick = jnp.maximum(min(FAST, FASTEST / config.dt), _rate(config, gains, state))
    r, fast = (
        momentum.observe(gains.baseline, middle._replace(r=old), now, 0.5 * (state.tau + tau), config.dt, rate).r
        for old, rate in ((before.r, _rate(config, gains, state)), (state.fast, quick))
    )
    known = jnp.isfinite(state.tau) & jnp.isfinite(tau)
    blind = (seen.missing | (seen.h_s > 0.1)).any(0)
    anew = (seen.wrong | ~seen.known).any(0)
    age = jnp.where(anew, 0.0, state.age + known)
    r, fast = (jnp.where(anew, 0.0, jnp.where(known & ~blind, new, old)) for new, old in ((r, before.r), (fast, state.fast)))
    return momentum.Observer(r, *now), fast, age


def _rate(config: Config, gains: Gains, state: State) -> Array:
    """Bandwidth [n, ...] 1/s of the residual in this tick: at first it is a mean of all so far."""
    first = -jnp.log1p(-1 / (state.age + 1.001)) / config.dt
    return jnp.maximum(gains.diagnosis.rate, first)


def _motion(config: Config, gains: Gains, state: State, seen: kinematic.Estimate, qdd: Array) -> threshold.Motion:
    """The motion that the threshold follows, low-passed as the residual is; qdd [n, ...] rad/s^2 is its acceleration.

    Nothing is taken of a reading that is held to be wrong.
    """
    now = threshold.motion(config.robot, seen.q_hat, seen.qd_hat, qdd)
    share = jnp.where(seen.wrong | ~seen.known, 0.0, -jnp.expm1(-_rate(config, gains, state) * config.dt))
    falling = state.alarm.tau > 0
    return threshold.Motion(
        *(
            old + jnp.where(falling & (new > old), 0.0, share) * (new - old)
            for old, new in zip(state.motion, now, strict=True)
        )
    )


def _offset(config: Config, gains: Gains, state: State, r: Array, qd: Array) -> tuple[Array, Array, Array]:
    """What friction holds of the residual r [n, ...] N m at speeds qd [n, ...] rad/s, what is carried, and the time of rest.

    For a while after a joint has come to rest, any torque up to ``diagnosis.stiction``; then what it held, and slow
    changes of it; none while there is an alarm. It dies out as the residual does once the joint moves, alarm or not: else an
    alarm at the start of a motion would last.

    The residual is a mean of the past, so that what it had when the joint slowed down is carried on. Friction explains what
    comes to it afterwards, and not the impact that stopped the joint.
    """
    own, dt = gains.diagnosis.stiction, config.dt
    slow, fade = jnp.where(jnp.abs(qd) < SLOW, state.slow + dt, 0.0), jnp.exp(-gains.diagnosis.rate * dt)
    carried = jnp.where(slow > 0, fade * state.carried, r - fade * state.offset)
    gain = jnp.where(slow < OFFSET, 1.0, dt / OFFSET)
    held = jnp.clip(state.offset + gain * (r - carried - state.offset), -own, own)
    offset = jnp.where(slow > 0, held, fade * state.offset)
    stays = (state.alarm.tau > 0) & (slow > 0)
    return jnp.where(stays, jnp.clip(state.offset, -own, own), offset), carried, slow


def stiction(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Largest torque [n] N m that a standing joint may hold by friction: the model's, and a usual share of the limit."""
    known = np.maximum(np.abs(robot.coulomb_positive), np.abs(robot.coulomb_negative))
    return known, np.where(np.isfinite(robot.torque_limit), HELD * robot.torque_limit, 0.0)


class Diagnoser:
    """Fault diagnosis beside a controller that is not ours.

    Like this::

        diagnoser = jaxftc.Diagnoser(config, gains)
        state = diagnoser.init(q)
        state, said = diagnoser.step(state, q, torque)

    ``step`` is pure: jit it, scan it, or vmap it over arms (arrays [n, ...], scenarios last).

    Args:
        config: Robot, sample time, and whether contacts are judged. It names by the rule, and learns nothing of the arm: a
            config that asks for more is refused. Nothing else of it counts.
        gains: Of ``default_gains`` or ``jaxftc calibrate --logs``.

    Raises:
        ValueError: a gain is not allowed, the observer is unstable with them at ``config.dt``, or the config asks for what
            only a controller of ours does.
    """

    def __init__(self, config: Config, gains: Gains) -> None:
        checks.instance("config", config, Config)
        checks.instance("gains", gains, Gains)
        if config.input != "rigid_body":
            raise ValueError(
                'the diagnoser needs input="rigid_body": it holds torques against the arm\'s model; without one give NaN '
                "torques, and the readings alone are judged"
            )
        if config.decision != "rule" or config.adaptive:
            raise ValueError(
                'the diagnoser names by the rule and learns nothing of the arm; give Config(decision="rule", '
                f"adaptive=False), got decision={config.decision!r}, adaptive={config.adaptive!r}"
            )
        check_gains(config, gains)
        stability.check(config, gains)
        self.config, self.gains = config, gains

    def init(self, q: Array) -> State:
        """State for a first reading q [n, ...] rad.

        Raises:
            ValueError: q has the wrong shape or is not finite.
        """
        q = checks.filled(q)
        checks.joints_first("q", q, self.config.n)
        checks.finite("q", q, "begin at the first reading of every joint")
        q = jnp.asarray(q, self.gains.arx.xi_a.dtype)
        return init(self.config, align(self.gains, q.ndim - 1), q)

    def step(self, state: State, q: Any, torque: Any) -> tuple[State, Diagnosis]:
        """What a reading q [n, ...] rad and the torque beside it [n, ...] N m say; NaN, or masked, where there is none.

        Raises:
            ValueError: a shape is wrong, or the state is of another kind.
        """
        checks.instance("state", state, State)
        dtype = state.q.dtype
        q, torque = (jnp.asarray(checks.filled(signal), dtype) for signal in (q, torque))
        checks.joints_first("q", q, self.config.n)
        checks.same_shape(["state.q", "q", "torque"], [state.q, q, torque])
        return step(self.config, align(self.gains, q.ndim - 1), state, Measurement(q, torque))
