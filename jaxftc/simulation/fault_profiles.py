"""Laws in time: abrupt, incipient (ramp), intermittent; cleared or permanent."""

from __future__ import annotations

import jax.numpy as jnp

from jaxftc.scenarios.contact import Contact
from jaxftc.scenarios.faults import Fault
from jaxftc.types import Array


def present(fault: Fault | Contact, t: Array) -> Array:
    """Whether the fault is there at t s, [n, ...] bool; onset and clearance included."""
    since = t - fault.onset
    cycles = since / fault.period  # 0 for an infinite period
    return (since >= 0) & (t <= fault.clear) & (cycles - jnp.floor(cycles) <= fault.duty)


def size(fault: Fault | Contact, t: Array) -> Array:
    """Share of its full size that the fault has at t s, [n, ...] in 0..1."""
    abrupt = fault.rise <= 0
    ramp = jnp.clip((t - fault.onset) / jnp.where(abrupt, 1.0, fault.rise), 0.0, 1.0)
    return jnp.where(present(fault, t), jnp.where(abrupt, 1.0, ramp), 0.0)
