"""The network of the learned decision: what it is shown of every joint, and its log odds, block 7."""

from __future__ import annotations

import jax.numpy as jnp

from jaxftc.config import Config
from jaxftc.decision_gains import DecisionGains
from jaxftc.diagnosis import sensor_check
from jaxftc.diagnosis.decision_memory import Inputs, Memory, Peaks, Signals, size
from jaxftc.gains import Gains
from jaxftc.numerics import barrier
from jaxftc.numerics.batch import trailing
from jaxftc.types import Array

SOON = 0.06  # s, at which a time counts half

NAMES = (  # of what the network is shown
    *(f"{kind} {name}" for kind in ("now", "fast", "slow") for name in Signals._fields),
    *(f"peak {name}" for name in Peaks._fields),
    *("residual", "jumps", "jumps one way", "equal readings", "travel", "turns", "alarm's peak", "alarm's age", "side"),
    *("since any alarm", "since own alarm", "rises of torque", "rises of angle"),
    *(f"others' {name}" for name in ("torque", "residual", "peak torque", "peak angle", "suspect", "jumped", "innovation")),
)


def shown(config: Config, gains: Gains, memory: Memory, now: Signals, inputs: Inputs) -> Array:
    """What the network is shown of this moment, [len(NAMES), n, ...] in the order of ``NAMES``."""
    check, fast, slow, peaks, jump = inputs.check, memory.fast, memory.slow, memory.peak, gains.observer.jump
    age = check.transient.age * config.dt
    equal = check.freeze.equal / (check.freeze.equal + sensor_check.FROZEN_READINGS)
    moved = jnp.minimum(check.freeze.travel / jump, 1.0)  # equal readings of a joint that stands still say nothing
    residual = size(inputs.residual_tau / inputs.threshold_tau)
    alone = [
        residual,
        jnp.minimum(check.jumps.total / sensor_check.MANY_JUMPS, 4.0),
        jnp.minimum(jnp.abs(check.jumps.signed) / sensor_check.MANY_JUMPS, 4.0),
        moved * equal,
        size(check.freeze.travel / jump),
        jnp.minimum(check.counts.turns / sensor_check.SHARP_TURNS, 2.0),
        size(check.transient.peak / inputs.threshold_tau),
        age / (age + SOON),
        jnp.abs(memory.side),
        memory.since / (memory.since + SOON),
        memory.own / (memory.own + SOON),
        *memory.rises,
    ]
    others = (now.torque, residual, peaks.torque, peaks.angle, slow.suspect, slow.jumped, fast.innovation)
    largest = barrier.unstack(_largest_other(barrier.stack(others, axis=1)))
    return barrier.store(barrier.stack([*now, *fast, *slow, *peaks, *alone, *largest]))  # XLA would multiply row by row


def logits(weights: DecisionGains, seen: Array) -> Array:
    """Log odds [2, n, ...] of an actuator and of an encoder fault, of what is shown [len(NAMES), n, ...]."""
    first = weights.first / weights.width[:, None]  # that of what is centred and scaled, without doing that to all numbers
    first_bias = weights.first_bias - jnp.einsum("k...,kh...->h...", weights.centre, first, precision="highest")
    x = seen
    for matrix, bias in ((first, first_bias), (weights.second, weights.second_bias)):
        x = jnp.maximum(_times(matrix, x) + column(bias, seen), 0.0)
    return _times(weights.last, x) + column(weights.last_bias, seen)


def familiar(weights: DecisionGains, seen: Array) -> Array:
    """Whether all that is shown [len(NAMES), n, ...] lies within what the network was trained on, [...] bool."""
    low, high = (column(bound, seen) for bound in (weights.low, weights.high))
    return ((seen >= low) & (seen <= high)).all((0, 1))


def _largest_other(x: Array) -> Array:
    """The largest of the other joints' [n, k, ...], turned over: [k, n, ...]; 0 for an arm of one joint."""
    if len(x) == 1:
        return jnp.zeros_like(x.swapaxes(0, 1))
    best = x.max(0, keepdims=True)
    is_best = x >= best
    second = jnp.where(is_best, -jnp.inf, x).max(0, keepdims=True)
    several = is_best.sum(0, keepdims=True) > 1
    return jnp.where(is_best & ~several, second, best).swapaxes(0, 1)


def column(x: Array, like: Array) -> Array:
    """Numbers [k, ...] for each joint of [k, n, ...]."""
    return trailing(x, 1, like.ndim - 2)[:, None]


def _times(matrix: Array, x: Array) -> Array:
    """[k, h, ...] turned over, times [k, n, ...]: [h, n, ...]."""
    return jnp.einsum("kh...,kn...->hn...", matrix, x, precision="highest")
