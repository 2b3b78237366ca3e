"""PI stage, Eq. (6), block 2: the integral of the innovation is the first estimate of the actuator fault."""

from __future__ import annotations

from typing import NamedTuple

from jaxftc.gains import ObserverGains
from jaxftc.types import Array


class State(NamedTuple):
    """psi_PI."""

    psi: Array  # [n, ...] rad/s^2


def step(gains: ObserverGains, state: State, e: Array) -> tuple[State, Array]:
    """psi_PI of this tick [n, ...] rad/s^2, and its state for the next; e [n, ...] rad is the innovation.

    psi_PI+ = psi_PI + alpha_i e. Eq. (6) prints the total Psi on the right, which would integrate the other stages twice.
    """
    return State(state.psi + gains.alpha_i * e), state.psi  # Eq. (6)
