"""Alarms of both channels, Eq. (17) with |S|: two levels and a debounce, one after the other for each joint.

An alarm rises when |S| stays at its threshold for ``config.alarm_ticks`` (at once on the encoder channel, where a jump
decides) and ends when it stays below ``RELEASE`` of it for ``config.release_ticks``.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.diagnosis.statistics import Statistics
from jaxftc.gains import Gains
from jaxftc.types import Array

RELEASE = 0.7  # share of the threshold below which an alarm ends


class State(NamedTuple):
    """Both alarms and their debounce counters; floats, so that they mix with the signals."""

    tau: Array  # [n, ...] 1 while the torque alarm is up, else 0
    tau_run: Array  # [n, ...] ticks in a row that speak against its present state
    q: Array  # [n, ...] 1 while the encoder alarm is up, else 0
    q_run: Array  # [n, ...]


class Alarms(NamedTuple):
    """Which are up."""

    tau: Array  # [n, ...] bool
    q: Array  # [n, ...] bool


class Inputs(NamedTuple):
    """What a tick takes in."""

    statistics: Statistics
    threshold_tau: Array  # [n, ...] N m, of this tick


def init(config: Config, gains: Gains, q: Array) -> State:
    """No alarm."""
    del config, gains
    return State(*[jnp.zeros_like(q)] * 4)


@box("Block 7: alarms, Eq. (17)")
def step(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, Alarms]:
    """Alarms from the statistics. Comparisons: no gradient passes."""
    alpha_q, state, (s, alpha_tau) = jax.lax.stop_gradient((gains.diagnosis.alpha_q, state, inputs))
    tau, tau_run = debounce(s.tau, alpha_tau, state.tau, state.tau_run, config.alarm_ticks, config.release_ticks)
    q, q_run = debounce(s.q, alpha_q, state.q, state.q_run, 1, config.release_ticks)
    return State(tau, tau_run, q, q_run), Alarms(tau > 0, q > 0)


def debounce(s: Array, alpha: Array, on: Array, run: Array, rise: int, fall: int) -> tuple[Array, Array]:
    """Two-level switch with persistence: (alarm, counter), Eq. (17) with |S|."""
    against = jnp.where(on > 0, jnp.abs(s) < RELEASE * alpha, jnp.abs(s) >= alpha)
    run = jnp.where(against, run + 1, 0.0)
    flips = run >= jnp.where(on > 0, fall, rise)
    return jnp.where(flips, 1 - on, on), jnp.where(flips, 0.0, run)
