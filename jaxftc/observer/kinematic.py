"""What the readings alone say: the ARX-Laguerre model and the PI stage as a tracker of angle and acceleration.

With the nominal arm's acceleration as input, blocks 1 and 2 estimate what is missing in it. Without any input psi is the
whole acceleration: three poles, no inertia to invert, nothing of what the model of the arm has wrong. That serves under
somebody else's controller, whose torque is known no better than the friction that it works against.

A reading is judged by w, what the expected acceleration leaves unexplained of its speed. A jump goes to the encoder fault b.
A healthy recording has more in it than noise, and none of this is a jump:

* a row that was stamped wrong moves every reading along its own speed: ``_slip`` takes from w what the other joints say,
  and where the log's stamps are uneven, w counts beyond what they can have done;
* a reading that comes late, and is right again: its w is twice as large when it returns. The innovation, which knows the
  motion before it, is not: w counts as far as both agree;
* a reading that is an outlier: the first of a jump is set aside, for ``HELD`` ticks at most. It was a jump if the next one
  is off to the same side. What stays is a fault, what passes is not.

Readings that stay the same while the arm must have moved are frozen. Jumps in a row to one side are a reading that moves by
itself: after ``LONGEST`` of them it is held to drift, the tracker goes with it, and b keeps what it has. b that stays below
its alarm is forgotten within seconds, so that years of small errors do not add up.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.config import Config
from jaxftc.fuzzy import takagi_sugeno
from jaxftc.gains import Gains
from jaxftc.observer import arx, laguerre
from jaxftc.types import Array

FARTHEST = 1e4  # rad; what reads more is no angle
PATIENCE = 0.2  # s without a reading for which the motion is taken to go on; then the arm is taken to stand
SETTLE = 0.2  # s of readings in which the tracker finds a speed that it does not know; jumps are not judged so long
FORGET = 2.0  # s in which a b that is below its alarm is forgotten
LONGEST = 3  # jumps in a row
HELD = 2  # ticks for which a reading may be an outlier, to one side and to the other
FROZEN, COUNTS, TRAVEL = 5, 30.0, 5e-3  # equal readings; counts or rad, the larger, by which the arm should have moved
SLOW = 0.05  # rad/s; slower joints say nothing of the clock
STANDING = 0.01  # rad/s, of a joint's mean speed over a tenth of a second


class State(NamedTuple):
    """Tracker, encoder fault, and what is remembered of the readings."""

    arx: arx.State
    psi: Array  # [n, ...] rad/s^2, acceleration
    qd: Array  # [n, ...] rad/s
    mean_speed: Array  # [n, ...] rad/s, over a tenth of a second
    b: Array  # [n, ...] rad, encoder fault
    e: Array  # [n, ...] rad, innovation of the last tick, its jump taken out
    q1: Array  # [n, ...] rad, angle one tick ago
    q2: Array  # [n, ...] rad, two ticks ago
    q3: Array  # [n, ...] rad, three ticks ago
    unread: Array  # [n, ...] ticks without a reading
    known: Array  # [n, ...] s of readings since the start or the last pause, in which the tracker finds the speed
    run: Array  # [n, ...] jumps in a row to one side, negative for those down; one that was set aside counts
    held: Array  # [n, ...] readings in a row that were set aside
    drifts: Array  # [n, ...] 1 while the reading is held to drift, else 0
    reading: Array  # [n, ...] rad, last one
    least: Array  # [n, ...] rad, least change of a reading so far
    equal: Array  # [n, ...] readings in a row that did not change
    longest: Array  # [n, ...] most of them so far
    speed: Array  # [n, ...] rad/s, of the arm since the reading last changed
    slowing: Array  # [n, ...] rad/s^2, acceleration when it did
    travel: Array  # [n, ...] rad, by which the arm should have moved since
    frozen: Array  # [n, ...] 1 while the reading is held to be frozen, else 0


class Inputs(NamedTuple):
    """What a tick takes in."""

    q: Array  # [n, ...] rad, encoder
    alarmed_q: Array  # [n, ...] bool, the encoder alarm is up
    alarmed_tau: Array  # [n, ...] bool, the torque alarm is up
    jitter: Array | float = 0.0  # [n, ...] s, by which the time between readings may be wrong


class Estimate(NamedTuple):
    """What the readings say."""

    w: Array  # [n, ...] rad, what no acceleration explains of the reading's motion
    h_s: Array  # [n, ...] grade in 0..1: no torque can have done it
    b: Array  # [n, ...] rad, encoder fault
    fault_q: Array  # [n, ...] rad, b, or what a frozen reading is off by
    q_hat: Array  # [n, ...] rad, reading less its fault
    qd_hat: Array  # [n, ...] rad/s
    missing: Array  # [n, ...] bool, the reading was not used
    wrong: Array  # [n, ...] bool, it cannot be: absent for long, frozen or drifting
    known: Array  # [n, ...] bool, the tracker has found the speed


def init(config: Config, gains: Gains, q: Array) -> State:
    """At rest in q [n, ...] rad."""
    rest = State(arx.init(config, gains, q), *[jnp.zeros_like(q)] * (len(State._fields) - 1))
    return rest._replace(q1=q, q2=q, q3=q, reading=q, least=jnp.ones_like(q))


def step(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, Estimate]:
    """Follow the reading, or the motion it had; a jump is the encoder's."""
    own, dt = gains.observer, config.dt
    x_b = laguerre.advance(gains.arx.xi_b, state.arx.x_b, state.psi)
    y_hat = arx.predict(gains.arx, arx.State(state.arx.x_a, x_b))

    absent = ~(jnp.abs(inputs.q) < FARTHEST)
    same = inputs.q == state.reading
    missing = absent | (same & (state.frozen > 0))
    back = ~missing & (state.unread > 0)
    y = jnp.where(missing, y_hat + state.b, inputs.q)
    e = y - state.b - y_hat
    shift = jnp.where(back, e, 0.0)  # the motion that it had was not the one it made

    w = _slip(config, _unexplained(config, state, y - state.b), state.qd)
    speed = jnp.maximum(jnp.abs(state.qd), jnp.abs(state.mean_speed))  # uneven readings make the first one restless
    late = 2 * inputs.jitter * speed  # w is a difference of two steps
    w = jnp.sign(w) * jnp.maximum(jnp.abs(w) - late, 0.0)
    known = jnp.where(missing | back, 0.0, state.known + dt)
    w = jnp.where((w * e > 0) & (known > SETTLE), jnp.sign(w) * jnp.minimum(jnp.abs(w), jnp.abs(e)), 0.0)
    h_s = takagi_sugeno.jump_share(w, own.jump, own.jump_centres, own.jump_widths)
    side = jnp.where(h_s > 0.5, jnp.sign(w), 0.0)
    follows = side * state.run > 0
    aside = (side != 0) & ~follows & (state.held < HELD)
    run = jnp.where(follows, state.run + side, side)
    h_s = jnp.where(jnp.abs(run) > LONGEST, 0.0, h_s)
    moved = jnp.where(known > SETTLE, own.alpha_f2 * h_s * (e - state.e), 0.0)
    b, q_hat = state.b + jnp.where(aside, 0.0, moved), y - state.b - moved
    e, y_hat = e - shift - moved, y_hat + shift

    x_a = state.arx.x_a + (laguerre.steady_gain(gains.arx.xi_a) * shift)[:, None]
    x_a = laguerre.advance(gains.arx.xi_a, x_a, y_hat + own.alpha_p * e)  # Eq. (6)
    psi = jnp.where(missing, 0.0, state.psi + own.alpha_i * e)
    predicted = state.qd + dt * state.psi
    measured = (q_hat - state.q1 - shift) / dt + 0.5 * dt * state.psi  # control/surface.py
    qd = predicted + gains.control.speed_weight * (measured - predicted)
    unread = jnp.where(missing, state.unread + 1, 0.0)
    rest, lost = arx.init(config, gains, q_hat), unread > PATIENCE / dt
    x_a, x_b = jnp.where(lost[:, None], rest.x_a, x_a), jnp.where(lost[:, None], rest.x_b, x_b)
    qd = jnp.where(lost, 0.0, qd)
    mean_speed = state.mean_speed + min(1.0, dt / 0.1) * (qd - state.mean_speed)

    drifts = (jnp.abs(run) >= LONGEST) | ((state.drifts > 0) & (jnp.abs(b) >= gains.diagnosis.alpha_q))
    kept = jnp.where(inputs.alarmed_q | (jnp.abs(b) >= gains.diagnosis.alpha_q), b, b * (1 - dt / FORGET))
    angles = [(b - kept) + q for q in (q_hat, state.q1 + shift, state.q2 + shift)]
    state = state._replace(
        arx=arx.State(x_a, x_b), psi=psi, qd=qd, mean_speed=mean_speed, b=kept, e=e, unread=unread, known=known, run=run,
        held=jnp.where(aside, state.held + 1, 0.0), q1=angles[0], q2=angles[1], q3=angles[2],
        drifts=drifts.astype(q_hat.dtype),
    )  # fmt: skip
    state = _freeze(config, state, inputs, absent)
    frozen = state.frozen > 0
    wrong = frozen | drifts | (absent & (unread >= FROZEN))
    fault_q = jnp.where(frozen & ~absent, inputs.q - q_hat, b)
    return state, Estimate(w, h_s, b, fault_q, q_hat, qd, missing, wrong, known > SETTLE)


