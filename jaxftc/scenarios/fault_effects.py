"""What kinds of fault do to a torque and to a reading, where that takes more than a line of the table."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxftc.numerics.trigonometry import cos_sin
from jaxftc.types import Array

RIPPLES = 60  # of a motor's torque, in one turn of its joint
FRICTION_SPEED = 0.1  # rad/s, width of a fault's friction
LOCK = 50.0  # rad/s, natural frequency of a joint in its brake


class Torque(NamedTuple):
    """What an actuator's fault acts on."""

    tau: Array  # [n, ...] N m, command
    size: Array  # [n, ...] in the kind's unit, grown as far as its law in time says
    share: Array  # [n, ...] 1, how far it has grown
    magnitude: Array  # [n, ...] in the kind's unit, grown to the full
    held: Array  # [n, ...] N m, torque at onset
    limit: Array  # [n, ...] N m, infinite if there is none
    late: Array  # [n, ...] N m, command of ``size`` ticks ago
    q: Array  # [n, ...] rad, true angle
    qd: Array  # [n, ...] rad/s
    q_held: Array  # [n, ...] rad, angle at onset
    inertia: Array  # [n, ...] kg m^2, that a joint moves
    dt: float  # s, time between ticks


class Reading(NamedTuple):
    """What an encoder's fault acts on."""

    q: Array  # [n, ...] rad, true angle
    noise: Array  # [n, ...] rad, the encoder's own
    size: Array  # [n, ...] in the kind's unit, grown as far as its law in time says
    share: Array  # [n, ...] 1, how far it has grown
    magnitude: Array  # [n, ...] in the kind's unit, grown to the full
    since: Array  # [n, ...] s, time from onset on
    held: Array  # [n, ...] rad, reading at onset
    late: Array  # [n, ...] rad, reading of ``size`` ticks ago

    @property
    def clean(self) -> Array:
        """Reading [n, ...] rad without a fault."""
        return self.q + self.noise


def ripple(x: Torque) -> Array:
    """Torque [n, ...] N m that goes up and down with the angle."""
    return x.tau + x.size * cos_sin(RIPPLES * x.q)[1]


def rubbed(x: Torque) -> Array:
    """Torque [n, ...] N m less a friction, which is softer where one tick of it would turn the speed round."""
    width = jnp.maximum(FRICTION_SPEED, x.size * x.dt / x.inertia)
    return x.tau - x.size * jnp.tanh(x.qd / width)


def locked(x: Torque) -> Array:
    """A brake in place of the motor: a stiff spring to the angle at onset, critically damped for the joint's inertia."""
    frequency = min(LOCK, 0.2 / x.dt)  # slow enough for the tick
    brake = x.inertia * frequency * (frequency * (x.q_held - x.q) - 2 * x.qd)
    return x.tau + x.share * (brake - x.tau)


def wrapped(x: Reading) -> Array:
    """Angle [n, ...] rad, within plus and minus the magnitude; it begins anew beyond."""
    half = jnp.where(x.magnitude > 0, x.magnitude, 1.0)
    return x.clean - 2 * half * jnp.round(x.clean / (2 * half))


def in_counts(x: Array, size: Array) -> Array:
    """Angles [n, ...] rad in whole counts of a size in rad, 0 for none; the slope is that of ``x``."""
    count = jnp.where(size > 0, size, 1.0)
    return x + lax.stop_gradient(jnp.where(size > 0, count * jnp.round(x / count) - x, 0.0))


def saturated(x: Torque) -> Array:
    """Torque [n, ...] N m within what is left of its limit."""
    left = jnp.where(jnp.isfinite(x.limit), x.limit, 0.0) * (1 - x.share * (1 - x.magnitude))
    return jnp.where(jnp.isfinite(x.limit), jnp.clip(x.tau, -left, left), x.tau)
