"""The whole controller as most people write it: NumPy for the cascade, MuJoCo C for the nominal arm's mass and bias.

The same tick as ``jaxftc.step`` with the default structure (T-S observer, AFESMC, rigid-body input, smooth sign); a test
holds the two together. Nothing is done twice, and what a saturated torque alone needs is left out when none is.
"""

from __future__ import annotations

import copy

import jax
import mujoco
import numpy as np

from benchmarks.peers.numpy_observer import Observer, Seen
from jaxftc.config import Config
from jaxftc.control.compensation import MOST
from jaxftc.diagnosis import alarm, sensor_check
from jaxftc.fuzzy.rule_table import TABLES
from jaxftc.gains import Gains

Array = np.ndarray


def coulomb(config: Config, qd: Array) -> Array:
    """Coulomb friction [n] N m."""
    robot, t = config.robot, np.tanh(qd / config.robot.coulomb_speed)
    plus, minus = robot.coulomb_positive, robot.coulomb_negative
    return 0.5 * ((plus + minus) * t + (plus - minus) * t * t)


class Controller:
    """One arm's controller, at rest in q [n] rad."""

    def __init__(self, config: Config, gains: Gains, q: Array) -> None:
        default = config.scheme, config.observer, config.control, config.input, config.sign
        if default != ("cascade", "ts", "afesmc", "rigid_body", "smooth"):
            raise ValueError(f"the NumPy controller has the default structure only, got {default}")
        n, gains = config.n, jax.tree.map(lambda leaf: np.asarray(leaf, float), gains)
        self.config, self.gains, self.observer = config, gains, Observer(config, gains, q)
        self.share = -np.expm1(-gains.control.rate * config.dt)  # of what psi leaves, in a tick
        self.weight = gains.observer.alpha_p * ((1 - gains.arx.xi_a) / config.dt) ** 2
        self.levels = gains.control.outputs[TABLES[config.rules]]
        self.model = copy.deepcopy(config.robot.mj_model)
        self.data, self.mass, self.bias = mujoco.MjData(self.model), np.zeros((n, n)), np.zeros(n)
        zero = np.zeros(n)
        self.psi, self.ahead, self.q, self.qd, self.qdd, self.z_tau, self.z_q = zero, zero, q, zero, zero, zero, zero
        self.tau = self._dynamics(q, zero, zero)
        self.verdict = np.zeros(n, int)
        self.tau_on, self.q_on, self.transient, self.frozen, self.noisy, self.suspect = np.zeros((6, n), bool)
        self.tau_run, self.q_run, self.age, self.peak, self.quiet, self.jumps, self.signed, self.equal = np.zeros((8, n))
        self.last, self.speed, self.travel = q, zero, zero

    def step(self, q_ref: Array, qd_ref: Array, qdd_ref: Array, reading: Array, tau: Array) -> Array:
        """Command [n] N m from the reference, the reading [n] rad and the torque that was commanded; Algorithm 1."""
        config, c, d, dt = self.config, self.gains.control, self.gains.diagnosis, self.config.dt
        qdd = self.qdd
        if (tau != self.tau).any():  # the limits cut it
            qdd = qdd + np.linalg.solve(self.mass, tau - self.tau)
        u = qdd + self.psi
        self.applied, qdd_hat = qdd, u + self.ahead
        seen = self.observer.explain(reading, u, qdd_hat, self.transient, self.frozen, self.noisy)
        q = self.observer.q1
        left = np.where(self.suspect | (np.abs(self.observer.b) >= self.gains.observer.jump), 0.0, self.weight * seen.e)
        ahead = self.ahead + self.share * (left - self.ahead)
        self.ahead = np.minimum(np.maximum(ahead, -MOST), MOST)

        measured = (q - self.q - seen.shift) / dt + 0.5 * dt * qdd_hat
        predicted = self.qd + dt * qdd_hat
        qd = predicted + c.speed_weight * (measured - predicted)
        errord = qd - qd_ref
        s = c.lam * (q - q_ref) + errord  # Eq. (19)
        switching = c.alpha_sm2 * np.maximum(self._gain(q, s), c.floor) * np.tanh(s / c.eps)
        qdd = qdd_ref - c.lam * errord - c.k_b * s - switching - seen.psi - self.ahead  # Eq. (30)
        command = self._dynamics(q, qd, qdd) + coulomb(config, qd_ref)

        self.observer.adapt(seen, self.mass @ seen.psi)
        trust = ~self.suspect
        real = self.mass @ (trust * seen.psi)
        r_tau, r_q = real + self.mass @ (trust * d.lead * seen.e), self.observer.b
        s_tau = d.lam_tau * r_tau + (1 - d.lam_tau) * self.z_tau  # Eq. (14)
        s_q = d.lam_q * r_q + (1 - d.lam_q) * self.z_q
        self.z_tau = self.z_tau + d.leak_tau * (r_tau - self.z_tau)
        self.z_q = self.z_q + d.leak_q * (r_q - self.z_q)
        self._decide(s_tau, s_q, real, seen, qd)
        self.tau, self.qdd, self.psi, self.q, self.qd = command, qdd, seen.psi, q, qd
        return np.minimum(np.maximum(command, -config.robot.torque_limit), config.robot.torque_limit)

    def _dynamics(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Torque of the nominal arm for an acceleration; leaves M(q) in ``self.mass``."""
        m, data = self.model, self.data
        data.qpos[:], data.qvel[:] = q, qd
        mujoco.mj_kinematics(m, data)
        mujoco.mj_comPos(m, data)
        mujoco.mj_makeM(m, data)
        mujoco.mj_fullM(m, data, self.mass)
        mujoco.mj_comVel(m, data)
        mujoco.mj_rne(m, data, 0, self.bias)
        return self.mass @ qdd + self.bias + self.config.robot.damping * qd

    def _gain(self, q: Array, s: Array) -> Array:
        """Centre average of the 49 rules of Table 1, Eq. (33)."""
        c, shares = self.gains.control, []
        for x, centres, widths in ((q, c.q_centres, c.q_widths), (s, c.s_centres, c.s_widths)):
            apart = (np.minimum(np.maximum(x, centres[0]), centres[-1]) - centres[:, None]) / widths[:, None]
            grade = np.exp(-0.5 * apart * apart)
            shares.append(grade / grade.sum(0))
        return (shares[0] * (self.levels @ shares[1])).sum(0)

    def _decide(self, s_tau: Array, s_q: Array, r_tau: Array, seen: Seen, qd: Array) -> None:
        """Alarms, sensor check and verdict, Eqs. (17), (18)."""
        config, level = self.config, self.gains.diagnosis
        was_on = self.tau_on
        self.tau_on, self.tau_run = _alarm(s_tau, level.alpha_tau, was_on, self.tau_run, config.alarm_ticks, config)
        self.q_on, self.q_run = _alarm(s_q, level.alpha_q, self.q_on, self.q_run, 1, config)
        alarmed, size = was_on | self.tau_on, np.abs(r_tau)
        self.age = np.where(alarmed, self.age + 1, 0.0)
        self.peak = np.where(alarmed, np.maximum(self.peak, size), 0.0)
        fallen = ~self.tau_on | (size < sensor_check.FALLEN * self.peak)
        excess = self.peak / level.alpha_tau
        now = was_on & (self.age < config.transient_ticks) & fallen & (excess >= excess.max())
        self.quiet = np.where(self.tau_on | self.q_on, 0.0, self.quiet + 1)
        self.transient = now | (self.transient & (self.quiet < round(sensor_check.TRANSIENT_MEMORY / config.dt)))
        self.jumps = sensor_check.JUMP_MEMORY * self.jumps + seen.h_s
        self.signed = sensor_check.JUMP_MEMORY * self.signed + seen.h_s * seen.side
        unchanged = seen.missing | (seen.y == self.last)
        stepped = np.abs(seen.y - self.last) / (config.dt * (self.equal + 1))
        changed = np.where(self.equal > 0, np.minimum(np.maximum(qd, -stepped), stepped), qd)
        ahead = self.speed + config.dt * self.applied
        ahead = np.where(ahead * self.speed > 0, ahead, 0.0)
        self.travel = np.where(unchanged, self.travel + config.dt * np.abs(self.speed), 0.0)
        self.equal = np.where(unchanged, self.equal + 1, 0.0)
        self.speed, self.last = np.where(unchanged, ahead, changed), seen.y
        moved = self.travel > self.gains.observer.jump
        self.frozen = (self.equal >= sensor_check.FROZEN_READINGS) & (moved | seen.absent)
        many = self.jumps >= sensor_check.MANY_JUMPS
        self.noisy = many & (np.abs(self.signed) < 0.5 * self.jumps)
        self.suspect = self.frozen | many | self.transient
        self.verdict = (self.tau_on & ~self.suspect) + 2 * (self.q_on | self.suspect)


def _alarm(s: Array, alpha: Array, on: Array, run: Array, rise: int, config: Config) -> tuple[Array, Array]:
    """Two-level switch with persistence."""
    size = np.abs(s)
    run = np.where(np.where(on, size < alarm.RELEASE * alpha, size >= alpha), run + 1, 0.0)
    flips = run >= np.where(on, config.release_ticks, rise)
    return on ^ flips, np.where(flips, 0.0, run)
