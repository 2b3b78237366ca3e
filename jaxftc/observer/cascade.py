"""The cascade: one innovation, up to three stages, two fault estimates, Eqs. (6) to (10), (13), (15), (16).

psi, the actuator fault, is an acceleration that enters the ARX model through its input column; b, the encoder fault, is
taken off the reading. ``Stages`` says how many of them run. A tick has three parts: ``apply_input`` lets the commanded
torque into the model, ``correct`` makes both estimates from the reading, and ``adapt`` learns from the torque residual,
which needs the inertia at the corrected angle.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.numerics.barrier import store
from jaxftc.observer import arx, laguerre, pi, super_twisting, takagi_sugeno
from jaxftc.observer.stage import Inputs
from jaxftc.observer.takagi_sugeno import Jump
from jaxftc.robot import reach
from jaxftc.stages import Stages, either
from jaxftc.types import Array, SensorStatus

STAGES: dict[str, ModuleType] = {"pi": pi, "sliding": super_twisting}  # blocks 2 and 3; block 4 looks at more
BLIND = 1.0  # rad/s^2, by which a prediction without a reading may be wrong
UNDONE = 0.02  # share of a large encoder fault that a jump back may leave: the arm has drifted by that much meanwhile
SETTLE = 50.0  # ticks, at most, in which a model without a reading loses the arm's speed and finds it again


class State(NamedTuple):
    """Model, stages and the readings that a jump is seen by."""

    arx: arx.State
    stages: dict[str, Any]  # a state for each of STAGES
    fuzzy: takagi_sugeno.State
    e: Array  # [n, ...] rad, innovation of the last tick, its jump taken out
    q1: Array  # [n, ...] rad, q_hat one tick ago
    q2: Array  # [n, ...] rad, q_hat two ticks ago
    reading: Array  # [n, ...] rad, last finite reading
    b_fresh: Array  # [n, ...] rad, encoder fault when the reading last changed
    unread: Array  # [n, ...] ticks since a reading was last used; below zero while the model settles after a pause


class Reading(NamedTuple):
    """What a tick takes in, beside the input that ``apply_input`` lets in."""

    q: Array  # [n, ...] rad, encoder
    qdd: Array  # [n, ...] rad/s^2, acceleration that command and fault estimate stand for
    sensors: SensorStatus  # of the last tick


class Estimate(NamedTuple):
    """What the reading says."""

    y: Array  # [n, ...] rad, reading, predicted where it was not used
    y_hat: Array  # [n, ...] rad, model
    e: Array  # [n, ...] rad, innovation, its jump taken out
    jump: Jump
    model_reset: Array  # [n, ...] rad, by which the model was moved to meet the reading
    b: Array  # [n, ...] rad, encoder fault, this tick's jump included
    q_hat: Array  # [n, ...] rad, reading less its fault
    fault_q: Array  # [n, ...] rad, encoder fault: b, or what a frozen reading is off by
    psi: Array  # [n, ...] rad/s^2, actuator fault, Eq. (15)
    missing: Array  # [n, ...] bool, the reading was not used
    absent: Array  # [n, ...] bool, there was no finite reading
    reading: Array  # [n, ...] rad, last finite reading


class _Availability(NamedTuple):
    """Which readings can be used, all [n, ...] bool."""

    frozen: Array  # held to be frozen, and still the same
    absent: Array  # not finite
    wild: Array  # further from the last one than a joint turns in a tick
    settling: Array  # used again, but the model may not have the arm's speed yet
    missing: Array  # not used: frozen, absent, or one that the sensor check gives no credit
    back: Array  # used again after a pause


def init(config: Config, gains: Gains, q: Array) -> State:
    """No fault, at rest in q [n, ...] rad."""
    zero = jnp.zeros_like(q)
    return State(
        arx=arx.init(config, gains, q),
        stages={name: stage.init(config, gains, q) for name, stage in STAGES.items()},
        fuzzy=takagi_sugeno.init(config, gains, q),
        e=zero,
        q1=q,
        q2=q,
        reading=q,
        b_fresh=zero,
        unread=zero,
    )


@box("Block 1: the input enters the ARX-Laguerre model, Eq. (5)")
def apply_input(gains: Gains, state: State, u: Array) -> State:
    """Let the input u [n, ...] of the last tick into the input's bank: v + psi, or tau + M psi for the torque form."""
    x_b = laguerre.advance(gains.arx.xi_b, state.arx.x_b, u)
    return state._replace(arx=state.arx._replace(x_b=x_b))


