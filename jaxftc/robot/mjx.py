"""MuJoCo MJX as a plant engine: smooth dynamics only. The one file that imports ``mujoco.mjx``.

MJX computes the mass matrix and the bias force; friction, motor inertia and the solution are in
``dynamics``. MJX works on one arm, so scenario axes are mapped here.
"""

from __future__ import annotations

import contextlib
import functools
import io
import threading
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.robot.model import Robot
from jaxftc.robot.mujoco_model import PAYLOAD
from jaxftc.types import Array

_IMPORT = threading.Lock()


@functools.cache
def module() -> Any:
    """The module; its import prints about optional packages to stdout, where a command's JSON may be.

    Under a lock: two threads that redirect stdout at once can leave it redirected.
    """
    with _IMPORT, contextlib.redirect_stdout(io.StringIO()):
        from mujoco import mjx
    return mjx


@functools.cache
def _model(robot: Robot, x64: bool) -> Any:
    """The compiled model on the device, in the precision that JAX has now; ``x64`` is only the cache's key."""
    with jax.ensure_compile_time_eval():
        return module().put_model(robot.mj_model), module().make_data(robot.mj_model)


def mass_and_bias(robot: Robot, mass: Array, payload: Array, q: Array, qd: Array) -> tuple[Array, Array]:
    """M(q) [n, n, ...] without motor inertia, and h(q, qd) [n, ...], Coriolis and gravity, N m.

    ``mass`` [n, ...] scales every link, ``payload`` [...] kg sits at the tool.
    """
    axes = q.shape[1:]
    flat = [
        jnp.broadcast_to(x, x.shape[:rank] + axes).reshape((*x.shape[:rank], -1))
        for x, rank in ((mass, 1), (payload, 0), (q, 1), (qd, 1))
    ]
    one = functools.partial(_one_arm, robot)
    matrix, bias = jax.vmap(one, in_axes=-1, out_axes=-1)(*flat)
    return matrix.reshape(matrix.shape[:2] + axes), bias.reshape(bias.shape[:1] + axes)


def _one_arm(robot: Robot, mass: Array, payload: Array, q: Array, qd: Array) -> tuple[Array, Array]:
    """Mass matrix [n, n] and bias [n] N m of one arm: mass factors [n], payload kg, q [n] rad, qd [n] rad/s."""
    mjx = module()
    model, data = _model(robot, bool(jax.config.read("jax_enable_x64")))
    scale = jnp.concatenate([mass, jnp.ones(1, mass.dtype)])[robot.body_link]  # body -1, the base, reads the last
    is_payload = np.arange(robot.mj_model.nbody) == robot.mj_model.body(PAYLOAD).id
    model = model.replace(
        body_mass=jnp.where(is_payload, payload, scale * model.body_mass),
        body_inertia=scale[:, None] * model.body_inertia,
    )
    data = data.replace(qpos=q, qvel=qd)
    with jax.default_matmul_precision("highest"):  # float32 on a GPU would be TF32 otherwise
        for stage in (mjx.kinematics, mjx.com_pos, mjx.crb, mjx.com_vel, mjx.rne):
            data = stage(model, data)
        matrix = mjx.full_m(model, data)
    return (matrix - jnp.diag(jnp.asarray(model.dof_armature))).astype(q.dtype), data.qfrc_bias.astype(q.dtype)
