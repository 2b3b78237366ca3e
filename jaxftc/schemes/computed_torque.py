"""Computed torque alone: no diagnosis. The control law of every baseline.

    tau = M (qdd_ref + kd (qd_ref - qd) + kp (q_ref - q)) + h + D qd + f_c(qd_ref) - fault

Source: Siciliano, Sciavicco, Villani, Oriolo, Robotics: Modelling, Planning and Control, 2009, 8.5.2 (inverse dynamics
control). The speed is the same predictive filter's as in the cascade (control/surface.py), so that schemes differ by their
observers and laws only. The estimated fault, where a baseline has one, is compensated as a disturbance observer does.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.control import surface
from jaxftc.control.last_command import LastCommand, applied_acceleration, hold
from jaxftc.gains import Gains
from jaxftc.robot import dynamics, reach, rigid_body
from jaxftc.schemes.output import output
from jaxftc.types import Array, Measurement, Output, Reference

DIAGNOSES = False
TRACKING = ("baseline.kp", "baseline.kd")  # gains of ``law``
SPEED = ("baseline.speed_weight",)  # of ``follow``


class Motion(NamedTuple):
    """What the encoder says of the motion."""

    q: Array  # [n, ...] rad, reading, predicted where there is none
    qd: Array  # [n, ...] rad/s
    half: Array  # [n, ...] rad/s, speed half a tick ago, which is what a difference of two angles says
    unread: Array  # [n, ...] ticks since there was a reading


class State(NamedTuple):
    """What the next tick needs."""

    motion: Motion
    command: LastCommand

    @property
    def q(self) -> Array:
        """Angle [n, ...] rad."""
        return self.motion.q

    @property
    def unread(self) -> Array:
        """Ticks [n, ...] since there was a reading."""
        return self.motion.unread

    @property
    def tau(self) -> Array:
        """Last command [n, ...] N m, before the limits."""
        return self.command.tau


def gains_used(config: Config) -> set[str]:
    """Names of the gains that this scheme reads."""
    del config
    return {*TRACKING, *SPEED}


def init(config: Config, gains: Gains, q: Array) -> State:
    """At rest in q [n, ...] rad."""
    del gains
    return State(rest(q), hold(config.robot, q))


def step(config: Config, gains: Gains, state: State, reference: Reference, measurement: Measurement) -> tuple[State, Output]:
    """Track, and say nothing of faults."""
    qdd = applied_acceleration(state.command, measurement.tau)
    motion = follow(config, gains, state.motion, qdd, measurement.q)
    zero = jnp.zeros_like(motion.q)
    command = law(config, gains, motion.q, motion.qd, reference, zero)
    return State(motion, command), output(config, command.tau, motion.q, motion.qd)


def rest(q: Array) -> Motion:
    """Standing still at q [n, ...] rad."""
    zero = jnp.zeros_like(q)
    return Motion(q, zero, zero, zero)


@box("Speed of the motion")
def follow(config: Config, gains: Gains, before: Motion, qdd: Array, reading: Array) -> Motion:
    """Angle and speed from a reading [n, ...] rad and the acceleration [n, ...] rad/s^2 of the last tick.

    Without a reading both are predicted. When readings come back the angle moves to them; that it had drifted is no speed.
    Nor is a jump of the reading: no speed is more than a joint's, so that the angle stays where readings can find it.
    """
    predicted = before.q + config.dt * (before.qd + 0.5 * config.dt * qdd)  # the angle at which the speed is not corrected
    missing = ~jnp.isfinite(reading)
    q = jnp.where(missing, predicted, reading)
    back = ~missing & (before.unread > 0)
    start = before.q + jnp.where(back, q - predicted, 0.0)
    qd = surface.speed(gains.baseline.speed_weight, before.qd, qdd, start, q, config.dt)
    half = before.half + config.dt * qdd
    half = half + gains.baseline.speed_weight * ((q - start) / config.dt - half)
    qd, half = (jnp.clip(speed, -reach.SPEED, reach.SPEED) for speed in (qd, half))
    return Motion(q, qd, half, jnp.where(missing, before.unread + 1, 0.0))


@box("Computed torque")
def law(config: Config, gains: Gains, q: Array, qd: Array, reference: Reference, fault: Array) -> LastCommand:
    """Command at (q, qd) [n, ...] rad, rad/s that follows the reference and compensates a torque ``fault`` [n, ...] N m."""
    robot, at = config.robot, rigid_body.pose(config.robot, q)
    qdd = reference.qdd + gains.baseline.kd * (reference.qd - qd) + gains.baseline.kp * (reference.q - q)
    friction = dynamics.coulomb(robot, reference.qd)  # at the wanted speed, see cascade.py
    tau = dynamics.nominal_torque(robot, at, qd, qdd) + friction - fault
    return LastCommand(tau, qdd, dynamics.nominal_mass(robot, at).packed(q))
