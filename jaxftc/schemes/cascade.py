"""One tick of the controller: the block diagram of Figures 1 and 8, and Algorithm 1 line by line.

``step`` is what runs on a robot. It knows no plant, no fault and no scenario: only the reference, the encoder reading and
the torque that was commanded. What comes in has been checked by ``registry``.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.control import compensation, fuzzy_gain, last_command, sliding_mode
from jaxftc.control.last_command import LastCommand
from jaxftc.diagnosis import contact, decision, residuals, sensor_check, statistics, threshold
from jaxftc.gains import NAMES, Gains
from jaxftc.numerics import smooth
from jaxftc.observer import adaptation, cascade, super_twisting, takagi_sugeno
from jaxftc.observer.cascade import Estimate
from jaxftc.robot import dynamics, lanes, rigid_body
from jaxftc.robot.mass_matrix import MassMatrix
from jaxftc.stages import Stages, either
from jaxftc.stages import of as stages_of
from jaxftc.types import Array, Measurement, Output, Reference, SensorStatus

DIAGNOSES, STAGED, LEARNS = True, True, True


class State(NamedTuple):
    """What the next tick needs."""

    observer: cascade.State
    statistics: statistics.State
    decision: decision.State
    control: sliding_mode.State
    sensors: SensorStatus
    command: LastCommand
    psi: Array  # [n, ...] rad/s^2, fault estimate of the last tick
    compensation: compensation.State
    adaptation: adaptation.State | None = None  # where the arm is learned

    @property
    def q(self) -> Array:
        """Angle [n, ...] rad that the arm was taken to be at."""
        return self.control.q

    @property
    def unread(self) -> Array:
        """Ticks [n, ...] since a reading was last used."""
        return jnp.maximum(self.observer.unread, 0.0)

    @property
    def tau(self) -> Array:
        """Last command [n, ...] N m, before the limits."""
        return self.command.tau


class Found(NamedTuple):
    """What blocks 5 to 7 find."""

    residual: residuals.Residuals
    threshold_tau: Array  # [n, ...] N m
    statistic: statistics.Statistics
    decision: decision.Decision
    contact: contact.Found


class Arm(NamedTuple):
    """The nominal arm at the angle that the control law sees."""

    pose: rigid_body.Pose
    mass: MassMatrix


class Applied(NamedTuple):
    """What the last command did to the arm, Eqs. (2), (3)."""

    u: Array  # [n, ...] input of the ARX model: rad/s^2, or N m for ``input="torque"``
    qdd: Array  # [n, ...] rad/s^2, without the estimated fault
    qdd_hat: Array  # [n, ...] rad/s^2, with what was compensated


def gains_used(config: Config) -> set[str]:
    """Names of the gains that the config's stages read."""
    on = stages_of(config)
    unused = {name for name in NAMES if name.startswith("baseline.")}
    unused |= {"diagnosis.rate", "diagnosis.fast", "diagnosis.stiction"}
    unused |= set() if on.fuzzy else set(takagi_sugeno.GAINS)
    unused |= set() if on.sliding else set(super_twisting.GAINS)
    unused |= set() if on.online else set(fuzzy_gain.GAINS)
    unused |= set() if on.fuzzy and config.input == "rigid_body" else set(compensation.GAINS)
    unused |= set() if config.adaptive else {name for name in NAMES if name.startswith("adaptation.")}
    return set(NAMES) - unused - {"control.alpha_sm2" if on.raw else "control.alpha_sm"}


