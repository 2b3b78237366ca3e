"""What a fault does to the torque that reaches the arm and to the reading that reaches the controller.

Every kind is computed and the one that is there is selected, so that kinds are data; where a set of scenarios is known to
have common kinds only, these alone, a tenth of a tick less. The first-order jump at onset has no
gradient with respect to onset. Magnitudes have one, but for the ticks of a delay and the size of an encoder's count.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike

from jaxftc.numerics.barrier import store
from jaxftc.scenarios.fault_effects import Reading, Torque, in_counts
from jaxftc.scenarios.faults import LATEST, Actuator, Fault, Kind, Sensor, common
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


class Uncommon(NamedTuple):
    """What uncommon kinds need: the angle of a joint that locks, and earlier values, for signals that are late."""

    q: Array  # [n, ...] rad, true angle while all was well
    commands: Past  # N m
    readings: Past  # rad, without a fault


class State(NamedTuple):
    """Last values while all was well, for the kinds that freeze."""

    tau: Array  # [n, ...] N m
    y: Array  # [n, ...] rad
    uncommon: Uncommon | None  # where there are such kinds


class Motion(NamedTuple):
    """How the arm moves, for faults that depend on it."""

    q: ArrayLike  # [n, ...] rad
    qd: ArrayLike  # [n, ...] rad/s
    inertia: ArrayLike  # [n, ...] kg m^2, that a joint moves
    dt: float  # s


def init(tau: Array, y: Array, q: Array, *, uncommon: bool = True) -> State:
    """State of a run that begins with a torque [n, ...] N m, a reading y and an angle q [n, ...] rad.

    ``uncommon`` says whether there can be uncommon kinds.
    """
    return State(tau, y, Uncommon(q, _standing(tau), _standing(y)) if uncommon else None)


def _standing(value: Array) -> Past:
    """A past in which the signal was always ``value`` [n, ...]."""
    return Past(jnp.broadcast_to(value, (LATEST, *value.shape)), jnp.zeros((), jnp.int32))


def deliver(fault: Fault, state: State, t: Array, tau: Array, limit: Array, motion: Motion) -> tuple[State, Array]:
    """Torque [n, ...] N m that reaches the arm for a command tau [n, ...] N m within ``limit`` [n, ...]."""
    there, share, more = present(fault, t), size(fault, t), state.uncommon
    held, q_held, late = jnp.where(there, state.tau, tau), motion.q, tau
    if more is not None:
        q_held = jnp.where(there, more.q, motion.q)
        commands, late = _late(fault.kind == Actuator.DELAY, more.commands, tau, share * fault.magnitude)
        more = more._replace(q=q_held, commands=commands)
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
        jnp.broadcast_to(q_held, tau.shape),
        jnp.broadcast_to(motion.inertia, tau.shape),
        motion.dt,
    )
    delivered = _effect(Actuator, fault, there, torque, tau, more is not None)
    held, more, delivered = store((held, more, delivered))
    return state._replace(tau=held, uncommon=more), delivered


def read(
    fault: Fault, state: State, t: Array, q: Array, noise: Array, resolution: Array | None = None
) -> tuple[State, Array, Array]:
    """(state, reading [n, ...] rad, fault in it [n, ...] rad) for an angle q and encoder noise [n, ...] rad.

    ``resolution`` [...] is the size in rad of the counts in which a reading comes, if it does.
    """
    there, share, more = present(fault, t), size(fault, t), state.uncommon
    clean = late = q + noise
    held = jnp.where(there, state.y, clean)
    if more is not None:
        readings, late = _late(fault.kind == Sensor.DELAY, more.readings, clean, share * fault.magnitude)
        more = more._replace(readings=readings)
    signal = Reading(q, noise, share * fault.magnitude, share, fault.magnitude, t - fault.onset, held, late)
    reading = _effect(Sensor, fault, there, signal, clean, more is not None)
    state, wrong = state._replace(y=held, uncommon=more), jnp.where(jnp.isnan(reading), 0.0, reading - clean)
    return state, reading if resolution is None else in_counts(reading, resolution), wrong


def _late(some: Array, past: Past, now: Array, ticks: Array) -> tuple[Past, Array]:
    """The memory with this tick's signal, and the signal of some ticks ago; ``now`` and ``ticks`` [n, ...].

    Memory is dear in a large batch: it is kept only where one scenario of the batch needs it.
    """
    return lax.cond(jnp.any(some), lambda p, x, d: (p.after(x), p.late(x, d)), lambda p, x, d: (p, x), past, now, ticks)


def _effect(
    kinds: type[Kind], fault: Fault, there: Array, signal: Torque | Reading, healthy: Array, uncommon: bool
) -> Array:
    """The signal [n, ...] with the fault that is there, from the healthy one [n, ...].

    An uncommon kind where there should be none makes it nan, not healthy.
    """
    last = max(kinds) if uncommon else common(kinds)
    healthy = jnp.where(fault.kind > last, jnp.nan, healthy)
    for kind in kinds:
        if 0 < kind <= last:
            healthy = jnp.where(there & (fault.kind == kind), kind.effect(signal), healthy)
    return healthy
