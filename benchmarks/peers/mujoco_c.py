"""MuJoCo C, plant only: ``mj_step`` on one thread and ``mujoco.rollout`` on several."""

from __future__ import annotations

import copy
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout

from jaxftc.robot.model import Robot

Array = np.ndarray


def timed_model(robot: Robot, dt: float) -> mujoco.MjModel:
    """The robot's model with the sample time dt s as its own."""
    model = copy.deepcopy(robot.mj_model)
    model.opt.timestep = dt
    return model


class Step:
    """``mj_step`` arm by arm on one thread, all steps of an arm in one call; torque held."""

    def __init__(self, robot: Robot, dt: float, ticks: int) -> None:
        self.model, self.ticks = timed_model(robot, dt), ticks
        self.data = mujoco.MjData(self.model)

    def __call__(self, q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
        """Last (q, qd) [n, B] from q, qd, tau [n, B]."""
        last = np.empty_like(q), np.empty_like(qd)
        for arm in range(q.shape[1]):
            mujoco.mj_resetData(self.model, self.data)
            self.data.qpos[:], self.data.qvel[:], self.data.qfrc_applied[:] = q[:, arm], qd[:, arm], tau[:, arm]
            mujoco.mj_step(self.model, self.data, self.ticks)
            last[0][:, arm], last[1][:, arm] = self.data.qpos, self.data.qvel
        return last


class Rollout:
    """``mujoco.rollout`` on a pool of threads that stays, into arrays that stay; torque held."""

    def __init__(self, robot: Robot, dt: float, ticks: int, batch: int, threads: int) -> None:
        self.model, self.n = timed_model(robot, dt), robot.n
        self.data = [mujoco.MjData(self.model) for _ in range(threads)]
        self.pool = rollout.Rollout(nthread=threads)
        size = mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self.start = np.zeros((batch, size))
        self.control = np.zeros((batch, ticks, robot.n))
        self.state = np.zeros((batch, ticks, size))

    def load(self, q: Array, qd: Array, tau: Array) -> None:
        """Lay out starts and torques [n, B] as MuJoCo wants them; not part of the time."""
        n = self.n
        self.start[:, 1 : 1 + n], self.start[:, 1 + n : 1 + 2 * n] = q.T, qd.T  # after the time
        self.control[:] = tau.T[:, None]

    def __call__(self) -> tuple[Any, Any]:
        """Every (q, qd) [B, T, n] after each step."""
        spec = mujoco.mjtState.mjSTATE_QFRC_APPLIED
        self.pool.rollout(self.model, self.data, self.start, self.control, control_spec=spec, state=self.state)
        return self.state[..., 1 : 1 + self.n], self.state[..., 1 + self.n : 1 + 2 * self.n]

    def close(self) -> None:
        """End the threads."""
        self.pool.close()
