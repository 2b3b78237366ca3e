"""A learned decision with memory: which joints and channels are named once the rule has raised an alarm, block 7.

The rule of Eqs. (17), (18) judges each joint by itself and by this moment. What has been, and what the other joints show,
says more: a torque that comes and goes is no drift, and the largest of three alarms is likelier a fault than the smallest.
A small network looks at that. Its weights are gains, the same for every joint of every arm, so all that it looks at has no
unit: statistics and residuals over their thresholds, the innovation over a jump's size, what the sensor check counts. It
remembers by leaky means and decaying peaks, whose times are in seconds.

* It names. Whether there is an alarm is the rule's, except in the gaps of a fault that comes and goes: once an alarm has
  come back on a joint, what was named stays through gaps that are not much longer than those before, ``LONGEST`` at most.
* The rule's verdict stays where the network names nothing or is unsure of a joint, where something that it looks at lies
  outside of what it was trained on, while a reading is absent, and until it has been asked since the fault began. Of a fault
  that has come back the network knows more than the rule, so there an unsure answer counts as well.
* Where it is unsure of a joint, or does not speak though asked, what is said is a guess, and that is said too: fault, kind
  unknown. It is never taken for normal.
* It looks every ``PERIOD``. It is asked every ``SOONER`` for ``YOUNG``, later less often by ``LATER``; in between its last
  answer stands. The first answers to a fault stand as they are, later ones are averaged: what wavers then is the moment, not
  the fault.

``tuning/decision.py`` trains it. What it says goes to the verdict alone: observer and sensor check hear the rule.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.decision_gains import DecisionGains
from jaxftc.diagnosis import alarm, sensor_check
from jaxftc.diagnosis.statistics import Statistics
from jaxftc.gains import Gains
from jaxftc.numerics import barrier
from jaxftc.numerics.batch import trailing
from jaxftc.types import Array

PERIOD = 0.004  # s between two looks, at least a tick
YOUNG = 0.1  # s after the first alarm in which a fault is young
SOONER, LATER = 0.008, 2  # s between two questions to a young fault, at least a look, and times that to an old one
FAST, MEDIUM, SLOW, PEAK = 0.03, 0.1, 0.3, 0.4  # s, time constants of what is remembered
RETURN = 0.3  # s in which an alarm that comes back on a joint is of the same fault
HELD, LONGEST = 1.5, 0.15  # a fault that comes and goes stays named for so many times its longest gap, and s, at most
EARLY = 0.05  # s after the first alarm in which answers stand as they are
AVERAGED, BACK = 0.4, 0.1  # later ones are averaged over this share of the time since then, and s, at most
SURE = math.log(0.8 / 0.2)  # log odds below which a bit is a guess
ODDS = 6.0  # log odds beyond which all are alike in an average
GROUP = 32  # scenarios asked at a time
SOON = 0.06  # s, at which a time counts half
MOST = 30.0  # of a threshold, or of a jump's size, beyond which all sizes are alike: how far depends on the arm

Answers = tuple[Array, Array, Array]  # [n, ...] Memory.tau, Memory.q, State.speaks
T = TypeVar("T")


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
    """What changes with a question; all [n, ...]."""

    fast: Signals  # leaky means
    slow: Signals
    side: Array  # leaky mean of the torque statistic with its sign
    peak: Peaks
    up: PerAlarm  # 1 where that alarm was up when last asked
    rises: PerAlarm  # how often it rose, leaky
    since: Array  # s since any joint was first in alarm
    own: Array  # s since this one was
    tau: Array  # log odds of an actuator fault, averaged
    q: Array  # of an encoder fault


class State(NamedTuple):
    """All floats."""

    memory: Array  # [rows, n, ...] a Memory in one array: a tick from Python passes one faster than many
    speaks: Array  # [n, ...] 1 where the answer counts, -1 where it does not, 0 without one; the same for all joints
    wait: Array  # [n, ...] ticks until the next question to an old fault; this, age, quiet and gap the same for all joints
    age: Array  # [n, ...] ticks since the first alarm of this fault
    quiet: Array  # [n, ...] ticks since the last one
    gap: Array  # [n, ...] ticks, longest time between two of them
    joints: Array  # [n, ...] 1 where the joint has been in alarm in this fault


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


class Info(NamedTuple):
    """What is said of each joint."""

    verdict: Array  # [n, ...] int32
    unsure: Array  # [n, ...] 1 where that is a guess


def blank(q: Array) -> Memory:
    """Nothing remembered, of angles [n, ...]."""
    zero = jnp.zeros_like(q)
    signals, rises = Signals(*[zero] * len(Signals._fields)), PerAlarm(zero, zero)
    return Memory(signals, signals, zero, Peaks(zero, zero, zero), rises, rises, zero, zero, zero, zero)


def init(config: Config, gains: Gains, q: Array) -> State:
    """Nothing remembered, nothing named."""
    del gains
    zero = jnp.zeros_like(q)
    return State(_packed(blank(q)), zero, zero, zero, quiet=zero + _forgotten(config), gap=zero, joints=zero)


def _packed(memory: Memory) -> Array:
    return barrier.stack(jax.tree.leaves(memory))


def _unpacked(state: State) -> Memory:
    return jax.tree.unflatten(jax.tree.structure(blank(state.wait)), barrier.unstack(state.memory))


@box("Block 7: learned decision")
def step(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, Info]:
    """What is said in this tick. Comparisons: no gradient passes."""
    gains, state, inputs = jax.lax.stop_gradient((gains, state, inputs))
    alarmed = (inputs.verdict > 0).any(0)
    state = _count(config, state, inputs.verdict > 0)
    due = _looks_until(config, state, range(LATER * between(config)))[0].any()
    memory, speaks = jax.lax.cond(due, lambda: _look(config, gains, state, inputs), lambda: (state.memory, state.speaks))
    wait = jnp.where(state.wait <= 0, LATER * between(config) * period(config), state.wait) - 1
    state = state._replace(memory=memory, speaks=speaks, wait=wait)
    tau, q = memory[-2:]  # the last two of Memory
    held = alarmed | (state.quiet[0] <= jnp.minimum(HELD * state.gap[0], LONGEST / config.dt))
    held = held & ~inputs.absent.any(0)
    named = (tau > 0) + 2 * (q > 0)
    verdict = jnp.where(held & (state.speaks > 0), named.astype(inputs.verdict.dtype), inputs.verdict)
    guess = (jnp.minimum(jnp.abs(tau), jnp.abs(q)) < SURE) | (state.speaks < 0) & (verdict > 0)
    unsure = held & (verdict > 0).any(0) & (state.speaks != 0) & guess
    return state, Info(verdict, unsure.astype(tau.dtype))


def _count(config: Config, state: State, joints: Array) -> State:
    """The times of this fault's alarms, of the joints [n, ...] bool that are in alarm.

    ``RETURN`` after its last alarm a fault is forgotten, or sooner if another joint's rises.
    """
    last, alarmed = _forgotten(config), joints.any(0)
    another = alarmed & (state.quiet[0] > 0) & ~(joints & (state.joints > 0)).any(0)
    quiet = jnp.where(alarmed, 0.0, jnp.minimum(state.quiet + 1, last))
    known = (quiet < last) & (state.quiet < last) & ~another
    over = alarmed & (state.quiet >= config.release_ticks)
    gap = jnp.where(over, jnp.maximum(state.gap, state.quiet), state.gap)
    seen = jnp.where(known, state.joints, 0.0)
    return state._replace(
        age=jnp.where(known, state.age + 1, 0.0),
        quiet=quiet,
        gap=jnp.where(known, gap, 0.0),
        speaks=jnp.where(known, state.speaks, 0.0),
        joints=jnp.maximum(seen, joints.astype(seen.dtype)),
    )


def _forgotten(config: Config) -> float:
    """Ticks after its last alarm at which a fault is forgotten."""
    return 1.0 + round(RETURN / config.dt)


def _look(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[Array, Array]:
    """Memory with this moment in it, and where an answer is due with that; and ``State.speaks``.

    The products of the network are most of the cost: it is not asked if no scenario hears the answer.
    """
    memory, now = remember(config, gains, _unpacked(state), inputs)
    soon = _looks_until(config, state, range(0, LATER * between(config), between(config)))
    asked = (state.wait <= 0) | soon & _young(config, state)
    hears, last = (inputs.verdict > 0).any(0) & asked, (memory.tau, memory.q, state.speaks)
    seen_by = gains, state, memory, now, inputs, hears
    ask = lambda: _of_some(hears[0], lambda some: _ask(config, *some), seen_by, last)  # noqa: E731
    tau, q, speaks = jax.lax.cond(hears[0].any(), ask, lambda: last)
    return _packed(memory._replace(tau=tau, q=q)), speaks


def _of_some(which: Array, ask: Callable[[T], Answers], asked: T, otherwise: Answers) -> Answers:
    """What ``ask`` says of some scenarios, [...] bool, and ``otherwise`` of the others.

    Of a long row of scenarios ``GROUP`` are asked at a time: few of them hear an answer in the same tick.
    """
    if which.ndim != 1 or len(which) <= GROUP:
        return ask(asked)
    order = jnp.argsort(~which)  # those first
    place = jnp.argsort(order)

    def group(k: Array, found: Answers) -> Answers:
        some = jax.lax.dynamic_slice(order, [k * GROUP], [GROUP])
        said = ask(jax.tree.map(lambda leaf: leaf[..., some] if leaf.shape[-1] == len(which) else leaf, asked))
        put = functools.partial(jax.lax.dynamic_update_slice_in_dim, start_index=k * GROUP, axis=-1)
        return jax.tree.map(put, found, said)

    found = jax.lax.fori_loop(0, (which.sum() + GROUP - 1) // GROUP, group, otherwise)
    return jax.tree.map(lambda new, old: jnp.where(which, new[..., place], old), found, otherwise)


def _ask(config: Config, gains: Gains, state: State, memory: Memory, now: Signals, inputs: Inputs, hears: Array) -> Answers:
    """``Memory.tau``, ``Memory.q`` and ``State.speaks`` with this moment's answer, where ``hears`` [n, ...] bool."""
    seen = shown(config, gains, memory, now, inputs)
    since = between(config) * period(config) * config.dt * jnp.where(_young(config, state), 1.0, LATER)  # s
    back = jnp.clip(AVERAGED * (config.dt * state.age - EARLY), 1e-3 * PERIOD, BACK)  # s
    old = jnp.stack([memory.tau, memory.q])
    odds = old - jnp.expm1(-since / back)[None] * (jnp.clip(logits(gains.decision, seen), -ODDS, ODDS) - old)
    known = familiar(gains.decision, seen) & ~inputs.absent.any(0)
    sure = (jnp.abs(odds) >= _column(gains.decision.doubt, seen)).all((0, 1)) | (state.gap[0] > 0)
    speaks = known & sure & (odds > 0).any((0, 1))
    tau, q = jnp.where(known & hears, odds, old)
    answer = jnp.where(speaks, 1.0, -1.0).astype(state.speaks.dtype)
    return tau, q, jnp.where(hears, answer, state.speaks)


