"""What the learned decision remembers of each joint: leaky means and decaying peaks of signals without a unit, block 7."""

from __future__ import annotations

import math
from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.config import Config
from jaxftc.diagnosis import alarm, sensor_check
from jaxftc.diagnosis.statistics import Statistics
from jaxftc.gains import Gains
from jaxftc.types import Array

PERIOD = 0.004  # s between two looks, at least a tick
FAST, MEDIUM, SLOW, PEAK = 0.03, 0.1, 0.3, 0.4  # s, time constants of what is remembered
MOST = 30.0  # of a threshold, or of a jump's size, beyond which all sizes are alike: how far depends on the arm


class Signals(NamedTuple):
    """What is remembered of a joint; all [n, ...], 1. Sizes are log(1 + x), x at most MOST."""

    torque: Array  # statistic of the torque channel over its threshold
    innovation: Array  # innovation over observer.jump
    angle: Array  # statistic of the encoder channel over its threshold
    jumped: Array  # 1 while the encoder alarm is up
    suspect: Array  # 1 while the sensor check holds the reading to be wrong
    alarmed: Array  # 1 while the torque alarm is up
    fallen: Array  # torque residual over its peak in this alarm, at most 1


class Peaks(NamedTuple):
    """Decaying peaks; all [n, ...]."""

    torque: Array
    innovation: Array
    angle: Array


class PerAlarm(NamedTuple):
    """A number for each of the two alarms of a joint; all [n, ...]."""

    torque: Array
    angle: Array


class Memory(NamedTuple):
    """What changes with a look, the log odds with an answer; all [n, ...]."""

    fast: Signals  # leaky means
    slow: Signals
    side: Array  # leaky mean of the torque statistic with its sign
    peak: Peaks
    up: PerAlarm  # 1 where that alarm was up at the last look
    rises: PerAlarm  # how often it rose, leaky
    since: Array  # s since any joint was first in alarm
    own: Array  # s since this one was
    tau: Array  # log odds of an actuator fault, averaged
    q: Array  # of an encoder fault


class Inputs(NamedTuple):
    """What a tick takes in."""

    statistics: Statistics
    threshold_tau: Array  # [n, ...] N m, of this tick
    residual_tau: Array  # [n, ...] N m, of all joints, whatever their readings
    e: Array  # [n, ...] rad, innovation
    absent: Array  # [n, ...] bool, there is no reading
    alarm: alarm.State
    check: sensor_check.State
    suspect: Array  # [n, ...] 1 where the reading is held to be wrong
    verdict: Array  # [n, ...] int32, the rule's


def blank(q: Array) -> Memory:
    """Nothing remembered, of angles [n, ...]."""
    zero = jnp.zeros_like(q)
    signals, rises = Signals(*[zero] * len(Signals._fields)), PerAlarm(zero, zero)
    return Memory(signals, signals, zero, Peaks(zero, zero, zero), rises, rises, zero, zero, zero, zero)


def period(config: Config) -> int:
    """Ticks from one look to the next."""
    return max(1, round(PERIOD / config.dt))


def remember(config: Config, gains: Gains, memory: Memory, inputs: Inputs) -> tuple[Memory, Signals]:
    """The memory with this moment in it, and this moment."""
    dt, jump = period(config) * config.dt, gains.observer.jump
    signed = inputs.statistics.tau / inputs.threshold_tau
    peak = inputs.check.transient.peak
    now = Signals(
        torque=size(signed),
        innovation=size(inputs.e / jump),
        angle=size(inputs.statistics.q / gains.diagnosis.alpha_q),
        jumped=inputs.alarm.q,
        suspect=inputs.suspect,
        alarmed=inputs.alarm.tau,
        fallen=jnp.where(peak > 0, jnp.minimum(jnp.abs(inputs.residual_tau) / jnp.where(peak > 0, peak, 1.0), 1.0), 0.0),
    )
    fast, slow = (Signals(*(_leaky(old, x, dt / t) for old, x in zip(means, now, strict=True))) for means, t in (
        (memory.fast, FAST), (memory.slow, SLOW)))  # fmt: skip
    decay = math.exp(-dt / PEAK)
    peaks = Peaks(*(jnp.maximum(getattr(now, name), decay * getattr(memory.peak, name)) for name in Peaks._fields))
    side = _leaky(memory.side, jnp.sign(signed) * now.torque, dt / MEDIUM)
    up = PerAlarm(now.alarmed, jnp.maximum(now.jumped, now.suspect))
    rises = PerAlarm(
        *(
            math.exp(-dt / SLOW) * n + jnp.maximum(x - old, 0.0)
            for n, x, old in zip(memory.rises, up, memory.up, strict=True)
        )
    )
    own = now.jumped + now.suspect + now.alarmed > 0
    memory = memory._replace(
        fast=fast,
        slow=slow,
        side=side,
        peak=peaks,
        up=up,
        rises=rises,
        since=jnp.where(own.any(0), memory.since + dt, jnp.zeros_like(memory.since)),
        own=jnp.where(own, memory.own + dt, 0.0),
    )
    return memory, now


def size(x: Array) -> Array:
    """Of a number over what it is compared with: log(1 + x), alike beyond ``MOST``."""
    return jnp.log1p(jnp.minimum(jnp.abs(x), MOST))


def _leaky(old: Array, x: Array, ticks: float) -> Array:
    """Leaky mean after a time, in its time constants."""
    return old - math.expm1(-ticks) * (x - old)