def init(config: Config, gains: Gains, q: Array) -> State:
    """Controller state at rest in q [n, ...] rad, holding the arm against gravity."""
    return State(
        observer=cascade.init(config, gains, q),
        statistics=statistics.init(config, gains, q),
        decision=decision.init(config, gains, q),
        control=sliding_mode.init(config, gains, q),
        sensors=sensor_check.nothing_found(q),
        command=last_command.hold(config.robot, q),
        psi=jnp.zeros_like(q),
        compensation=compensation.init(config, gains, q),
        adaptation=adaptation.init(config, gains, q) if config.adaptive else None,
    )


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
    on = stages_of(config) if stages is None else stages
    applied = _applied(config, state, measurement.tau)  # Eqs. (2), (3)
    observer = cascade.apply_input(gains, state.observer, applied.u)  # line 1
    observer, seen = cascade.correct(config, gains, observer, _reading(state, applied, measurement), on)  # lines 2 to 4, 7
    arm = _arm(config, seen, on)
    residual = residuals.generate(arm.mass, seen)  # line 5
    level = threshold.of_reference(config.robot, gains.diagnosis, reference)
    observer = cascade.adapt(config, gains, observer, seen, residual.tau, level, on)
    known, psi = compensation.step(config, gains, state.compensation, _to_compensate(config, gains, state.sensors, seen, on))
    control, law = sliding_mode.step(config, gains, state.control, _to_control(applied, seen, psi, reference, on))
    learning, learned = _learn(config, gains, state, arm, seen, law, psi, reference)
    command = _command(config, arm, law, reference, learned)  # lines 10 to 12
    means, decided, found = _diagnose(config, gains, state, arm, seen, residual, level, law.qd_hat, applied.qdd, learned, on)
    state = State(observer, means, decided, control, found.decision.sensors, command, seen.psi, known, learning)
    return state, _report(config, gains, seen, found, law, command)


def _reading(state: State, applied: Applied, measurement: Measurement) -> cascade.Reading:
    return cascade.Reading(measurement.q, applied.qdd_hat, state.sensors)


def _arm(config: Config, seen: Estimate, on: Stages) -> Arm:
    pose = rigid_body.pose(config.robot, either(on.raw, seen.y, seen.q_hat))
    return Arm(pose, dynamics.nominal_mass(config.robot, pose))


@box("What the last command did, Eqs. (2), (3)")
def _applied(config: Config, state: State, tau: Array) -> Applied:
    """Input of the ARX model, and accelerations of the last tick without and with the estimated fault.

    The psi of ``input="torque"`` stands for all that a constant inertia leaves out, gravity first, which the nominal arm
    knows: it is no fault to count on.
    """
    qdd = last_command.applied_acceleration(state.command, tau)
    if config.input == "torque":
        return Applied(tau + MassMatrix.unpacked(state.command.mass).matvec(state.psi), qdd, qdd)
    u = qdd + state.psi
    return Applied(u, qdd, u + state.compensation.ahead)


def _to_compensate(config: Config, gains: Gains, sensors: SensorStatus, seen: Estimate, on: Stages) -> compensation.Inputs:
    """What is known of the actuator fault.

    The innovation of a reading that is suspect or faulty says nothing sure of it: one that has stopped shows no motion. Nor
    does that of an observer without an estimate of encoder faults.
    """
    zero = jnp.zeros_like(seen.psi)
    if config.input == "torque":  # see _applied
        return compensation.Inputs(zero, zero)
    left = jnp.where(jnp.abs(seen.b) < gains.observer.jump, adaptation.not_in_psi(config, gains) * seen.e, 0.0)
    return compensation.Inputs(seen.psi, either(on.fuzzy, sensor_check.mask_suspect(sensors, left), zero))


def _to_control(applied: Applied, seen: Estimate, psi: Array, reference: Reference, on: Stages) -> sliding_mode.Inputs:
    """What the control law sees: the reading as it comes, or both faults taken out."""
    q, acceleration = either(on.raw, (seen.y, applied.qdd), (seen.q_hat, applied.qdd_hat))
    return sliding_mode.Inputs(q, acceleration, seen.model_reset, psi, reference, on)


def _learn(
    config: Config,
    gains: Gains,
    state: State,
    arm: Arm,
    seen: Estimate,
    law: sliding_mode.Command,
    psi: Array,
    reference: Reference,
) -> tuple[adaptation.State | None, adaptation.Correction | None]:
    """What the cascade finds wrong with the arm's model, where that is learned."""
    if state.adaptation is None:
        return None, None
    alarms = state.decision.alarm
    inputs = adaptation.Inputs(
        torque=arm.mass.matvec(seen.psi + adaptation.not_in_psi(config, gains) * seen.e),
        qd=law.qd_hat,
        alarmed=alarms.tau + alarms.q + state.sensors.suspect > 0,
        columns=adaptation.columns(config, gains, arm.pose, law.qd_hat, law.qdd + psi, reference.qd),
    )
    return adaptation.step(config, gains, state.adaptation, inputs)


