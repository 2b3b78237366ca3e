"""PD control with gravity compensation: a scheme in one file."""

from typing import NamedTuple

import jax.numpy as jnp

import jaxftc
from jaxftc.gains import block, gain
from jaxftc.schemes.output import output
from jaxftc.types import Array

DIAGNOSES = False  # it raises no alarm


@block
class GAINS:
    """Gains of this scheme: ``gains.own``."""

    kp: Array = gain("n", "N m/rad", 1000.0, low=0.0, doc="on the angle's error")
    kd: Array = gain("n", "N m s/rad", 60.0, low=0.0, doc="on the speed's error")
    weight: Array = gain("n", "1", 0.15, above=0.0, high=1.0, doc="of the measured against the last speed")


class State(NamedTuple):
    """What the next tick needs."""

    q: Array  # [n, ...] rad
    qd: Array  # [n, ...] rad/s
    unread: Array  # [n, ...] ticks since a reading was last used
    tau: Array  # [n, ...] N m, last command before the limits


def gains_used(config):
    """Names of the gains that this scheme reads."""
    return {"own.kp", "own.kd", "own.weight"}


def init(config, gains, q):
    """At rest in q [n, ...] rad."""
    zero = jnp.zeros_like(q)
    return State(q, zero, zero, jaxftc.inverse_dynamics(config.robot, q, zero, zero))


def step(config, gains, state, reference, measurement):
    """One tick."""
    missing = ~jnp.isfinite(measurement.q)
    q = jnp.where(missing, state.q + config.dt * state.qd, measurement.q)
    qd = state.qd + gains.own.weight * ((q - state.q) / config.dt - state.qd)
    zero = jnp.zeros_like(q)
    gravity = jaxftc.inverse_dynamics(config.robot, q, zero, zero)
    tau = gravity + gains.own.kp * (reference.q - q) + gains.own.kd * (reference.qd - qd)
    unread = jnp.where(missing, state.unread + 1, 0.0)
    return State(q, qd, unread, tau), output(config, tau, q, qd)
