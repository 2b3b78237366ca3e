"""A learned decision with memory: which joints and channels are named once the rule has raised an alarm, block 7.

The rule of Eqs. (17), (18) judges each joint by itself and by this moment. What has been, and what the other joints show,
says more: a torque that comes and goes is no drift, and the largest of three alarms is likelier a fault than the smallest.
A small network looks at that. Its weights are gains, the same for every joint of every arm, so all that it looks at has no
unit: statistics and residuals over their thresholds, the innovation over a jump's size, what the sensor check counts.
``decision_memory`` is what is remembered of them, ``decision_network`` what it says of that; here is when it is asked.

* It names. Whether there is an alarm is the rule's, except in the gaps of a fault that comes and goes: once an alarm has
  come back on a joint, what was named stays through gaps that are not much longer than those before, ``LONGEST`` at most.
* The rule's verdict stays where the network names nothing or is unsure of a joint, where something that it looks at lies
  outside of what it was trained on, while a reading is absent, and until it has been asked since the fault began. Of a fault
  that has come back the network knows more than the rule, so there an unsure answer counts as well.
* Where it is unsure of a joint, or does not speak though asked, what is said is a guess, and that is said too: fault, kind
  unknown. It is never taken for normal.
* It looks every ``decision_memory.PERIOD``. It is asked every ``SOONER`` for ``YOUNG``, later less often by ``LATER``; in
  between its last answer stands. The first answers to a fault stand as they are, later ones are averaged: what wavers then
  is the moment, not the fault.

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
from jaxftc.diagnosis import decision_memory, decision_network
from jaxftc.diagnosis.decision_memory import Inputs, Memory, Signals
from jaxftc.gains import Gains
from jaxftc.numerics import barrier
from jaxftc.types import Array

YOUNG = 0.1  # s after the first alarm in which a fault is young
SOONER, LATER = 0.008, 2  # s between two questions to a young fault, at least a look, and times that to an old one
RETURN = 0.3  # s in which an alarm that comes back on a joint is of the same fault
HELD, LONGEST = 1.5, 0.15  # a fault that comes and goes stays named for so many times its longest gap, and s, at most
EARLY = 0.05  # s after the first alarm in which answers stand as they are
AVERAGED, BACK = 0.4, 0.1  # later ones are averaged over this share of the time since then, and s, at most
SURE = math.log(0.8 / 0.2)  # log odds below which a bit is a guess
ODDS = 6.0  # log odds beyond which all are alike in an average
GROUP = 32  # scenarios asked at a time

Answers = tuple[Array, Array, Array]  # [n, ...] Memory.tau, Memory.q, State.speaks
T = TypeVar("T")


class State(NamedTuple):
    """All floats."""

    memory: Array  # [rows, n, ...] a Memory in one array: a tick from Python passes one faster than many
    speaks: Array  # [n, ...] 1 where the answer counts, -1 where it does not, 0 without one; the same for all joints
    wait: Array  # [n, ...] ticks until the next question to an old fault; this, age, quiet and gap the same for all joints
    age: Array  # [n, ...] ticks since the first alarm of this fault
    quiet: Array  # [n, ...] ticks since the last one
    gap: Array  # [n, ...] ticks, longest time between two of them
    joints: Array  # [n, ...] 1 where the joint has been in alarm in this fault


class Info(NamedTuple):
    """What is said of each joint."""

    verdict: Array  # [n, ...] int32
    unsure: Array  # [n, ...] 1 where that is a guess


def init(config: Config, gains: Gains, q: Array) -> State:
    """Nothing remembered, nothing named."""
    del gains
    zero = jnp.zeros_like(q)
    return State(_packed(decision_memory.blank(q)), zero, zero, zero, quiet=zero + _forgotten(config), gap=zero, joints=zero)


def _packed(memory: Memory) -> Array:
    return barrier.stack(jax.tree.leaves(memory))


def _unpacked(state: State) -> Memory:
    return jax.tree.unflatten(jax.tree.structure(decision_memory.blank(state.wait)), barrier.unstack(state.memory))


@box("Block 7: learned decision")
def step(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, Info]:
    """What is said in this tick. Comparisons: no gradient passes."""
    gains, state, inputs = jax.lax.stop_gradient((gains, state, inputs))
    alarmed = (inputs.verdict > 0).any(0)
    state = _count(config, state, inputs.verdict > 0)
    due = _looks_until(config, state, range(LATER * between(config)))[0].any()
    memory, speaks = jax.lax.cond(due, lambda: _look(config, gains, state, inputs), lambda: (state.memory, state.speaks))
    wait = jnp.where(state.wait <= 0, LATER * between(config) * decision_memory.period(config), state.wait) - 1
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
    memory, now = decision_memory.remember(config, gains, _unpacked(state), inputs)
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
    weights, seen = gains.decision, decision_network.shown(config, gains, memory, now, inputs)
    since = between(config) * decision_memory.period(config) * config.dt * jnp.where(_young(config, state), 1.0, LATER)  # s
    back = jnp.clip(AVERAGED * (config.dt * state.age - EARLY), 1e-3 * decision_memory.PERIOD, BACK)  # s
    old = jnp.stack([memory.tau, memory.q])
    odds = old - jnp.expm1(-since / back)[None] * (jnp.clip(decision_network.logits(weights, seen), -ODDS, ODDS) - old)
    known = decision_network.familiar(weights, seen) & ~inputs.absent.any(0)
    sure = (jnp.abs(odds) >= decision_network.column(weights.doubt, seen)).all((0, 1)) | (state.gap[0] > 0)
    speaks = known & sure & (odds > 0).any((0, 1))
    tau, q = jnp.where(known & hears, odds, old)
    answer = jnp.where(speaks, 1.0, -1.0).astype(state.speaks.dtype)
    return tau, q, jnp.where(hears, answer, state.speaks)


def _looks_until(config: Config, state: State, looks: range) -> Array:
    """Whether it is one of so many looks until the next question to an old fault, [n, ...] bool."""
    period = decision_memory.period(config)
    there = [state.wait == k * period for k in looks]  # a remainder would cost more than all the rest
    return functools.reduce(jnp.logical_or, there)


def _young(config: Config, state: State) -> Array:
    """Whether the fault began a short while ago, [n, ...] bool."""
    return state.age < round(YOUNG / config.dt)


def between(config: Config) -> int:
    """Looks from one question to a young fault to the next."""
    return max(1, round(SOONER / (decision_memory.period(config) * config.dt)))
