"""Generalised momentum observer with computed torque: the field's standard for actuator faults and collisions.

The momentum p = M(q) qd obeys p' = tau + C^T qd - g - D qd - f_c + fault, without an acceleration and without an inverse of
M. The residual is the low-passed fault, joint by joint,

    r = K_o (p - p(0) - integral(tau + C^T qd - g - D qd - f_c + r)),   r' = K_o (fault - r).

Source: De Luca, Mattone, Actuator failure detection and isolation using generalized momenta, ICRA 2003; Haddadin, De Luca,
Albu-Schaeffer, Robot collisions: a survey on detection, isolation, and identification, IEEE T-RO 33(6), 2017, Eqs. (38) to
(41). Discretised exactly for signals that are constant in a tick, so stable at any rate.

C^T qd is M' qd - C qd (M' - 2C is skew for the C of Christoffel symbols). M' qd is the forward-mode derivative of M(q) qd
along qd: exact, and it comes with p from one pass of Newton-Euler over dual numbers. The gradient of the kinetic energy,
C^T qd = d/dq (qd^T M qd) / 2, is as exact and needs a reverse pass over all the pass has stored.

An encoder fault moves p as a torque would, and is called one: this method has one channel.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.control.last_command import LastCommand, applied_acceleration, hold
from jaxftc.diagnosis import alarm, decision, threshold
from jaxftc.diagnosis.statistics import Statistics
from jaxftc.gains import BaselineGains, Gains
from jaxftc.numerics.barrier import unstack
from jaxftc.robot import dynamics, lanes, rigid_body
from jaxftc.robot.model import Robot
from jaxftc.schemes import computed_torque
from jaxftc.schemes.computed_torque import Motion
from jaxftc.schemes.output import output
from jaxftc.types import Array, Measurement, Output, Reference

DIAGNOSES = True


class Observer(NamedTuple):
    """The residual and what its next value needs."""

    r: Array  # [n, ...] N m
    p: Array  # [n, ...] N m s
    drift: Array  # [n, ...] N m, C^T qd - g - D qd - f_c


class State(NamedTuple):
    """What the next tick needs."""

    motion: Motion
    observer: Observer
    alarm: alarm.State
    command: LastCommand

    q = computed_torque.State.q  # of ``motion``
    unread = computed_torque.State.unread
    tau = computed_torque.State.tau  # of ``command``


def gains_used(config: Config) -> set[str]:
    """Names of the gains that this scheme reads."""
    return computed_torque.gains_used(config) | {"baseline.rate", "diagnosis.alpha_tau", *threshold.GAINS}


def init(config: Config, gains: Gains, q: Array) -> State:
    """No fault, at rest in q [n, ...] rad."""
    zero = jnp.zeros_like(q)
    observer = Observer(zero, *momentum(config.robot, q, zero))
    return State(computed_torque.rest(q), observer, alarm.init(config, gains, q), hold(config.robot, q))


def step(config: Config, gains: Gains, state: State, reference: Reference, measurement: Measurement) -> tuple[State, Output]:
    """Observe the momentum, judge the residual, track with the residual compensated.

    p takes the speed of half a tick ago, as the ARX read-out and the plant do: it balances with the torque held meanwhile.
    """
    # The command compensates r, so the acceleration it stands for has r in it: without that the speed would be biased by a
    # fault, by M^-1 fault for as long as the speed filter remembers.
    qdd = applied_acceleration(state.command, measurement.tau)
    motion = computed_torque.follow(config, gains, state.motion, qdd, measurement.q)
    now = momentum(config.robot, motion.q, motion.half)
    observer = observe(gains.baseline, state.observer, now, measurement.tau, config.dt)
    level = threshold.of_reference(config.robot, gains.diagnosis, reference)
    found = alarm.Inputs(Statistics(observer.r, jnp.zeros_like(observer.r)), level)
    own, alarms = alarm.step(config, gains, state.alarm, found)
    command = computed_torque.law(config, gains, motion.q, motion.qd, reference, observer.r)
    said = output(
        config,
        command.tau,
        motion.q,
        motion.qd,
        threshold_tau=level,
        fault_tau=observer.r,
        verdict=decision.verdict(alarms.tau, alarms.q),
    )
    return State(motion, observer, own, command), said


@box("Momentum and its drift")
def momentum(robot: Robot, q: Array, qd: Array) -> tuple[Array, Array]:
    """Momentum p [n, ...] N m s, and its drift C^T qd - g - D qd - f_c [n, ...] N m, of the nominal arm at (q, qd)."""
    links = rigid_body.nominal_inertias(robot)

    def of_links(angle: Array) -> Array:
        at = rigid_body.pose(robot, angle)
        return lanes.stack(rigid_body.newton_euler(robot, links, at, None, unstack(qd), gravity=False), qd)

    p, turning = jax.jvp(of_links, (q,), (qd,))  # M qd, M' qd
    bias = rigid_body.newton_euler(robot, links, rigid_body.pose(robot, q), unstack(qd), None)  # C qd + g
    friction = dynamics.viscous(robot, qd) + dynamics.coulomb(robot, qd)
    drift = turning - lanes.stack(bias, qd) - friction
    return p + lanes.trailing_constant(robot.armature, qd) * qd, drift


@box("Momentum observer")
def observe(
    gains: BaselineGains, before: Observer, now: tuple[Array, Array], tau: Array, dt: float, rate: Array | None = None
) -> Observer:
    """Residual of this tick from (p, drift) now and the torque [n, ...] N m since the last tick.

    ``rate`` [n, ...] 1/s takes the place of the gains'.

    r+ = r + (1 - exp(-K_o T)) (fault - r) with fault = (p+ - p) / T - tau - drift, the drift at the beginning of the tick.
    """
    p, drift = now
    fault = (p - before.p) / dt - tau - before.drift
    rate = gains.rate if rate is None else rate
    return Observer(before.r - jnp.expm1(-rate * dt) * (fault - before.r), p, drift)
