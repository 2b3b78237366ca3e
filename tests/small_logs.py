"""A small arm as a file, and logs of it: motions of sines, torques of the arm with friction that its file lacks."""

import functools
from pathlib import Path

import mujoco
import numpy as np

from jaxftc import Robot, load_robot

LINK = (
    '<link name="{name}"><inertial><origin xyz="{x} 0 {z}"/><mass value="{mass}"/>'
    '<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
JOINT = (
    '<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{x} 0 {z}"/>'
    '<axis xyz="{axis}"/><limit lower="-3.1" upper="3.1" effort="80" velocity="3"/></joint>'
)
URDF = (
    '<robot name="small"><link name="base"/>'
    + LINK.format(name="turret", x=0, z=0.1, mass=4, i=0.02)
    + LINK.format(name="upper", x=0.2, z=0, mass=3, i=0.03)
    + LINK.format(name="lower", x=0.15, z=0, mass=1.5, i=0.01)
    + JOINT.format(name="pan", parent="base", child="turret", x=0, z=0.1, axis="0 0 1")
    + JOINT.format(name="shoulder_joint", parent="turret", child="upper", x=0, z=0.2, axis="0 1 0")
    + JOINT.format(name="elbow_joint", parent="upper", child="lower", x=0.4, z=0, axis="0 1 0")
    + "</robot>"
)
COULOMB, VISCOUS, MOTOR = np.array([3.0, 2.0, 1.0]), np.array([2.0, 1.5, 0.5]), np.array([0.4, 0.3, 0.1])
OFFSET = np.array([0.3, -0.2, 0.1])


@functools.cache
def robot(folder: Path) -> Robot:
    path = folder / "small.urdf"
    path.write_text(URDF)
    return load_robot(path)


def motion(seconds: float, rate: float, seed: int, start: float = 0.0) -> tuple[np.ndarray, ...]:
    """T, q, qd, qdd of sines of 0.1 to 0.6 Hz; in motion at the start."""
    rng = np.random.default_rng(seed)
    t = start + np.arange(round(seconds * rate)) / rate
    w = 2 * np.pi * rng.uniform(0.1, 0.6, (3, 4))
    a, phase = 0.6 / w / 2, rng.uniform(0, 2 * np.pi, (3, 4))
    angle = w * t[:, None, None] + phase
    q, qd, qdd = (x.sum(2) for x in (a * np.sin(angle), a * w * np.cos(angle), -a * w**2 * np.sin(angle)))
    return t, q + np.array([0.2, -0.6, 0.9]), qd, qdd


def torque(arm: Robot, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """What MuJoCo C needs for the links of a robot, and what friction and motor inertia take that no file here has."""
    model = arm.mj_model
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, out = mujoco.MjData(model), np.empty_like(q)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], qd[k], qdd[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out + COULOMB * np.tanh(qd / 0.05) + VISCOUS * qd + MOTOR * qdd + OFFSET


def table(
    arm: Robot, seconds: float = 6.0, rate: float = 100.0, seed: int = 1, noise: float = 0.05
) -> dict[str, np.ndarray]:
    """Columns t, q1, ..., tau1, ... of a log."""
    t, q, qd, qdd = motion(seconds, rate, seed)
    rng = np.random.default_rng(seed)
    tau = torque(arm, q, qd, qdd) + noise * rng.standard_normal(q.shape)
    q = q + 1e-5 * rng.standard_normal(q.shape)
    return {"t": t} | {f"q{j + 1}": q[:, j] for j in range(3)} | {f"tau{j + 1}": tau[:, j] for j in range(3)}


def write(path: Path, columns: dict, cut: str = ",", comma: bool = False, head: bool = True) -> Path:
    """A text file of columns; numbers as they are, other cells as text."""
    rows = [[_cell(c) for c in row] for row in zip(*columns.values(), strict=True)]
    if comma:
        rows = [[cell.replace(".", ",") for cell in row] for row in rows]
    lines = [cut.join(columns)] * head + [cut.join(row) for row in rows]
    path.write_text("\n".join(lines) + "\n")
    return path


def _cell(value) -> str:
    return value if isinstance(value, str) else str(value) if isinstance(value, int) else f"{value:.15g}"
