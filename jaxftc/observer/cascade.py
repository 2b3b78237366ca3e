"""The cascade: one innovation, up to three stages, two fault estimates, Eqs. (6) to (10), (13), (15), (16).

psi, the actuator fault, is an acceleration that enters the ARX model through its input column; b, the encoder fault, is
taken off the reading. ``Stages`` says how many of them run.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.numerics.barrier import store
from jaxftc.observer import arx, laguerre, pi, super_twisting, takagi_sugeno
from jaxftc.stages import Stages, either
from jaxftc.types import Array


class State(NamedTuple):
    """Model, stages and the readings that a jump is told by."""

    arx: arx.State
    pi: pi.State
    sliding: super_twisting.State
    adaptive: takagi_sugeno.State
    e: Array  # [n, ...] rad, innovation of the last tick, its jump taken out
    q1: Array  # [n, ...] rad, q_hat one tick ago
    q2: Array  # [n, ...] rad, q_hat two ticks ago
    reading: Array  # [n, ...] rad, last finite reading
    b_fresh: Array  # [n, ...] rad, encoder fault when the reading last changed
    held: Array  # [n, ...] 1 where the last reading was not used, else 0


class Doubt(NamedTuple):
    """What the second look held of each reading one tick ago."""

    suspect: Array  # [n, ...] 1 where the reading is held to be wrong, for any of the reasons below or a steep drift
    kicked: Array  # [n, ...] 1 where its speed was found to be wrong
    frozen: Array  # [n, ...] 1 where it is held to be frozen
    noisy: Array  # [n, ...] 1 where it is held to be noisy


class Innovation(NamedTuple):
    """First half of a tick: what the reading says."""

    y: Array  # [n, ...] rad, reading, predicted where it was not used
    y_hat: Array  # [n, ...] rad, model
    e: Array  # [n, ...] rad, innovation, its jump taken out
    jump: takagi_sugeno.Jump
    shift: Array  # [n, ...] rad, by which the model was moved to meet the reading
    b: Array  # [n, ...] rad, encoder fault, this tick's jump included
    q_hat: Array  # [n, ...] rad, reading less its fault
    fault: Array  # [n, ...] rad, encoder fault: b, or what a frozen reading is off by
    psi: Array  # [n, ...] rad/s^2, actuator fault, Eq. (15)
    missing: Array  # [n, ...] bool, the reading was not used
    absent: Array  # [n, ...] bool, there was no finite reading


def init(config: Config, gains: Gains, q: Array) -> State:
    """No fault, at rest in q [n, ...] rad."""
    zero = jnp.zeros_like(q)
    return State(
        arx=arx.init(config, gains, q),
        pi=pi.State(zero),
        sliding=super_twisting.State(zero),
        adaptive=takagi_sugeno.State(zero, zero),
        e=zero,
        q1=q,
        q2=q,
        reading=q,
        b_fresh=zero,
        held=zero,
    )


def explain(
    config: Config, gains: Gains, state: State, reading: Array, expected: Array, doubt: Doubt, on: Stages
) -> tuple[State, Innovation]:
    """Innovation and fault estimates of this tick from a reading [n, ...] rad.

    ``expected`` [n, ...] rad/s^2 is the acceleration that command and fault estimate stand for. A jump is what it leaves
    unexplained of the second difference of the corrected reading. (The change of the innovation is no test: it is also the
    observer's own correction of a large innovation, and booking that as encoder fault runs away.) The model takes the place
    of a reading that is absent or frozen, and moves to the reading that comes back; it also follows the jumps of a reading
    that is already held to be wrong.
    """
    y_hat = arx.predict(gains.arx, state.arx)
    stuck = (doubt.frozen > 0) & (reading == state.reading)
    absent = ~jnp.isfinite(reading)
    missing = absent | stuck
    back = ~missing & (state.held > 0)
    b = jnp.where(stuck, state.b_fresh, state.adaptive.b)
    y = jnp.where(missing, y_hat + b, reading)
    e = y - b - y_hat
    jump = takagi_sugeno.Jump(*[jnp.zeros_like(e)] * 4)
    if on.fuzzy is not False:
        strange = y - b - 2 * state.q1 + state.q2 - config.dt**2 * expected
        strange = jnp.where(missing | back, 0.0, strange)
        judged = takagi_sugeno.judge(gains.observer, strange, e - state.e, b, doubt.kicked, doubt.noisy)
        jump = either(on.fuzzy, judged, jump)
    shift = jnp.where(back, e, jump.followed)
    x_a = state.arx.x_a + (laguerre.steady_gain(gains.arx.xi_a) * shift)[:, None]  # H_y(1) = 1: y_hat moves by shift
    y_hat, e, b = store((y_hat + shift, e - shift - jump.moved, b + jump.moved))
    pi_next, psi = pi.step(gains.observer, state.pi, e)
    hard, rest = config.sign == "hard", (state.sliding, jnp.zeros_like(e))
    mended = super_twisting.step(gains.observer, state.sliding, e, jump.h_s, config.dt, hard=hard)
    printed = super_twisting.step_printed(gains.observer, state.sliding, e, hard=hard)
    sliding_next, psi_sm = either(on.sliding, either(on.printed, printed, mended), rest)
    psi = psi + psi_sm + state.adaptive.psi  # Eq. (15); a stage that does not run has psi = 0
    q_hat = y - b
    fault = jnp.where(stuck, reading - q_hat, b)
    info = Innovation(y, y_hat, e, jump, shift, b, q_hat, fault, psi, missing, absent)
    changed = ~missing & (reading != state.reading)
    return State(
        arx=state.arx._replace(x_a=x_a),
        pi=pi_next,
        sliding=sliding_next,
        adaptive=state.adaptive._replace(b=b),
        e=e,
        q1=q_hat,
        q2=state.q1 + shift,
        reading=jnp.where(absent, state.reading, reading),
        b_fresh=jnp.where(changed, b, state.b_fresh),
        held=missing.astype(e.dtype),
    ), info


def adapt(gains: Gains, state: State, info: Innovation, residual_tau: Array, on: Stages) -> State:
    """Second half: the fuzzy stage learns from the torque residual [n, ...] N m, the angle's bank from the correction.

    x+ = A x + b_y (y_hat + alpha_p e) + b_v (v + psi): the correction enters through b_y, the fault through b_v; the input's
    bank waits for the torque that is really commanded (``drive``).
    """
    fuzzy = state.adaptive
    if on.fuzzy is not False:
        moved = takagi_sugeno.step(gains.observer, fuzzy, info.e, info.jump, residual_tau, gains.diagnosis.alpha_tau)
        fuzzy = either(on.fuzzy, moved, fuzzy)
    corrected = info.y_hat + gains.observer.alpha_p * info.e  # Eq. (6)
    x_a = laguerre.advance(gains.arx.xi_a, state.arx.x_a, corrected)
    return state._replace(adaptive=fuzzy, arx=state.arx._replace(x_a=x_a))


def drive(gains: Gains, state: State, u: Array) -> State:
    """Let the input u [n, ...] of the last tick into the input's bank: v + psi, or tau + M psi for the torque form."""
    x_b = laguerre.advance(gains.arx.xi_b, state.arx.x_b, u)
    return state._replace(arx=state.arx._replace(x_b=x_b))