@box("The command, Algorithm 1, lines 10 to 12")
def _command(
    config: Config,
    arm: Arm,
    law: sliding_mode.Command,
    reference: Reference,
    learned: adaptation.Correction | None,
) -> LastCommand:
    """Torque before the limits that makes the commanded acceleration, by one Newton-Euler pass."""
    robot = config.robot
    tau = dynamics.nominal_torque(robot, arm.pose, law.qd_hat, law.qdd)
    tau = tau + dynamics.coulomb(robot, reference.qd)  # at the wanted speed: the estimate's noise would throw it to and fro
    tau = tau if learned is None else tau + learned.tau
    return LastCommand(tau, law.qdd, arm.mass.packed(tau))


def _diagnose(
    config: Config,
    gains: Gains,
    state: State,
    arm: Arm,
    seen: Estimate,
    residual: residuals.Residuals,
    level: Array,
    qd: Array,
    qdd: Array,
    learned: adaptation.Correction | None,
    on: Stages,
) -> tuple[statistics.State, decision.State, Found]:
    """Blocks 6 and 7: statistics against thresholds ``level`` [n, ...] N m, each joint's verdict, and a contact of several.

    qd [n, ...] rad/s is the speed, qdd [n, ...] rad/s^2 the acceleration without the estimated fault.
    """
    real, watched = _watched(gains, state.sensors, arm.mass, seen, residual, on)
    means, statistic = statistics.step(config, gains, state.statistics, watched)  # line 6
    if learned is not None:  # less what may still be the model's
        statistic = statistic._replace(tau=learned.trust * statistic.tau)
    inputs = decision.Inputs(statistic, level, real, seen, qd, qdd, residual.tau)
    decided, said = decision.step(config, gains, state.decision, inputs)  # lines 8, 9
    judged = contact.judge(config, contact.Inputs(arm.pose, statistic.tau, level, said.verdict))
    return means, decided, Found(residual, level, statistic, said, judged)


@box("Block 6: what is watched")
def _watched(
    gains: Gains,
    sensors: SensorStatus,
    mass: MassMatrix,
    seen: Estimate,
    residual: residuals.Residuals,
    on: Stages,
) -> tuple[Array, statistics.Inputs]:
    """Torque residual [n, ...] N m of the joints whose readings are in order, and what the statistics are made of.

    lead e is what psi has yet to take up; b is the cleaner encoder residual where there is one.
    """
    real = mass.matvec(sensor_check.mask_suspect(sensors, seen.psi))
    ahead = mass.matvec(sensor_check.mask_suspect(sensors, gains.diagnosis.lead * seen.e))
    return real, statistics.Inputs(real + ahead, either(on.fuzzy, seen.b, residual.q))


@box("The command within the torque limits")
def _report(
    config: Config,
    gains: Gains,
    seen: Estimate,
    found: Found,
    law: sliding_mode.Command,
    command: LastCommand,
) -> Output:
    """What the tick says."""
    tau, residual, statistic, judged = command.tau, found.residual, found.statistic, found.contact
    return Output(
        tau=smooth.saturate(tau, lanes.trailing_constant(config.robot.torque_limit, tau)),
        fault_tau_hat=residual.tau,
        fault_q_hat=seen.fault_q,
        residual_tau=residual.tau,
        residual_q=residual.q,
        statistic_tau=statistic.tau,
        statistic_q=statistic.q,
        threshold_tau=found.threshold_tau,
        threshold_q=jnp.broadcast_to(gains.diagnosis.alpha_q, tau.shape),
        verdict=judged.verdict,
        detected=(judged.verdict > 0).any(0),
        suspect=found.decision.sensors.suspect,
        q_hat=seen.q_hat,
        qd_hat=law.qd_hat,
        s=law.s,
        alpha_online=law.alpha_online,
        force=judged.force,
        unsure=found.decision.unsure,
    )
