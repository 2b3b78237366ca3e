"""A scheme whose commands reach the arm some ticks later: a bus, or a drive with a filter."""

import dataclasses
from typing import Any, NamedTuple

import jax.numpy as jnp
import pd_gravity

from jaxftc.types import Array


class State(NamedTuple):
    """The scheme's own, and the commands under way."""

    inner: Any
    waiting: Array  # [ticks, n, ...] N m, the oldest first
    q = property(lambda self: self.inner.q)
    unread = property(lambda self: self.inner.unread)
    tau = property(lambda self: self.waiting[0])


@dataclasses.dataclass(frozen=True)
class Delayed:
    """Another scheme, its commands delayed by at least one tick."""

    inner: Any
    ticks: int
    State = State
    GAINS = property(lambda self: self.inner.GAINS)
    DIAGNOSES = property(lambda self: self.inner.DIAGNOSES)

    def gains_used(self, config):
        """Names of the gains that the scheme reads."""
        return self.inner.gains_used(config)

    def init(self, config, gains, q):
        """The command that holds the arm is under way."""
        inner = self.inner.init(config, gains, q)
        return State(inner, jnp.broadcast_to(inner.tau, (self.ticks, *q.shape)))

    def step(self, config, gains, state, reference, measurement):
        """One tick: the command of now waits, the oldest one comes."""
        inner, said = self.inner.step(config, gains, state.inner, reference, measurement)
        waiting = jnp.concatenate([state.waiting, said.tau[None]])
        return State(inner, waiting[1:]), said._replace(tau=waiting[0])


pd_1, pd_2, pd_3 = (Delayed(pd_gravity, ticks) for ticks in (1, 2, 3))
