"""What the control law takes out of the motion as the actuator fault: psi, and what psi has yet to take up.

psi serves the diagnosis too, and is slow so that a healthy arm stays calm. The innovation e already holds the rest of the
fault: w e with w = alpha_p (1 - xi)^2 / T^2 (theory.md, "The bandwidth of the compensation"). A low-pass of it, with a rate
of its own, is compensated beside psi:

    psi_c = psi + l,   l+ = l + (1 - exp(-rate T)) (w e - l),   |l| <= MOST.

The observer does not see l, because the command that holds it is known: its poles stay where they are. At rate 0 psi is
compensated alone.

A motor that does not do what it is told, such as a stuck one, winds any compensation up: what was commanded meanwhile comes
all at once when the fault clears. psi is slow to do so. The bound keeps l from it, and from an arm whose inertia is far off.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.numerics import smooth
from jaxftc.types import Array

GAINS = ("control.rate",)
MOST = 10.0  # rad/s^2, as much as the switching term may add by default


class State(NamedTuple):
    """l."""

    ahead: Array  # [n, ...] rad/s^2


class Inputs(NamedTuple):
    """What a tick takes in."""

    psi: Array  # [n, ...] rad/s^2, fault estimate
    left: Array  # [n, ...] rad/s^2, w e: what psi has yet to take up


def init(config: Config, gains: Gains, q: Array) -> State:
    """Nothing but psi."""
    del config, gains
    return State(jnp.zeros_like(q))


@box("Compensation: psi and what it has yet to take up")
def step(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, Array]:
    """psi_c [n, ...] rad/s^2 of this tick; stable at any rate and sample time."""
    share = -jnp.expm1(-gains.control.rate * config.dt)
    ahead = smooth.saturate(state.ahead + share * (inputs.left - state.ahead), MOST)
    return State(ahead), inputs.psi + ahead
