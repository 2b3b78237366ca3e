"""PI stage, Eq. (6), block 2: the integral of the innovation is the first estimate of the actuator fault."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.observer.stage import Inputs
from jaxftc.types import Array


class State(NamedTuple):
    """psi_PI."""

    psi: Array  # [n, ...] rad/s^2


def init(config: Config, gains: Gains, q: Array) -> State:
    """No fault."""
    del config, gains
    return State(jnp.zeros_like(q))


@box("Block 2: PI, Eq. (6)")
def step(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, Array]:
    """psi_PI of this tick [n, ...] rad/s^2, and its state for the next.

    psi_PI+ = psi_PI + alpha_i e. Eq. (6) prints the total Psi on the right, which would integrate the other stages twice.
    """
    del config
    return State(state.psi + gains.observer.alpha_i * inputs.e), state.psi  # Eq. (6)
