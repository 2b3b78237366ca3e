"""MuJoCo MJX as it comes: ``mjx.step`` in ``jit(vmap(scan))`` with XLA's own options, plant only."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.peers.mujoco_c import timed_model
from jaxftc.robot import mjx as engine
from jaxftc.robot.model import Robot


class Plant:
    """Arms side by side under a held torque for some steps; the first call compiles."""

    def __init__(self, robot: Robot, dt: float, ticks: int) -> None:
        mjx = engine.module()  # the one file that imports it
        model, blank = mjx.put_model(timed_model(robot, dt)), mjx.make_data(timed_model(robot, dt))

        def one(q: jax.Array, qd: jax.Array, tau: jax.Array) -> tuple[jax.Array, jax.Array]:
            data = blank.replace(qpos=q, qvel=qd, qfrc_applied=tau)
            last, _ = jax.lax.scan(lambda data, _: (mjx.step(model, data), None), data, None, length=ticks)
            return last.qpos, last.qvel

        self._run = jax.jit(jax.vmap(one))

    def __call__(self, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> Any:
        """Last (q, qd) [B, n] from q, qd, tau [n, B]."""
        return jax.block_until_ready(self._run(*(jnp.asarray(x.T, float) for x in (q, qd, tau))))