def _looks_until(config: Config, state: State, looks: range) -> Array:
    """Whether it is one of so many looks until the next question to an old fault, [n, ...] bool."""
    there = [state.wait == k * period(config) for k in looks]  # a remainder would cost more than all the rest
    return functools.reduce(jnp.logical_or, there)


def _young(config: Config, state: State) -> Array:
    """Whether the fault began a short while ago, [n, ...] bool."""
    return state.age < round(YOUNG / config.dt)


def period(config: Config) -> int:
    """Ticks from one look to the next."""
    return max(1, round(PERIOD / config.dt))


def between(config: Config) -> int:
    """Looks from one question to a young fault to the next."""
    return max(1, round(SOONER / (period(config) * config.dt)))


def look(config: Config, gains: Gains, memory: Memory, inputs: Inputs) -> tuple[Memory, Array]:
    """The memory with this moment in it, and what the network is shown, [len(NAMES), n, ...]."""
    memory, now = remember(config, gains, memory, inputs)
    return memory, shown(config, gains, memory, now, inputs)


def remember(config: Config, gains: Gains, memory: Memory, inputs: Inputs) -> tuple[Memory, Signals]:
    """The memory with this moment in it, and this moment."""
    dt, jump = period(config) * config.dt, gains.observer.jump
    signed = inputs.statistics.tau / inputs.threshold_tau
    peak = inputs.check.transient.peak
    now = Signals(
        torque=_size(signed),
        innovation=_size(inputs.e / jump),
        angle=_size(inputs.statistics.q / gains.diagnosis.alpha_q),
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


def shown(config: Config, gains: Gains, memory: Memory, now: Signals, inputs: Inputs) -> Array:
    """What the network is shown of this moment, [len(NAMES), n, ...] in the order of ``NAMES``."""
    check, fast, slow, peaks, jump = inputs.check, memory.fast, memory.slow, memory.peak, gains.observer.jump
    age = check.transient.age * config.dt
    residual = _size(inputs.residual_tau / inputs.threshold_tau)
    alone = [
        residual,
        jnp.minimum(check.jumps.total / sensor_check.MANY_JUMPS, 4.0),
        jnp.minimum(jnp.abs(check.jumps.signed) / sensor_check.MANY_JUMPS, 4.0),
        check.freeze.equal / (check.freeze.equal + sensor_check.FROZEN_READINGS),
        _size(check.freeze.travel / jump),
        jnp.minimum(check.counts.turns / sensor_check.SHARP_TURNS, 2.0),
        _size(check.transient.peak / inputs.threshold_tau),
        age / (age + SOON),
        jnp.abs(memory.side),
        memory.since / (memory.since + SOON),
        memory.own / (memory.own + SOON),
        *memory.rises,
    ]
    others = (now.torque, residual, peaks.torque, peaks.angle, slow.suspect, slow.jumped, fast.innovation)
    largest = barrier.unstack(_largest_other(barrier.stack(others, axis=1)))
    return barrier.store(barrier.stack([*now, *fast, *slow, *peaks, *alone, *largest]))  # XLA would multiply row by row


NAMES = (  # of what the network is shown
    *(f"{kind} {name}" for kind in ("now", "fast", "slow") for name in Signals._fields),
    *(f"peak {name}" for name in Peaks._fields),
    *("residual", "jumps", "jumps one way", "equal readings", "travel", "turns", "alarm's peak", "alarm's age", "side"),
    *("since any alarm", "since own alarm", "rises of torque", "rises of angle"),
    *(f"others' {name}" for name in ("torque", "residual", "peak torque", "peak angle", "suspect", "jumped", "innovation")),
)


def logits(weights: DecisionGains, seen: Array) -> Array:
    """Log odds [2, n, ...] of an actuator and of an encoder fault, of what is shown [len(NAMES), n, ...]."""
    first = weights.first / weights.width[:, None]  # that of what is centred and scaled, without doing that to all numbers
    first_bias = weights.first_bias - jnp.einsum("k...,kh...->h...", weights.centre, first, precision="highest")
    x = seen
    for matrix, bias in ((first, first_bias), (weights.second, weights.second_bias)):
        x = jnp.maximum(_times(matrix, x) + _column(bias, seen), 0.0)
    return _times(weights.last, x) + _column(weights.last_bias, seen)


def familiar(weights: DecisionGains, seen: Array) -> Array:
    """Whether all that is shown [len(NAMES), n, ...] lies within what the network was trained on, [...] bool."""
    low, high = (_column(bound, seen) for bound in (weights.low, weights.high))
    return ((seen >= low) & (seen <= high)).all((0, 1))


def _size(x: Array) -> Array:
    return jnp.log1p(jnp.minimum(jnp.abs(x), MOST))


def _leaky(old: Array, x: Array, ticks: float) -> Array:
    """Leaky mean after a time, in its time constants."""
    return old - math.expm1(-ticks) * (x - old)


def _largest_other(x: Array) -> Array:
    """The largest of the other joints' [n, k, ...], turned over: [k, n, ...]; 0 for an arm of one joint."""
    if len(x) == 1:
        return jnp.zeros_like(x.swapaxes(0, 1))
    best = x.max(0, keepdims=True)
    is_best = x >= best
    second = jnp.where(is_best, -jnp.inf, x).max(0, keepdims=True)
    several = is_best.sum(0, keepdims=True) > 1
    return jnp.where(is_best & ~several, second, best).swapaxes(0, 1)


def _column(x: Array, like: Array) -> Array:
    """Numbers [k, ...] for each joint of [k, n, ...]."""
    return trailing(x, 1, like.ndim - 2)[:, None]


def _times(matrix: Array, x: Array) -> Array:
    """[k, h, ...] turned over, times [k, n, ...]: [h, n, ...]."""
    return jnp.einsum("kh...,kn...->hn...", matrix, x, precision="highest")
