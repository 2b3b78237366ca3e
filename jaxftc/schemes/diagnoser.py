"""Observer and diagnosis under somebody else's controller: readings and torques in, verdicts out, no reference and no command.

The sensor channel is ``observer.kinematic``: it needs no model of the arm. The torque channel is the momentum observer
(``schemes.momentum``): it needs no acceleration, and never divides by an inertia, which of an identified model may be far
from the arm's although its torques are right. What is measured of a torque is its value now, so the momentum balance takes
the mean of two. Statistics, alarms and verdicts are the cascade's.

* An arm that stands holds an unknown part of its weight by friction. Of a standing joint the residual is taken from its own
  slow mean, as far as ``diagnosis.stiction`` goes; a joint that moves has no friction to hide behind.
* A reading that is held to be wrong explains the torque residuals of all joints: their model was evaluated at it. A jump is
  taken out of the reading and explains nothing.

Left out: the velocity transient of ``sensor_check``. A short peak of the torque residual is friction more often than a drift.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxftc import checks
from jaxftc.config import Config
from jaxftc.diagnosis import alarm, decision, statistics
from jaxftc.gains import Gains, align
from jaxftc.gains import check as check_gains
from jaxftc.observer import kinematic, stability
from jaxftc.robot.model import Robot
from jaxftc.schemes import momentum
from jaxftc.types import Array

SETTLE = 0.3  # s in which nothing is said of torques, at the start and after a reading that was wrong
OFFSET = 1.0  # s in which the mean residual of a standing joint is learned
RESTLESS = 0.2  # s in which it is forgotten once the joint moves
HELD = 0.06  # of the torque limit: what gears hold by friction, where the model does not say more


class State(NamedTuple):
    """What the next tick needs."""

    tracker: kinematic.State
    residual: momentum.Observer
    tau: Array  # [n, ...] N m, last torque; not finite where it was not known
    offset: Array  # [n, ...] N m, mean residual of a standing joint
    age: Array  # [n, ...] ticks since the torque residual began
    statistics: statistics.State
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


class Measurement(NamedTuple):
    """What a tick takes in."""

    q: Array  # [n, ...] rad, encoder; not finite where there is no reading
    tau: Array  # [n, ...] N m, torque at this reading, measured or commanded; not finite where it is not known


def init(config: Config, gains: Gains, q: Array) -> State:
    """Nothing known but the reading q [n, ...] rad; the arm may be in motion."""
    zero = jnp.zeros_like(q)
    return State(
        tracker=kinematic.init(config, gains, q),
        residual=momentum.Observer(zero, *momentum.momentum(config.robot, q, zero)),
        tau=jnp.full_like(q, jnp.nan),
        offset=zero,
        age=zero,
        statistics=statistics.init(config, gains, q),
        alarm=alarm.init(config, gains, q),
    )


def step(config: Config, gains: Gains, state: State, measurement: Measurement) -> tuple[State, Diagnosis]:
    """One tick: pure, jit-able, vmap-able."""
    reading = kinematic.Inputs(measurement.q, state.alarm.q > 0, state.alarm.tau > 0)
    tracker, seen = kinematic.step(config, gains, state.tracker, reading)
    residual, age = _balance(config, gains, state, seen, measurement.tau)
    offset = _offset(config, gains, state, residual.r, seen.stands, age)
    settled = age * config.dt >= SETTLE
    watched = statistics.Inputs(jnp.where(settled, residual.r - offset, 0.0), seen.b)
    means, statistic = statistics.step(config, gains, state.statistics, watched)
    statistic = statistic._replace(tau=jnp.where(settled, statistic.tau, 0.0))
    alarms_next, alarms = alarm.step(config, gains, state.alarm, statistic)
    lost = ~(jnp.isfinite(statistic.tau) & jnp.isfinite(statistic.q))  # cannot be judged, which is not normal
    verdict = decision.verdict(alarms.tau | lost, alarms.q | seen.wrong | lost)
    said = Diagnosis(
        verdict=verdict,
        detected=(verdict > 0).any(0),
        fault_tau_hat=watched.tau,
        fault_q_hat=seen.fault_q,
        statistic_tau=statistic.tau,
        statistic_q=statistic.q,
        threshold_tau=jnp.broadcast_to(gains.diagnosis.alpha_tau, verdict.shape),
        threshold_q=jnp.broadcast_to(gains.diagnosis.alpha_q, verdict.shape),
        suspect=seen.wrong.astype(watched.tau.dtype),
        jump=seen.w,
        q_hat=seen.q_hat,
        qd_hat=seen.qd_hat,
    )
    return State(tracker, residual, measurement.tau, offset, age, means, alarms_next), said


def _balance(
    config: Config, gains: Gains, state: State, seen: kinematic.Estimate, tau: Array
) -> tuple[momentum.Observer, Array]:
    """Momentum residual of this tick [n, ...] N m, and its age in ticks.

    A tick with a jump, or without a torque or a reading, tells nothing of the momentum. At first the residual is a mean of
    what there is; after a reading that was wrong it begins anew.
    """
    now, before = momentum.momentum(config.robot, seen.q_hat, seen.qd_hat), state.residual
    middle = before._replace(drift=0.5 * (before.drift + now[1]))
    first = -jnp.log1p(-1 / (state.age + 1.001)) / config.dt  # a mean of all so far
    rate = jnp.maximum(gains.baseline.rate, first)
    r = momentum.observe(gains.baseline, middle, now, 0.5 * (state.tau + tau), config.dt, rate).r
    known = jnp.isfinite(state.tau) & jnp.isfinite(tau)
    blind = (seen.missing | (seen.h_s > 0.1)).any(0)
    wrong = seen.wrong.any(0)
    age = jnp.where(wrong, 0.0, state.age + known)
    return momentum.Observer(jnp.where(wrong, 0.0, jnp.where(known & ~blind, r, before.r)), *now), age


def _offset(config: Config, gains: Gains, state: State, r: Array, stands: Array, age: Array) -> Array:
    """Mean residual of joints that stand, [n, ...] N m, within what friction can hold; held while there is an alarm."""
    dt = config.dt
    learn = jnp.where(age * dt < SETTLE, 1.0, min(1.0, dt / OFFSET))
    limit = gains.diagnosis.stiction
    toward = jnp.clip(state.offset + learn * (r - state.offset), -limit, limit)
    moved = state.offset * (1 - min(1.0, dt / RESTLESS))
    return jnp.where(state.alarm.tau > 0, state.offset, jnp.where(stands, toward, moved))


def stiction(robot: Robot) -> np.ndarray:
    """Largest torque [n] N m that a standing joint may hold by friction."""
    known = np.maximum(np.abs(robot.coulomb_positive), np.abs(robot.coulomb_negative))
    return np.maximum(known, np.where(np.isfinite(robot.torque_limit), HELD * robot.torque_limit, 0.0))


class Diagnoser:
    """Fault diagnosis beside a controller that is not ours::

        diagnoser = jaxftc.Diagnoser(config, gains)
        state = diagnoser.init(q)
        state, said = diagnoser.step(state, q, torque)

    ``step`` is pure: jit it, scan it, or vmap it over arms (arrays [n, ...], scenarios last).

    Args:
        config: Robot and sample time; nothing else of it counts.
        gains: Of ``default_gains`` or ``jaxftc calibrate --logs``.

    Raises:
        ValueError: a gain is not allowed, or the observer is unstable with them at ``config.dt``.
    """

    def __init__(self, config: Config, gains: Gains) -> None:
        checks.instance("config", config, Config)
        checks.instance("gains", gains, Gains)
        if config.input != "rigid_body":
            raise ValueError(
                'the diagnoser needs input="rigid_body": it holds torques against the arm\'s model; without a model give NaN '
                "torques, and the readings alone are judged"
            )
        check_gains(config, gains)
        stability.check(config, gains)
        self.config, self.gains = config, gains

    def init(self, q: Array) -> State:
        """State for a first reading q [n, ...] rad.

        Raises:
            ValueError: q has the wrong shape or is not finite.
        """
        checks.joints_first("q", q, self.config.n)
        checks.finite("q", q, "begin at the first reading of every joint")
        q = jnp.asarray(q, self.gains.arx.xi_a.dtype)
        return init(self.config, align(self.gains, q.ndim - 1), q)

    def step(self, state: State, q: Any, torque: Any) -> tuple[State, Diagnosis]:
        """What a reading q [n, ...] rad and the torque beside it [n, ...] N m say; NaN where there is none.

        Raises:
            ValueError: a shape is wrong.
        """
        dtype = state.q.dtype
        q, torque = jnp.asarray(q, dtype), jnp.asarray(torque, dtype)
        checks.joints_first("q", q, self.config.n)
        checks.same_shape(["state.q", "q", "torque"], [state.q, q, torque])
        return step(self.config, align(self.gains, q.ndim - 1), state, Measurement(q, torque))
