"""Extended Kalman filter with bias states, and computed torque.

The state of n joints is x = (q, qd, tau_f, b): angle, speed, actuator fault and encoder fault, the faults as random walks,

    (M + T D) qdd = tau + tau_f - h - D qd - f_c(qd),   qd+ = qd + T qdd,   q+ = q + T qd+,   y = q + b + noise.

Source: Simon, Optimal State Estimation, 2006, 13.2 (EKF), 5.1 (Joseph form); Friedland, Treatment of bias in recursive
filtering, IEEE T-AC 14(4), 1969 (bias states). The integrator is the plant's. The Jacobian is exact: with qdd held in
g = M qdd + h + D qd + f_c, (M + T D) d qdd = d tau_f - dg, and dg comes by forward mode. F and H are used by their blocks.

What it cannot know: q and b are told apart by the model alone, q + c and b - c read the same. An encoder that jumps far
beyond what ``walk_b`` allows is taken for a torque at first. A reading that does not come is predicted and not reported.
A leap beyond ``SPIKE`` waits for the next reading. Many leaps within a tenth of a second that no joint makes are no random
walk: such readings are not used, and when they have ended, nothing that was made of them is kept: the belief starts anew.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.control.last_command import LastCommand, applied_acceleration, hold
from jaxftc.diagnosis import alarm, decision, threshold
from jaxftc.diagnosis.sensor_check import JUMP_MEMORY, MANY_JUMPS
from jaxftc.diagnosis.statistics import Statistics
from jaxftc.gains import BaselineGains, Gains
from jaxftc.robot import dynamics, reach, rigid_body
from jaxftc.robot.mass_matrix import MassMatrix
from jaxftc.schemes import computed_torque
from jaxftc.schemes.output import output
from jaxftc.types import Array, Measurement, Output, Reference

DIAGNOSES = True
NOISES = ("baseline.noise_y", "baseline.walk_qd", "baseline.walk_psi", "baseline.walk_b")


SPIKE = 0.3  # rad in a tick, more than any bias that is worth a look before it has lasted


class Belief(NamedTuple):
    """Gaussian belief in the arm's state."""

    mean: Array  # [4n, ...]: q rad, qd rad/s, tau_f N m, b rad
    cov: Array  # [4n, 4n, ...]


class State(NamedTuple):
    """What the next tick needs."""

    belief: Belief
    unread: Array  # [n, ...] ticks since a reading was last used
    reading: Array  # [n, ...] rad, last one
    leaps: Array  # [n, ...] leaky count of those that no joint makes
    alarm: alarm.State
    command: LastCommand

    @property
    def q(self) -> Array:
        """Angle [n, ...] rad."""
        return parts(self.belief.mean)[0]

    @property
    def tau(self) -> Array:
        """Last command [n, ...] N m, before the limits."""
        return self.command.tau


def gains_used(config: Config) -> set[str]:
    """Names of the gains that this scheme reads."""
    del config
    return {*computed_torque.TRACKING, *NOISES, "diagnosis.alpha_tau", "diagnosis.alpha_q", *threshold.GAINS}


def init(config: Config, gains: Gains, q: Array) -> State:
    """No fault, at rest in q [n, ...] rad."""
    zero = jnp.zeros_like(q)
    return State(at_rest(gains.baseline, q), zero, q, zero, alarm.init(config, gains, q), hold(config.robot, q))


def step(config: Config, gains: Gains, state: State, reference: Reference, measurement: Measurement) -> tuple[State, Output]:
    """Predict, correct, judge both fault states, track with both taken out."""
    qdd = applied_acceleration(state.command, measurement.tau)
    leap = jnp.abs(measurement.q - state.reading) > reach.SPEED * config.dt
    leaps = JUMP_MEMORY * state.leaps + leap
    wild = leaps >= MANY_JUMPS
    used = jnp.where(wild | (jnp.abs(measurement.q - state.reading) > SPIKE), jnp.nan, measurement.q)
    belief = correct(gains.baseline, predict(config, gains.baseline, state.belief, measurement.tau), used)
    last = jnp.where(jnp.isfinite(measurement.q), measurement.q, state.reading)
    over = ((state.leaps >= MANY_JUMPS) & ~wild).any(0)
    belief = jax.tree.map(lambda new, old: jnp.where(over, new, old), at_rest(gains.baseline, last), belief)
    q, qd, fault_tau, fault_q = parts(belief.mean)
    qd = qd + 0.5 * config.dt * qdd  # q+ - q = T qd+: the integrator's speed is that of half a tick ago (control/surface.py)
    command = computed_torque.law(config, gains, q, qd, reference, fault_tau)

    level = threshold.of_reference(config.robot, gains.diagnosis, reference)
    own, alarms = alarm.step(config, gains, state.alarm, alarm.Inputs(Statistics(fault_tau, fault_q), level))
    said = output(
        config,
        command.tau,
        q,
        qd,
        threshold_tau=level,
        threshold_q=gains.diagnosis.alpha_q,
        fault_tau=fault_tau,
        fault_q=fault_q,
        verdict=decision.verdict(alarms.tau, alarms.q),
    )
    unread = jnp.where(jnp.isfinite(used), 0.0, state.unread + 1)
    return State(belief, unread, last, leaps, own, command), said


