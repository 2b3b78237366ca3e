"""Kinds of fault and the layout of one channel's faults. A new kind is a new number, never a new signature."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.types import Array


class Actuator(IntEnum):
    """What can happen to a torque; the comment is the unit of ``magnitude``."""

    NONE = 0
    BIAS = 1  # N m, added
    LOSS = 2  # 1, lost share of the command
    STUCK = 3  # none: the torque stays what it was at onset
    SATURATION = 4  # 1, share of the torque limit that is left


class Sensor(IntEnum):
    """What can happen to an encoder; the comment is the unit of ``magnitude``."""

    NONE = 0
    BIAS = 1  # rad, added
    DRIFT = 2  # rad/s, grows from onset
    SCALE = 3  # 1, share of the angle added
    FREEZE = 4  # none: the reading stays what it was at onset
    NOISE = 5  # 1, factor on the encoder's noise
    DROPOUT = 6  # none: no reading (NaN)


class Fault(NamedTuple):
    """One fault per joint of one channel, and its law in time."""

    kind: Array  # [n, ...] int32, Actuator or Sensor
    magnitude: Array  # [n, ...] in the kind's unit
    onset: Array  # [n, ...] s
    clear: Array  # [n, ...] s, infinite if it stays
    rise: Array  # [n, ...] s, ramp from 0 to full size; 0 is abrupt
    period: Array  # [n, ...] s, of an intermittent fault; infinite if it is not
    duty: Array  # [n, ...] 1, share of the period in which it is there


def no_fault(n: int) -> Fault:
    """A healthy channel of n joints."""
    zero, always = jnp.zeros(n), jnp.ones(n)
    return Fault(jnp.zeros(n, jnp.int32), zero, zero, always * jnp.inf, zero, always * jnp.inf, always)
