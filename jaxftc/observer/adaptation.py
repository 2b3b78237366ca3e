"""The arm that is learned while it runs: a payload and the friction of each joint, beside the cascade.

What the model has wrong is a torque that is linear in a few numbers phi (payload, viscous and Coulomb friction of each
joint), each in units of how far an arm is expected to differ from its model. The cascade measures that torque,

    d = M (psi + e alpha_p (1 - xi)^2 / T^2) = Y phi_used - Y phi + fault,

psi and the part of the innovation that psi has yet to take up; it lags by 2 / (1 - xi) ticks, and so Y is made to lag. phi
is the posterior mean of a linear Gaussian model with prior N(0, 1): least squares with forgetting, regularised, in
information form. A joint's row holds the payload and that joint's own friction, so the information has the shape of an
arrow, and its solution costs a Schur complement of a number.

What is sudden is a fault, so the learning waits

* while a verdict is up and HOLD after it, all joints;
* while a joint stands: friction may hold any torque there, and nothing is forgotten either;
* and a row counts as no more than what would be an alarm, so that the moments between onset and alarm count little.

phi stays in BOUND: more than that no arm differs, so a fault that is larger cannot be learned away, however long it lasts.
The posterior variance says how far the model may yet be wrong: ``trust`` is what the torque statistic counts.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.gains import Gains, align
from jaxftc.robot import dynamics, rigid_body
from jaxftc.types import Array

BOUND = 2.0  # standard deviations by which an arm differs at most
HOLD = 0.1  # s after a verdict in which nothing is learned


class Columns(NamedTuple):
    """Torque of a standard deviation of each unknown, all [n, ...] N m."""

    load: Array
    viscous: Array
    coulomb: Array


class Information(NamedTuple):
    """What the rows of each joint say, all [n, ...] 1; the load's are added up over joints."""

    ll: Array
    lv: Array
    lc: Array
    vv: Array
    vc: Array
    cc: Array
    lz: Array
    vz: Array
    cz: Array


class Estimate(NamedTuple):
    """Posterior mean, in standard deviations of the prior."""

    load: Array  # [1, ...]
    viscous: Array  # [n, ...]
    coulomb: Array  # [n, ...]


class State(NamedTuple):
    """What the next tick needs."""

    information: Information
    phi: Estimate
    columns: Columns  # of the last commands, delayed as the cascade delays
    made: Array  # [n, ...] N m, what phi has added to them, delayed in the same way
    hold: Array  # [...] s until learning may go on


class Inputs(NamedTuple):
    """What a tick takes in."""

    torque: Array  # [n, ...] N m, d
    qd: Array  # [n, ...] rad/s
    alarmed: Array  # [n, ...] bool, a verdict is up
    columns: Columns  # of the command that is being made


class Correction(NamedTuple):
    """What follows from what is known of the arm."""

    tau: Array  # [n, ...] N m, to be added to the command
    trust: Array  # [n, ...] in (0, 1], what of the torque statistic counts


class Arm(NamedTuple):
    """How the arm differs from its model, as far as that is known.

    Attributes:
        load: [...] kg, payload.
        viscous: [n, ...] 1, viscous friction over the model's, less 1.
        coulomb: [n, ...] 1, the same of Coulomb friction.
    """

    load: Array
    viscous: Array
    coulomb: Array


def init(config: Config, gains: Gains, q: Array) -> State:
    """Nothing learned yet."""
    del config, gains
    zero = jnp.zeros_like(q)
    return State(Information(*[zero] * 9), Estimate(zero[:1], zero, zero), Columns(*[zero] * 3), zero, zero[0])


@box("The arm that is learned: payload and friction")
def step(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, Correction]:
    """Take in a row of each joint; what is known with it."""
    own, alpha, y, dt = gains.adaptation, gains.diagnosis.alpha_tau, state.columns, config.dt
    sigma = own.noise * alpha
    hold = jnp.where(inputs.alarmed.any(0), HOLD, jnp.maximum(state.hold - dt, 0.0))
    moving = jnp.tanh(inputs.qd / config.robot.coulomb_speed) ** 2
    counts = jnp.where(hold > 0, 0.0, dt * moving)

    expected = _product(y, state.phi)
    z = expected + jnp.clip(state.made - inputs.torque - expected, -alpha, alpha)
    information = _take_in(state.information, y, z, counts / (own.correlation * sigma**2), jnp.exp(-counts / own.memory))
    known = posterior(information)

    tau = _product(inputs.columns, known.mean)
    share = 0.5 * (1 - gains.arx.xi_a)
    delayed = [old + share * (new - old) for old, new in zip((*y, state.made), (*inputs.columns, tau), strict=True)]
    next_state = State(information, known.mean, Columns(*delayed[:3]), delayed[3], hold)
    return next_state, Correction(tau, jax.lax.rsqrt(1 + variance(known, y) / sigma**2))


