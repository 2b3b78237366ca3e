"""The cascade: one innovation, up to three stages, two fault estimates, Eqs. (6) to (10), (13), (15), (16).

psi, the actuator fault, is an acceleration that enters the ARX model through its input column; b, the encoder fault, is
taken off the reading. ``config.observer`` says how many stages run.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc import arx
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.observer import adaptive, pi, super_twisting
from jaxftc.types import Array


class State(NamedTuple):
    """Model, stages and the last innovation."""

    arx: arx.State
    pi: pi.State
    sliding: super_twisting.State
    adaptive: adaptive.State
    e: Array  # [n, ...] rad, innovation of the last tick, its jump taken out
    held: Array  # [n, ...] 1 where the last reading was missing, else 0


class Innovation(NamedTuple):
    """First half of a tick: what the reading says before the fault is explained."""

    y: Array  # [n, ...] rad, reading, predicted where it was missing
    y_hat: Array  # [n, ...] rad, model
    e: Array  # [n, ...] rad, innovation, its jump taken out
    jump: adaptive.Jump
    b: Array  # [n, ...] rad, encoder fault, this tick's jump included
    q_hat: Array  # [n, ...] rad, reading less its fault
    psi: Array  # [n, ...] rad/s^2, actuator fault, Eq. (15)
    missing: Array  # [n, ...] bool, the reading was not finite


def init(config: Config, gains: Gains, q: Array) -> State:
    """No fault, at rest in q [n, ...] rad."""
    zero = jnp.zeros_like(q)
    return State(
        arx=arx.init(config, gains, q),
        pi=pi.State(zero),
        sliding=super_twisting.State(zero),
        adaptive=adaptive.State(zero, zero),
        e=zero,
        held=zero,
    )


def explain(config: Config, gains: Gains, state: State, reading: Array) -> tuple[State, Innovation]:
    """Innovation and fault estimates of this tick from a reading [n, ...] rad.

    A reading that is not finite gives no innovation: the model's prediction takes its place, and no jump is booked when
    readings come back, because the model has been on its own since.
    """
    y_hat, b = arx.predict(gains.arx, state.arx), state.adaptive.b
    missing = ~jnp.isfinite(reading)
    y = jnp.where(missing, y_hat + b, reading)
    e = y - b - y_hat
    if config.observer == "ts":
        jump = adaptive.book_jump(gains.observer, jnp.where(missing | (state.held > 0), 0.0, e - state.e))
    else:
        jump = adaptive.Jump(jnp.zeros_like(e), jnp.zeros_like(e))
    e, b = e - jump.moved, b + jump.moved
    pi_next, psi = pi.step(gains.observer, state.pi, e)
    sliding_next = state.sliding
    if config.observer != "pi":
        sliding_next, psi_sm = super_twisting.step(
            gains.observer, state.sliding, e, jump.h_s, config.dt, hard=config.sign == "hard"
        )
        psi = psi + psi_sm  # Eq. (15)
    if config.observer == "ts":
        psi = psi + state.adaptive.psi  # Eq. (15)
    info = Innovation(y, y_hat, e, jump, b, y - b, psi, missing)
    return state._replace(pi=pi_next, sliding=sliding_next, e=e, held=missing.astype(e.dtype)), info


def adapt(config: Config, gains: Gains, state: State, info: Innovation, residual_tau: Array) -> State:
    """Second half: the fuzzy stage learns from the torque residual [n, ...] N m, the angle's bank from the correction.

    x+ = A x + b_y (y_hat + alpha_p e) + b_v (v + psi): the correction enters through b_y, the fault through b_v; the input's
    bank waits for the torque that is really commanded (``drive``).
    """
    fuzzy = state.adaptive
    if config.observer == "ts":
        fuzzy = adaptive.step(gains.observer, fuzzy, info.e, info.jump, residual_tau, gains.diagnosis.alpha_tau)
    corrected = info.y_hat + gains.observer.alpha_p * info.e  # Eq. (6)
    x_a = arx.laguerre.advance(gains.arx.xi_a, state.arx.x_a, corrected)
    return state._replace(adaptive=fuzzy, arx=state.arx._replace(x_a=x_a))


def drive(gains: Gains, state: State, u: Array) -> State:
    """Let the input u [n, ...] of the last tick into the input's bank: v + psi, or tau + M psi for the torque form."""
    x_b = arx.laguerre.advance(gains.arx.xi_b, state.arx.x_b, u)
    return state._replace(arx=state.arx._replace(x_b=x_b))