def at_rest(gains: BaselineGains, q: Array) -> Belief:
    """Belief that the arm stands still in q [n, ...] rad: the angle known as well as a reading, the rest for sure."""
    zero = jnp.zeros_like(q)
    cov = diagonal(jnp.broadcast_to(gains.noise_y**2, q.shape), zero, zero, zero)
    return Belief(jnp.concatenate([q, zero, zero, zero]), cov)


@box("Extended Kalman filter: prediction")
def predict(config: Config, gains: BaselineGains, belief: Belief, tau: Array) -> Belief:
    """Belief one tick later under a torque [n, ...] N m: F P F^T + Q."""
    robot, dt = config.robot, config.dt
    q, qd, fault_tau, b = parts(belief.mean)
    at = rigid_body.pose(robot, q)
    mass = dynamics.nominal_mass(robot, at)
    inertia = mass.diagonal(q)
    mass = mass.plus_diagonal(
        [dt * float(damping) for damping in robot.damping]
    )  # friction acts implicitly, as in the plant
    bias = dynamics.nominal_torque(robot, at, qd, jnp.zeros_like(qd)) + dynamics.coulomb(robot, qd)
    qdd = mass.solve(tau + fault_tau - bias)

    def torque(q: Array, qd: Array) -> Array:
        return dynamics.nominal_torque(robot, rigid_body.pose(robot, q), qd, qdd) + dynamics.coulomb(robot, qd)

    unit = jnp.broadcast_to(identity(config.n, q.ndim - 1).astype(q.dtype), (config.n, *q.shape))
    none = jnp.zeros_like(unit)
    seeds = jnp.concatenate([unit, none]), jnp.concatenate([none, unit])  # each angle, then each speed
    change = -jax.vmap(lambda *seed: jax.jvp(torque, (q, qd), seed)[1], out_axes=1)(*seeds)
    change = jnp.concatenate([change, unit], axis=1)  # [n, 3n, ...] of torque with (q, qd, tau_f)
    slope = dt * mass.solve(change)  # [n, 3n, ...] of qd+ - qd

    def push(columns: Array) -> Array:
        """F times columns [4n, m, ...]."""
        at_q, at_qd, at_tau, at_b = parts(columns)
        at_qd = at_qd + product(slope, columns[: 3 * config.n])
        return jnp.concatenate([at_q + dt * at_qd, at_qd, at_tau, at_b])

    qd = jnp.clip(qd + dt * qdd, -reach.SPEED, reach.SPEED)
    mean = jnp.concatenate([q + dt * qd, qd, fault_tau, b])
    walks = (0.0, gains.walk_qd, gains.walk_psi * inertia, gains.walk_b)
    grown = diagonal(*(jnp.broadcast_to(dt * walk**2, q.shape) for walk in walks))  # Q
    return Belief(mean, push(push(belief.cov).swapaxes(0, 1)) + grown)


@box("Extended Kalman filter: correction")
def correct(gains: BaselineGains, belief: Belief, reading: Array) -> Belief:
    """Belief after a reading [n, ...] rad, in Joseph's form; a joint without one is not corrected by its own.

    (I - K H) P (I - K H)^T + K R K^T stays positive whatever rounding does to K.
    """
    n = reading.shape[0]
    q, _, _, b = parts(belief.mean)
    missing = ~jnp.isfinite(reading)
    e = jnp.where(missing, 0.0, reading - q - b)
    noise = jnp.broadcast_to(gains.noise_y**2, q.shape)  # R
    both = read(belief.cov)  # H P, [n, 4n, ...]
    spread = read(both.swapaxes(0, 1))  # H P H^T, [n, n, ...]
    spread = jnp.where(missing[:, None] | missing[None], 0.0, spread)
    spread = spread + jnp.where(identity(n, q.ndim - 1), jnp.where(missing, 1.0, noise)[None], 0.0)
    gain = MassMatrix.of(spread).solve(jnp.where(missing[:, None], 0.0, both))  # K^T, [n, 4n, ...]
    mean = belief.mean + (gain * e[:, None]).sum(0)
    half = belief.cov - outer(gain, both)  # (I - K H) P
    cov = half + outer(noise[:, None] * gain - read(half.swapaxes(0, 1)), gain)
    return Belief(mean, 0.5 * (cov + cov.swapaxes(0, 1)))


def parts(rows: Array) -> list[Array]:
    """Rows [4n, ...] of q, qd, tau_f and b, [n, ...] each."""
    return jnp.split(rows, 4)


def read(rows: Array) -> Array:
    """H times rows [4n, ...]: y = q + b."""
    q, _, _, b = parts(rows)
    return q + b


def diagonal(*blocks: Array) -> Array:
    """Diagonal matrix [4n, 4n, ...] of four blocks [n, ...]."""
    entries = jnp.concatenate(blocks)
    return jnp.where(identity(entries.shape[0], entries.ndim - 1), entries[None], 0.0)


def identity(size: int, axes: int) -> Array:
    """Where a matrix [size, size] has its diagonal, with singleton scenario axes."""
    return jnp.eye(size, dtype=bool).reshape(size, size, *[1] * axes)


def product(left: Array, right: Array) -> Array:
    """[a, b, ...] times [b, c, ...]: scenario axes stay whole, where a batched matrix product goes one by one."""
    return sum((left[:, j, None] * right[None, j] for j in range(1, right.shape[0])), left[:, 0, None] * right[None, 0])


def outer(left: Array, right: Array) -> Array:
    """Sum over j of left[j] right[j]^T, [a, b, ...] from [j, a, ...] and [j, b, ...]."""
    return (left[:, :, None] * right[:, None]).sum(0)