def learned(gains: Gains, state: State) -> Arm:
    """What is known of the arm, in its units.

    Args:
        gains: That it was learned with.
        state: The field ``adaptation`` of the cascade's state.

    Returns:
        Payload and friction beyond the model's.
    """
    own, phi = align(gains, state.hold.ndim).adaptation, state.phi
    return Arm((own.load * phi.load)[0], own.viscous * phi.viscous, own.coulomb * phi.coulomb)


def columns(config: Config, gains: Gains, at: rigid_body.Pose, qd: Array, qdd: Array, qd_ref: Array) -> Columns:
    """Y at a pose, speeds qd [n, ...] rad/s and accelerations qdd [n, ...] rad/s^2.

    Coulomb friction is that of the wanted speed qd_ref [n, ...] rad/s, as in the command.
    """
    own, robot = gains.adaptation, config.robot
    return Columns(
        load=own.load * dynamics.load_torque(robot, at, qd, qdd),
        viscous=own.viscous * dynamics.viscous(robot, qd),
        coulomb=own.coulomb * dynamics.coulomb(robot, qd_ref),
    )


def not_in_psi(config: Config, gains: Gains) -> Array:
    """Weight [n, ...] 1/s^2 of the innovation beside psi with which both are the whole disturbance."""
    return gains.observer.alpha_p * ((1 - gains.arx.xi_a) / config.dt) ** 2


class Posterior(NamedTuple):
    """Mean and covariance of phi: that of a joint's friction given the load, and what the load adds."""

    mean: Estimate
    vv: Array  # [n, ...] covariance of a joint's friction, given the load
    vc: Array
    cc: Array
    v: Array  # [n, ...] by which it moves with the load
    c: Array
    load: Array  # [1, ...] variance of the load


def posterior(known: Information) -> Posterior:
    """What the information and the prior N(0, 1) say, the mean within the bounds.

    What rounding could make negative of a determinant, when viscous and Coulomb friction look the same, is held at 0.
    """
    scale = 1 / (1 + known.vv + known.cc + jnp.maximum(known.vv * known.cc - known.vc**2, 0.0))
    vv, vc, cc = scale * (1 + known.cc), -scale * known.vc, scale * (1 + known.vv)
    v, c = -(vv * known.lv + vc * known.lc), -(vc * known.lv + cc * known.lc)
    left = jnp.maximum(known.ll + v * known.lv + c * known.lc, 0.0)  # of the load, the joint's friction being unknown
    load_variance = 1 / (1 + left.sum(0, keepdims=True))
    load = _bounded(load_variance * (known.lz + v * known.vz + c * known.cz).sum(0, keepdims=True))
    viscous = vv * known.vz + vc * known.cz + v * load
    coulomb = vc * known.vz + cc * known.cz + c * load
    return Posterior(Estimate(load, _bounded(viscous), _bounded(coulomb)), vv, vc, cc, v, c, load_variance)


def variance(known: Posterior, y: Columns) -> Array:
    """Variance [n, ...] (N m)^2 of the rows y."""
    friction = known.vv * y.viscous**2 + 2 * known.vc * y.viscous * y.coulomb + known.cc * y.coulomb**2
    return jnp.maximum(friction, 0.0) + known.load * (y.load + known.v * y.viscous + known.c * y.coulomb) ** 2


def _take_in(known: Information, y: Columns, z: Array, weight: Array, kept: Array) -> Information:
    """Information with a row of each joint, and z [n, ...] N m that it should give."""
    load, viscous, coulomb = (weight * column for column in y)
    rows = Information(
        ll=load * y.load,
        lv=load * y.viscous,
        lc=load * y.coulomb,
        vv=viscous * y.viscous,
        vc=viscous * y.coulomb,
        cc=coulomb * y.coulomb,
        lz=load * z,
        vz=viscous * z,
        cz=coulomb * z,
    )
    return Information(*(kept * old + new for old, new in zip(known, rows, strict=True)))


def _product(y: Columns, phi: Estimate) -> Array:
    return y.load * phi.load + y.viscous * phi.viscous + y.coulomb * phi.coulomb


def _bounded(phi: Array) -> Array:
    return jnp.clip(phi, -BOUND, BOUND)