@box("Blocks 1 to 4: innovation and fault estimates, Eqs. (6), (15), (16)")
def correct(config: Config, gains: Gains, state: State, reading: Reading, on: Stages) -> tuple[State, Estimate]:
    """Innovation and fault estimates of this tick.

    The model takes the place of a reading that is absent or frozen, and moves to the reading that comes back; it also
    follows the jumps of a reading that is already held to be wrong.
    """
    y_hat = arx.predict(gains.arx, state.arx)
    frozen = (reading.sensors.frozen > 0) & (reading.q == state.reading)
    b = jnp.where(frozen, state.b_fresh, state.fuzzy.b)
    at = _availability(config, state, reading, frozen, reading.q - b - y_hat)
    y = jnp.where(at.missing, y_hat + b, _within_count(reading, y_hat + b))
    ended, healed = _returned(config, state, reading.sensors, y - y_hat, b)
    b = jnp.where(at.back & (ended | healed), 0.0, b)
    e = y - b - y_hat
    jump = _jump(config, gains, state, reading, at, y - b, e, b, on)
    beyond = (jnp.abs(e) > _step(config) * (1 + state.unread)) & (reading.sensors.transient == 0)
    leap = at.back & beyond & ~ended
    moved = jnp.where(leap, e, jump.moved)
    undone = at.wild & ~at.missing & (jnp.abs(b + moved) < UNDONE * jnp.abs(b))
    jump = jump._replace(moved=jnp.where(undone, -b, moved))
    ahead = y_hat - state.q1  # a model that is left to itself must not leave the arm behind
    reach_back = jnp.where(at.missing, jnp.clip(ahead, -_step(config), _step(config)) - ahead, jump.followed)
    model_reset = jnp.where(undone, e + b, jnp.where(at.back & ~leap, e, reach_back))
    y_hat, e, b, model_reset = store((y_hat + model_reset, e - model_reset - jump.moved, b + jump.moved, model_reset))
    x_a = state.arx.x_a + (laguerre.steady_gain(gains.arx.xi_a) * model_reset)[:, None]  # H_y(1) = 1: y_hat moves with it
    inputs = Inputs(e, jump.h_s, on)
    made = {name: stage.step(config, gains, state.stages[name], inputs) for name, stage in STAGES.items()}
    psi = sum(share for _, share in made.values()) + state.fuzzy.psi  # Eq. (15); a stage that does not run has 0
    q_hat = y - b
    fault_q = jnp.where(at.frozen, reading.q - q_hat, b)
    finite = jnp.where(at.absent, state.reading, reading.q)
    changed = ~at.missing & (reading.q != state.reading)
    next_state = State(
        arx=state.arx._replace(x_a=x_a),
        stages={name: state for name, (state, _) in made.items()},
        fuzzy=state.fuzzy._replace(b=b),
        e=e,
        q1=q_hat,
        q2=state.q1 + model_reset,
        reading=finite,
        b_fresh=jnp.where(changed, b, state.b_fresh),
        unread=_pause(state, at),
    )
    return next_state, Estimate(y, y_hat, e, jump, model_reset, b, q_hat, fault_q, psi, at.missing, at.absent, finite)


