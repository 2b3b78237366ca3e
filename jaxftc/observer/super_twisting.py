"""Sliding-mode extended-state stage, Eq. (7), block 3: super-twisting on the innovation."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.numerics import smooth
from jaxftc.observer.stage import Inputs
from jaxftc.stages import either
from jaxftc.types import Array

GAINS = ("observer.alpha_sm", "observer.alpha_sm0", "observer.eps")


class State(NamedTuple):
    """The super-twisting integral; of the printed form, which has none, psi_SM of the coming tick."""

    gamma: Array  # [n, ...] rad/s^2


def init(config: Config, gains: Gains, q: Array) -> State:
    """No fault."""
    del config, gains
    return State(jnp.zeros_like(q))


@box("Block 3: super-twisting, Eq. (7)")
def step(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, Array]:
    """psi_SM of this tick [n, ...] rad/s^2, in the form that runs; 0 if none does."""
    runs = either(inputs.on.printed, printed(config, gains, state, inputs), corrected(config, gains, state, inputs))
    return either(inputs.on.sliding, runs, (state, jnp.zeros_like(inputs.e)))


def corrected(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, Array]:
    """psi_SM of this tick [n, ...] rad/s^2.

    psi_SM = alpha_SM |e|^1/2 sgn(e) (1 - h_s) + gamma, gamma+ = gamma + T alpha_SM0 sgn(e). Eq. (7) prints gamma as
    -alpha_SM0 sgn(e) itself, which is a relay. The finite-time proof of the super-twisting algorithm needs relative degree
    one, which an angle driven by an acceleration does not have: no such claim is made here.
    """
    e, h_s = inputs.e, inputs.h_s
    sgn = smooth.sign(e, gains.observer.eps, hard=config.sign == "hard")
    psi = gains.observer.alpha_sm * smooth.magnitude_root(e) * sgn * (1 - h_s) + state.gamma  # Eq. (7), corrected
    return State(state.gamma + config.dt * gains.observer.alpha_sm0 * sgn), psi


def printed(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, Array]:
    """psi_SM [n, ...] rad/s^2 as Eq. (7) prints it, for comparison; alpha_SM0 counts in rad/s^2 here, h_s nowhere.

    psi_SM+ = alpha_SM |e|^1/2 sgn(e) - gamma, gamma = -alpha_SM0 sgn(e): a relay, and a tick late.
    """
    sgn = smooth.sign(inputs.e, gains.observer.eps, hard=config.sign == "hard")
    gamma = -gains.observer.alpha_sm0 * sgn
    return State(gains.observer.alpha_sm * smooth.magnitude_root(inputs.e) * sgn - gamma), state.gamma  # Eq. (7), as printed
