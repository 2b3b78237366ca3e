"""What a fault does to the torque that reaches the arm and to the reading that reaches the controller.

Every kind is computed and the one that is there is selected, so that kinds are data. The first-order jump at onset has no
gradient with respect to onset; all magnitudes have one.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.numerics.barrier import store
from jaxftc.scenarios.faults import Actuator, Fault, Kind, Reading, Sensor, Torque
from jaxftc.simulation.fault_profiles import present, size
from jaxftc.types import Array


class State(NamedTuple):
    """Last values while all was well, for the kinds that freeze."""

    tau: Array  # [n, ...] N m
    y: Array  # [n, ...] rad


def deliver(fault: Fault, state: State, t: Array, tau: Array, limit: Array) -> tuple[State, Array]:
    """Torque [n, ...] N m that reaches the arm for a command tau [n, ...] N m within ``limit`` [n, ...]."""
    there, share = present(fault, t), size(fault, t)
    held = jnp.where(there, state.tau, tau)
    torque = Torque(tau, share * fault.magnitude, share, fault.magnitude, held, limit)
    delivered = _effect(Actuator, fault, there, torque, tau)
    held, delivered = store((held, delivered))
    return state._replace(tau=held), delivered


def read(fault: Fault, state: State, t: Array, q: Array, noise: Array) -> tuple[State, Array, Array]:
    """(state, reading [n, ...] rad, fault in it [n, ...] rad) for an angle q and encoder noise [n, ...] rad."""
    there, share = present(fault, t), size(fault, t)
    clean = q + noise
    held = jnp.where(there, state.y, clean)
    signal = Reading(q, noise, share * fault.magnitude, share, fault.magnitude, t - fault.onset, held)
    reading = _effect(Sensor, fault, there, signal, clean)
    return state._replace(y=held), reading, jnp.where(jnp.isnan(reading), 0.0, reading - clean)


def _effect(kinds: type[Kind], fault: Fault, there: Array, signal: Torque | Reading, healthy: Array) -> Array:
    """The signal with the fault that is there."""
    for kind in kinds:
        if kind:
            healthy = jnp.where(there & (fault.kind == kind), kind.effect(signal), healthy)
    return healthy