@box("Blocks 1 to 4: the correction enters the model, Eqs. (6), (9)")
def adapt(
    config: Config, gains: Gains, state: State, seen: Estimate, residual_tau: Array, threshold_tau: Array, on: Stages
) -> State:
    """Let the fuzzy stage learn from the torque residual and its threshold [n, ...] N m, and the correction into the model.

    x+ = A x + b_y (y_hat + alpha_p e) + b_v (v + psi): the correction enters through b_y, the fault through b_v; the input's
    bank waits for the torque that is really commanded (``apply_input``).
    """
    fuzzy = state.fuzzy
    if on.fuzzy is not False:
        inputs = takagi_sugeno.Inputs(seen.e, seen.jump.h_s, residual_tau, threshold_tau)
        fuzzy = either(on.fuzzy, takagi_sugeno.step(config, gains, fuzzy, inputs)[0], fuzzy)
    corrected = seen.y_hat + gains.observer.alpha_p * seen.e  # Eq. (6)
    x_a = laguerre.advance(gains.arx.xi_a, state.arx.x_a, corrected)
    return state._replace(fuzzy=fuzzy, arx=state.arx._replace(x_a=x_a))


def _step(config: Config) -> float:
    """More, rad, than a joint turns in a tick."""
    return reach.SPEED * config.dt


def _within_count(reading: Reading, predicted: Array) -> Array:
    """The reading, or where it is coarse the angle [n, ...] rad nearest to the predicted one for which it stands."""
    half = 0.5 * reading.sensors.resolution
    return jnp.where(half > 0, jnp.clip(predicted, reading.q - half, reading.q + half), reading.q)


def _availability(config: Config, state: State, reading: Reading, frozen: Array, e: Array) -> _Availability:
    """What becomes of a reading whose innovation is e [n, ...] rad; ``frozen`` [n, ...] bool."""
    absent = ~jnp.isfinite(reading.q)
    wild = jnp.abs(reading.q - state.reading) > _step(config)
    doubted = ((reading.sensors.noisy > 0) & (jnp.abs(e) > _step(config))) | ((reading.sensors.suspect > 0) & wild)
    doubted = doubted | (wild & (state.unread > 0))
    missing = absent | frozen | doubted
    return _Availability(frozen, absent, wild, (state.unread < 0) & ~wild, missing, ~missing & (state.unread > 0))


def _returned(config: Config, state: State, sensors: SensorStatus, e: Array, b: Array) -> tuple[Array, Array]:
    """Whether a reading that comes back, e [n, ...] rad off a prediction without a fault, has lost its fault b in the pause.

    First, the end of a drift. Its size is not known well, for it moves the arm: a reading is believed that comes back
    clearly nearer. Second, what is nearer to the prediction is believed. That gets worse with the pause, and the fault is
    believed less.
    """
    blind = 0.5 * BLIND * (config.dt * state.unread) ** 2
    return (sensors.suspect > 0) & (jnp.abs(e) < 0.8 * jnp.abs(b)), jnp.abs(e) <= jnp.abs(e - b) + blind


def _pause(state: State, at: _Availability) -> Array:
    """Ticks since a reading was last used; after a pause as many below zero, up to SETTLE, in which the model settles."""
    used = jnp.where(at.back, -jnp.minimum(state.unread, SETTLE), jnp.minimum(state.unread + 1, 0.0))
    return jnp.where(at.missing, jnp.maximum(state.unread, 0.0) + 1, used)


def _jump(
    config: Config,
    gains: Gains,
    state: State,
    reading: Reading,
    at: _Availability,
    corrected: Array,
    e: Array,
    b: Array,
    on: Stages,
) -> Jump:
    """The jump of a reading, by what the expected acceleration leaves unexplained of its second difference.

    The change of the innovation is no test: it is also the observer's own correction of a large innovation, and attributing
    that to the encoder runs away.
    """
    none = Jump(*[jnp.zeros_like(e)] * 4)
    if on.fuzzy is False:
        return none
    unexplained = corrected - 2 * state.q1 + state.q2 - config.dt**2 * reading.qdd
    unused = at.missing | at.back | at.settling
    unexplained = jnp.where(unused, jnp.where(at.wild, reading.q - state.reading, 0.0), unexplained)  # wild ones count
    change = jnp.where(unused, 0.0, e - state.e)
    jump = takagi_sugeno.classify_jump(gains.observer, unexplained, change, b, reading.sensors)
    return either(on.fuzzy, jump, none)
