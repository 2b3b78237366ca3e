"""One tick of the controller: the block diagram of Figures 1 and 8, and Algorithm 1 line by line.

``step`` is what runs on a robot. It knows no plant, no fault and no scenario: only the reference, the encoder reading and
the torque that was commanded. What comes in has passed the door, ``schemes``.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.config import Config
from jaxftc.control import sliding_mode, surface
from jaxftc.control.last_command import Pending, commanded, holding, pack, rows
from jaxftc.diagnosis import decision, residuals, statistics
from jaxftc.gains import Gains
from jaxftc.numerics import smooth
from jaxftc.observer import cascade
from jaxftc.robot import dynamics, rigid_body
from jaxftc.stages import Stages, either
from jaxftc.stages import of as stages_of
from jaxftc.types import Array, Measurement, Output, Reference


class State(NamedTuple):
    """What the next tick needs."""

    observer: cascade.State
    statistics: statistics.State
    decision: decision.State
    pending: Pending
    psi: Array  # [n, ...] rad/s^2, fault estimate of the last tick
    q: Array  # [n, ...] rad, angle the speed was taken from
    qd: Array  # [n, ...] rad/s


def init(config: Config, gains: Gains, q: Array) -> State:
    """Controller state at rest in q [n, ...] rad, holding the arm against gravity."""
    zero, pending = jnp.zeros_like(q), holding(config.robot, q)
    return State(cascade.init(config, gains, q), statistics.init(q), decision.init(q), pending, zero, q, zero)


def step(
    config: Config,
    gains: Gains,
    state: State,
    reference: Reference,
    measurement: Measurement,
    stages: Stages | None = None,
) -> tuple[State, Output]:
    """One controller tick: pure, and differentiable in everything but the verdict. Algorithm 1.

    ``stages`` are the config's unless they are given as data.
    """
    robot = config.robot
    on = stages_of(config) if stages is None else stages

    drive, qdd, believed = _commanded(config, state, measurement.tau)  # Eqs. (2), (3)
    observer = cascade.drive(gains, state.observer, drive)  # line 1
    observer, seen = cascade.explain(  # lines 2 to 4, 7
        config, gains, observer, measurement.q, believed, state.decision.doubt, on
    )
    at = rigid_body.pose(robot, seen.q_hat)
    mass = dynamics.nominal_mass(robot, at)
    residual = residuals.generate(mass, seen.psi, seen.y, seen.y_hat)  # line 5
    observer = cascade.adapt(gains, observer, seen, residual.tau, on)

    q, acceleration = either(on.raw, (seen.y, qdd), (seen.q_hat, believed))
    qd = surface.speed(gains.control.speed_weight, state.qd, acceleration, state.q + seen.shift, q, config.dt)
    sliding_surface = surface.surface(gains.control, q, qd, reference)
    fault = seen.psi if config.input == "rigid_body" else jnp.zeros_like(q)  # see _commanded
    command = sliding_mode.law(config, gains.control, sliding_surface, q, fault, reference, on)  # lines 10 to 12
    tau = dynamics.nominal_torque(robot, at if on.raw is False else rigid_body.pose(robot, q), qd, command.qdd)
    tau = tau + dynamics.coulomb(robot, reference.qd)  # at the wanted speed: the estimate's noise would throw it to and fro

    judged = either(on.fuzzy, seen.b, residual.q)  # b is the cleaner one where there is one
    real = residuals.torque(mass, decision.trusted(state.decision, seen.psi))
    coming = decision.trusted(state.decision, gains.diagnosis.lead * seen.e)
    ahead = residuals.torque(mass, coming)  # what psi has yet to take up
    statistic, (s_tau, s_q) = statistics.step(gains.diagnosis, state.statistics, real + ahead, judged)  # line 6
    decided, verdict = decision.step(config, gains, state.decision, s_tau, s_q, real, seen, qd)  # lines 8, 9

    output = Output(
        tau=smooth.saturate(tau, rigid_body.trailing_constant(robot.torque_limit, tau)),
        fault_tau_hat=residual.tau,
        fault_q_hat=seen.fault,
        residual_tau=residual.tau,
        residual_q=residual.q,
        statistic_tau=s_tau,
        statistic_q=s_q,
        threshold_tau=jnp.broadcast_to(gains.diagnosis.alpha_tau, tau.shape),
        threshold_q=jnp.broadcast_to(gains.diagnosis.alpha_q, tau.shape),
        verdict=verdict,
        detected=(verdict > 0).any(0),
        suspect=decided.doubt.suspect,
        q_hat=seen.q_hat,
        qd_hat=qd,
        s=sliding_surface.s,
        alpha_online=command.alpha_online,
    )
    pending = Pending(tau, command.qdd, pack(mass, tau))
    return State(observer, statistic, decided, pending, seen.psi, q, qd), output


def _commanded(config: Config, state: State, tau: Array) -> tuple[Array, Array, Array]:
    """Input of the ARX model, and accelerations [n, ...] rad/s^2 of the last tick without and with the estimated fault.

    The psi of ``input="torque"`` stands for all that a constant inertia leaves out, gravity first, which the nominal arm
    knows: it is no fault to believe in.
    """
    tau, qdd = commanded(config.robot, state.pending, tau)
    if config.input == "torque":
        return tau + residuals.torque(rows(state.pending.mass), state.psi), qdd, qdd
    return qdd + state.psi, qdd, qdd + state.psi
