"""Forward dynamics of a batch: MuJoCo C, and what else is installed of pinocchio, roboticstoolbox-python and frax.

All solve the same arm, motor inertia and viscous friction included, Coulomb friction left out.
"""

from __future__ import annotations

import importlib
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from benchmarks.peers.urdf import as_urdf, body
from jaxftc.robot.model import Robot

Array = np.ndarray
Solve = Callable[[Array, Array, Array], Any]  # q, qd, tau [B, n] to qdd [B, n]


class Peer(NamedTuple):
    """One way to forward dynamics."""

    name: str
    how: str
    batch: int  # arms that are enough to time it
    make: Callable[[Robot, int], Solve]  # robot, threads
    module: str = "mujoco"  # what must be installed


def peers(robot: Robot) -> list[Peer]:
    """All of them, installed or not; the toolbox has the PUMA 560 only, which it brings itself."""
    found = [
        Peer("MuJoCo C", "mj_forward, one thread, Python loop", 2048, _mujoco),
        Peer("pinocchio", "aba, one thread, Python loop", 2048, _pinocchio, "pinocchio"),
        Peer("pinocchio in parallel", "abaInParallel, all cores", 16384, _pinocchio_parallel, "pinocchio"),
        Peer("frax", "jit(vmap), with the flag of campaigns", 4096, _frax, "frax"),
    ]
    if robot.name.startswith("puma560"):
        how = "Puma560().accel, one thread, Python loop"
        found.append(Peer("roboticstoolbox", how, 256, _toolbox, "roboticstoolbox"))
    return found


def installed(peer: Peer) -> bool:
    """Whether its package can be imported."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # advice on settings
        try:
            importlib.import_module(peer.module)
        except ImportError:
            return False
    return True


def _mujoco(robot: Robot, threads: int) -> Solve:
    data = mujoco.MjData(robot.mj_model)

    def solve(q: Array, qd: Array, tau: Array) -> Array:
        qdd = np.empty_like(q)
        for k in range(len(q)):
            data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q[k], qd[k], tau[k]
            mujoco.mj_forward(robot.mj_model, data)
            qdd[k] = data.qacc
        return qdd

    return solve


def _pinocchio_model(pin: Any, robot: Robot) -> Any:
    model, parent = pin.Model(), 0
    model.gravity.linear = robot.gravity
    for name, link in zip(robot.joint_names, robot.links, strict=True):
        parent = model.addJoint(parent, pin.JointModelRZ(), pin.SE3(link.rotation, link.offset), name)
        mass, com, central = body(link)
        model.appendBodyToJoint(parent, pin.Inertia(mass, com, central), pin.SE3.Identity())
    model.armature = robot.armature
    return model


def _pinocchio(robot: Robot, threads: int) -> Solve:
    pin: Any = importlib.import_module("pinocchio")
    model = _pinocchio_model(pin, robot)
    data = model.createData()

    def solve(q: Array, qd: Array, tau: Array) -> Array:
        q, tau = q - robot.q_zero, tau - robot.damping * qd
        return np.array([pin.aba(model, data, *state) for state in zip(q, qd, tau, strict=True)])

    return solve


def _pinocchio_parallel(robot: Robot, threads: int) -> Solve:
    pin: Any = importlib.import_module("pinocchio")
    pool = pin.ModelPool(_pinocchio_model(pin, robot), threads)
    return lambda q, qd, tau: pin.abaInParallel(threads, pool, (q - robot.q_zero).T, qd.T, (tau - robot.damping * qd).T).T


def _frax(robot: Robot, threads: int) -> Solve:
    import jax
    import jax.numpy as jnp

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(as_urdf(robot), encoding="utf-8")
        arm: Any = importlib.import_module("frax.core.manipulator").Manipulator(str(path))

    def one(q: jax.Array, qd: jax.Array, tau: jax.Array) -> jax.Array:  # its forward_dynamics, with the motors' inertia
        mass = arm.crba(q) + jnp.diag(jnp.asarray(robot.armature, q.dtype))
        return jax.scipy.linalg.solve(mass, tau - robot.damping * qd - arm.nonlinear_bias(q, qd), assume_a="pos")

    run = jax.jit(jax.vmap(one))
    return lambda q, qd, tau: np.asarray(run(*(jnp.asarray(x, float) for x in (q - robot.q_zero, qd, tau))))


def _toolbox(robot: Robot, threads: int) -> Solve:
    toolbox: Any = importlib.import_module("roboticstoolbox")
    arm = toolbox.models.DH.Puma560().nofriction(coulomb=True, viscous=False)
    return lambda q, qd, tau: np.array([arm.accel(*state) for state in zip(q, qd, tau, strict=True)])
