"""What a fault does to the torque that reaches the arm and to the reading that reaches the controller.

Every kind is computed and the one that is there is selected, so that kinds are data. The first-order jump at onset has no
gradient with respect to onset; all magnitudes have one.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.numerics.barrier import store
from jaxftc.scenarios.faults import Actuator, Fault, Sensor
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
    left = jnp.where(jnp.isfinite(limit), limit, 0.0) * (1 - share * (1 - fault.magnitude))
    delivered = tau
    for kind, value in (
        (Actuator.BIAS, tau + share * fault.magnitude),
        (Actuator.LOSS, tau * (1 - share * fault.magnitude)),
        (Actuator.STUCK, held),
        (Actuator.SATURATION, jnp.where(jnp.isfinite(limit), jnp.clip(tau, -left, left), tau)),
    ):
        delivered = jnp.where(there & (fault.kind == kind), value, delivered)
    held, delivered = store((held, delivered))
    return state._replace(tau=held), delivered


def read(fault: Fault, state: State, t: Array, q: Array, noise: Array) -> tuple[State, Array, Array]:
    """(state, reading [n, ...] rad, fault in it [n, ...] rad) for an angle q and encoder noise [n, ...] rad."""
    there, share = present(fault, t), size(fault, t)
    clean = q + noise
    held = jnp.where(there, state.y, clean)
    reading = clean
    for kind, value in (
        (Sensor.BIAS, clean + share * fault.magnitude),
        (Sensor.DRIFT, clean + share * fault.magnitude * (t - fault.onset)),
        (Sensor.SCALE, clean + share * fault.magnitude * q),
        (Sensor.FREEZE, held),
        (Sensor.NOISE, q + noise * (1 + share * (fault.magnitude - 1))),
    ):
        reading = jnp.where(there & (fault.kind == kind), value, reading)
    dropped = there & (fault.kind == Sensor.DROPOUT)
    return state._replace(y=held), jnp.where(dropped, jnp.nan, reading), reading - clean
