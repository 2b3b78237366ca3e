"""What a fault does to the torque that reaches the arm and to the reading that reaches the controller.

Every kind is computed and the one that is there is selected, so that kinds are data. The first-order jump at onset has no
gradient with respect to onset. Magnitudes have one, but for the ticks of a delay and the size of an encoder's count.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike

from jaxftc.numerics.barrier import store
from jaxftc.scenarios.faults import LATEST, Actuator, Fault, Kind, Reading, Sensor, Torque
from jaxftc.simulation.fault_profiles import present, size
from jaxftc.types import Array


class Past(NamedTuple):
    """The last values of a signal, in a ring."""

    values: Array  # [LATEST, n, ...]
    turn: Array  # int32, place of the oldest

    def after(self, now: Array) -> Past:
        """With one value [n, ...] more, in the place of the oldest."""
        values = lax.dynamic_update_index_in_dim(self.values, now, self.turn, 0)
        return Past(values, jnp.where(self.turn == LATEST - 1, 0, self.turn + 1))

    def late(self, now: Array, ticks: Array) -> Array:
        """The value of some ticks ago [n, ...]; of half a tick, the nearest."""
        for k in range(LATEST):
            place = jnp.where(self.turn > k, self.turn - 1 - k, self.turn + LATEST - 1 - k)
            now = jnp.where(ticks > k + 0.5, lax.dynamic_index_in_dim(self.values, place, 0, keepdims=False), now)
        return now


class State(NamedTuple):
    """Last values while all was well, for the kinds that freeze, and earlier ones, for those that are late."""

    tau: Array  # [n, ...] N m
    y: Array  # [n, ...] rad
    q: Array  # [n, ...] rad, true angle
    commands: Past  # N m
    readings: Past  # rad, without a fault


class Motion(NamedTuple):
    """How the arm moves, for faults that depend on it."""

    q: ArrayLike  # [n, ...] rad
    qd: ArrayLike  # [n, ...] rad/s
    inertia: ArrayLike  # [n, ...] kg m^2, that a joint moves
    dt: float  # s


def init(tau: Array, y: Array, q: Array) -> State:
    """State of a run that begins with a torque [n, ...] N m, a reading y and an angle q [n, ...] rad."""
    return State(tau, y, q, _standing(tau), _standing(y))


def _standing(value: Array) -> Past:
    """A past in which the signal was always ``value`` [n, ...]."""
    return Past(jnp.broadcast_to(value, (LATEST, *value.shape)), jnp.zeros((), jnp.int32))


def deliver(fault: Fault, state: State, t: Array, tau: Array, limit: Array, motion: Motion) -> tuple[State, Array]:
    """Torque [n, ...] N m that reaches the arm for a command tau [n, ...] N m within ``limit`` [n, ...]."""
    there, share = present(fault, t), size(fault, t)
    held, q_held = jnp.where(there, state.tau, tau), jnp.where(there, state.q, motion.q)
    commands, late = _late(fault.kind == Actuator.DELAY, state.commands, tau, share * fault.magnitude)
    torque = Torque(
        tau,
        share * fault.magnitude,
        share,
        fault.magnitude,
        held,
        limit,
        late,
        jnp.broadcast_to(motion.q, tau.shape),
        jnp.broadcast_to(motion.qd, tau.shape),
        q_held,
        jnp.broadcast_to(motion.inertia, tau.shape),
        motion.dt,
    )
    delivered = _effect(Actuator, fault, there, torque, tau)
    held, q_held, delivered = store((held, q_held, delivered))
    return state._replace(tau=held, q=q_held, commands=commands), delivered


def read(fault: Fault, state: State, t: Array, q: Array, noise: Array) -> tuple[State, Array, Array]:
    """(state, reading [n, ...] rad, fault in it [n, ...] rad) for an angle q and encoder noise [n, ...] rad."""
    there, share = present(fault, t), size(fault, t)
    clean = q + noise
    held = jnp.where(there, state.y, clean)
    readings, late = _late(fault.kind == Sensor.DELAY, state.readings, clean, share * fault.magnitude)
    signal = Reading(q, noise, share * fault.magnitude, share, fault.magnitude, t - fault.onset, held, late)
    reading = _effect(Sensor, fault, there, signal, clean)
    state = state._replace(y=held, readings=readings)
    return state, reading, jnp.where(jnp.isnan(reading), 0.0, reading - clean)


def _late(some: Array, past: Past, now: Array, ticks: Array) -> tuple[Past, Array]:
    """The memory with this tick's signal, and the signal of some ticks ago; ``now`` and ``ticks`` [n, ...].

    Memory is dear in a large batch, 14 % of a tick: it is kept only where one scenario of the batch needs it.
    """
    return lax.cond(jnp.any(some), lambda p, x, d: (p.after(x), p.late(x, d)), lambda p, x, d: (p, x), past, now, ticks)


def _effect(kinds: type[Kind], fault: Fault, there: Array, signal: Torque | Reading, healthy: Array) -> Array:
    """The signal [n, ...] with the fault that is there, from the healthy one [n, ...]."""
    for kind in kinds:
        if kind:
            healthy = jnp.where(there & (fault.kind == kind), kind.effect(signal), healthy)
    return healthy
