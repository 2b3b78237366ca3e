"""What most people write: one arm, a Python loop, ``mj_step`` for the plant, the controller in NumPy."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from benchmarks.peers.mujoco_c import timed_model
from benchmarks.peers.numpy_controller import Controller, coulomb
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.scenarios.scenario import Scenario

Array = np.ndarray


class Run(NamedTuple):
    """A run, time first."""

    q: Array  # [T, n] rad, true angle
    tau: Array  # [T, n] N m, command
    verdict: Array  # [T, n]


def simulate(config: Config, gains: Gains, scenario: Scenario, noise: Array) -> Run:
    """One scenario with biases as faults, abrupt, on the nominal arm; encoder noise [T, n] rad."""
    n, ticks, limit = config.n, config.ticks, config.robot.torque_limit
    start, goal = (np.asarray(q, float) for q in (scenario.q_start, scenario.q_goal))
    faults = scenario.fault_tau, scenario.fault_q
    biases = [np.asarray(f.magnitude, float) * (np.asarray(f.kind) > 0) for f in faults]
    windows = [[np.round(np.asarray(end, float) / config.dt) for end in (f.onset, f.clear)] for f in faults]  # ticks
    model = timed_model(config.robot, config.dt)
    data = mujoco.MjData(model)
    data.qpos[:] = start
    controller = Controller(config, gains, start)
    tau = np.clip(controller.tau, -limit, limit)
    run = Run(np.zeros((ticks, n)), np.zeros((ticks, n)), np.zeros((ticks, n), int))
    for k in range(ticks):
        t = k * config.dt
        delivered, angle = (bias * ((k >= low) & (k <= high)) for bias, (low, high) in zip(biases, windows, strict=True))
        share, moving = min(t / config.t_final, 1.0), t < config.t_final
        q_ref = start + (goal - start) * (3 * share**2 - 2 * share**3)
        qd_ref = (goal - start) * (6 * share - 6 * share**2) / config.t_final
        qdd_ref = moving * (goal - start) * (6 - 12 * share) / config.t_final**2
        run.q[k] = data.qpos
        tau = controller.step(q_ref, qd_ref, qdd_ref, data.qpos + noise[k] + angle, tau)
        data.qfrc_applied[:] = tau + delivered - coulomb(config, data.qvel)
        mujoco.mj_step(model, data)
        run.tau[k], run.verdict[k] = tau, controller.verdict
    return run
