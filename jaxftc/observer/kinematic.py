"""What the readings alone say: the ARX-Laguerre model and the PI stage as a tracker of angle and acceleration.

With the nominal arm's acceleration as input, blocks 1 and 2 estimate what is missing in it. Without any input psi is the
whole acceleration: three poles, no inertia to invert, nothing of what the model of the arm has wrong. That serves under
somebody else's controller, whose torque is known no better than the friction that it works against.

A reading is judged by w, what the expected acceleration leaves unexplained of its second difference (observer/cascade.py). A
jump goes to the encoder fault b. Two things tell it from what a healthy recording does:

* a row that was stamped wrong moves every reading along its own speed; ``slip`` takes from w what the others say of it;
* b that stays below its alarm is forgotten within seconds, so that years of small errors do not add up.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.config import Config
from jaxftc.fuzzy import takagi_sugeno
from jaxftc.gains import Gains
from jaxftc.observer import arx, laguerre
from jaxftc.observer.takagi_sugeno import Jump
from jaxftc.types import Array

FARTHEST = 1e4  # rad; what reads more is no angle
PATIENCE = 0.2  # s without a reading for which the motion is taken to go on; then the arm is taken to stand
FORGET = 2.0  # s in which a b that is below its alarm is forgotten
SLOW = 0.05  # rad/s; slower joints say nothing of the clock


class State(NamedTuple):
    """Tracker, encoder fault, and the readings that a jump is seen by."""

    arx: arx.State
    psi: Array  # [n, ...] rad/s^2, acceleration
    b: Array  # [n, ...] rad, encoder fault
    e: Array  # [n, ...] rad, innovation of the last tick, its jump taken out
    q1: Array  # [n, ...] rad, angle one tick ago
    q2: Array  # [n, ...] rad, two ticks ago
    unread: Array  # [n, ...] ticks without a reading


class Inputs(NamedTuple):
    """What a tick takes in."""

    q: Array  # [n, ...] rad, encoder
    frozen: Array  # [n, ...] bool, the reading is held to be frozen
    alarmed: Array  # [n, ...] bool, the encoder alarm is up


class Estimate(NamedTuple):
    """What the readings say."""

    y: Array  # [n, ...] rad, reading, predicted where there is none
    w: Array  # [n, ...] rad, what no acceleration explains of its second difference
    jump: Jump
    moved: Array  # [n, ...] rad, by which the angle was moved without a motion
    b: Array  # [n, ...] rad, encoder fault
    q_hat: Array  # [n, ...] rad, reading less its fault
    e: Array  # [n, ...] rad, innovation
    psi: Array  # [n, ...] rad/s^2, acceleration
    missing: Array  # [n, ...] bool, the reading was not used
    absent: Array  # [n, ...] bool, there was none


def init(config: Config, gains: Gains, q: Array) -> State:
    """At rest in q [n, ...] rad."""
    zero = jnp.zeros_like(q)
    return State(arx.init(config, gains, q), zero, zero, zero, q, q, zero)


def step(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, Estimate]:
    """Follow the reading, or the motion it had; a jump is the encoder's."""
    own, dt = gains.observer, config.dt
    absent = ~(jnp.abs(inputs.q) < FARTHEST)
    missing = absent | inputs.frozen
    back = ~missing & (state.unread > 0)
    x_b = laguerre.advance(gains.arx.xi_b, state.arx.x_b, state.psi)
    y_hat = arx.predict(gains.arx, arx.State(state.arx.x_a, x_b))
    y = jnp.where(missing, y_hat + state.b, inputs.q)
    e = y - state.b - y_hat
    w = (y - state.b) - 2 * state.q1 + state.q2 - dt**2 * state.psi
    w = jnp.where(missing | back, 0.0, slip(config, w, (state.q1 - state.q2) / dt))
    h_s = takagi_sugeno.jump_share(w, own.jump, own.jump_centres, own.jump_widths)
    moved = jnp.where(missing | back, 0.0, own.alpha_f2 * h_s * (e - state.e))
    shift = jnp.where(back, e, 0.0)  # the motion that it had was not the one it made
    b = state.b + moved
    e = e - shift - moved
    y_hat = y_hat + shift
    x_a = state.arx.x_a + (laguerre.steady_gain(gains.arx.xi_a) * shift)[:, None]
    x_a = laguerre.advance(gains.arx.xi_a, x_a, y_hat + own.alpha_p * e)  # Eq. (6)
    psi = state.psi + own.alpha_i * e  # Eq. (6)
    q_hat = y - b
    kept = jnp.where(inputs.alarmed | (jnp.abs(b) >= gains.diagnosis.alpha_q), b, b * (1 - dt / FORGET))
    unread = jnp.where(missing, state.unread + 1, 0.0)
    stands = unread > PATIENCE / dt
    rest = arx.init(config, gains, q_hat)
    x_a, x_b = jnp.where(stands[:, None], rest.x_a, x_a), jnp.where(stands[:, None], rest.x_b, x_b)
    psi = jnp.where(missing, 0.0, psi)
    before = state.q1 + shift
    state = State(arx.State(x_a, x_b), psi, kept, e, q_hat + (b - kept), before + (b - kept), unread)
    return state, Estimate(y, w, Jump(h_s, jnp.sign(w), moved, shift), shift, b, q_hat, e, psi, missing, absent)


def slip(config: Config, w: Array, speed: Array) -> Array:
    """W [n, ...] rad less what an error of the row's time, common to all joints, makes of it at their speeds [n, ...] rad/s.

    Each joint is held against the others only: the median of their w / speed, weighted by speed, at most one sample time.
    It may explain a w away and never make one.
    """
    n = w.shape[0]
    if n < 3:
        return w
    weight = jnp.concatenate([jnp.abs(speed), jnp.full_like(speed[:1], SLOW)])  # the last is a clock that is right
    ratio = jnp.concatenate([w / jnp.where(jnp.abs(speed) < 1e-6, 1e-6, speed), jnp.zeros_like(w[:1])])
    order = jnp.argsort(ratio, axis=0)
    weight, ratio = jnp.take_along_axis(weight, order, 0), jnp.take_along_axis(ratio, order, 0)
    out = []
    for j in range(n):
        others = jnp.where(order == j, 0.0, weight)
        share = jnp.cumsum(others, 0) / others.sum(0)
        delay = jnp.take_along_axis(ratio, (share < 0.5).sum(0)[None], 0)[0]
        left = w[j] - speed[j] * jnp.clip(delay, -config.dt, config.dt)
        out.append(jnp.where(jnp.abs(left) < jnp.abs(w[j]), left, w[j]))
    return jnp.stack(out)