def _unexplained(config: Config, state: State, q: Array) -> Array:
    """What the acceleration does not explain of the speed's change over a tick, or over two: the larger, [n, ...] rad.

    A reading that is resampled spreads what happens to it over two ticks.
    """
    push = config.dt**2 * state.psi
    one = q - 2 * state.q1 + state.q2 - push
    two = (q - state.q1) - (state.q2 - state.q3) - 2 * push
    return jnp.where(jnp.abs(two) > jnp.abs(one), two, one)


def _slip(config: Config, w: Array, speed: Array) -> Array:
    """W [n, ...] rad less what an error of the row's time, common to all joints, makes of it at their speeds [n, ...] rad/s.

    Each joint is held against the others only: the median of their w / speed, weighted by speed, at most two sample times.
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
        left = w[j] - speed[j] * jnp.clip(delay, -2 * config.dt, 2 * config.dt)
        out.append(jnp.where(jnp.abs(left) < jnp.abs(w[j]), left, w[j]))
    return jnp.stack(out)


def _freeze(config: Config, state: State, inputs: Inputs, absent: Array) -> State:
    """Readings that stay the same while the arm moves.

    The arm is taken to go on with the speed that it had when the reading last changed, braking if it braked, until it
    stands. Of an encoder that never stood still half so long before, an actuator alarm is enough to say that the arm moves.
    """
    dt, step = config.dt, jnp.abs(inputs.q - state.reading)
    same = absent | (step == 0)
    equal = jnp.where(absent, state.equal, jnp.where(same, state.equal + 1, 0.0))
    stepped = step / (dt * (state.equal + 1))  # of a coarse encoder: one count in so many ticks
    changed = jnp.where(state.equal > 0, jnp.clip(state.qd, -stepped, stepped), state.qd)
    changed = jnp.where(jnp.abs(state.mean_speed) > 2 * STANDING, changed, 0.0)
    braking = jnp.where(state.slowing * state.speed < 0, state.slowing, 0.0)
    ahead = state.speed + dt * braking
    ahead = jnp.where(ahead * state.speed > 0, ahead, 0.0)
    travel = jnp.where(same, state.travel + dt * jnp.abs(state.speed), 0.0)
    far = jnp.maximum(COUNTS * state.least, TRAVEL)
    unlike = (equal > 2 * state.longest + FROZEN) & (equal * dt >= 0.1) & inputs.alarmed_tau
    frozen = (equal >= FROZEN) & ((travel > far) | unlike | (state.frozen > 0))
    return state._replace(
        reading=jnp.where(absent, state.reading, inputs.q),
        least=jnp.where(absent | (step == 0), state.least, jnp.minimum(state.least, step)),
        equal=equal,
        longest=jnp.where(same | (state.frozen > 0), state.longest, jnp.maximum(state.longest, state.equal)),
        speed=jnp.where(same, ahead, changed),
        slowing=jnp.where(same, state.slowing, state.psi),
        travel=travel,
        frozen=frozen.astype(travel.dtype),
    )
