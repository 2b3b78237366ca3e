"""Arms that nobody built but somebody could have: for what is to hold for arms that it has never seen.

Two to seven hinges, most of them turned against the one before; links that get shorter and lighter towards the tool;
motors whose reflected inertia is a fifth to twice what the joint moves, and never that of no motor; limits of 1.3 to 3 times
what weight, a payload and a quick motion need; friction of some hundredths of the limit.
"""

from __future__ import annotations

import numpy as np

from jaxftc.robot.model import Robot
from jaxftc.robot.model_file import compile_robot

GRAVITY = 9.81  # m/s^2


def random_arm(seed: int) -> Robot:
    """The arm of a seed; six in a row have all numbers of hinges."""
    draw = np.random.default_rng([7, seed])
    n = 2 + seed % 6
    axes = _axes(draw, n)
    share = draw.uniform(0.5, 1.5, n) * draw.uniform(0.6, 0.95) ** np.arange(n)
    length = np.maximum(draw.uniform(0.5, 1.3) * share / share.sum(), 0.05)  # m
    along = 0.25 * draw.normal(size=(n, 3)) + np.eye(3)[draw.choice([0, 2], n)]
    ends = length[:, None] * along / np.linalg.norm(along, axis=1, keepdims=True)  # m, of each link in its own frame
    mass = np.exp(draw.uniform(np.log(3), np.log(15))) * draw.uniform(0.5, 0.85) ** np.arange(n) * draw.uniform(0.7, 1.3, n)
    radius, none = draw.uniform(0.02, 0.06, n), np.zeros((n, 2))
    bare = compile_robot("bare", _text(axes, ends, mass, radius, np.full(n, 1e-6), none[:, 0], none, np.ones(n)))
    inertia = bare.inertia_diagonal
    armature = np.maximum(draw.uniform(0.2, 2.0, n) * inertia, np.exp(draw.uniform(np.log(0.01), np.log(0.2), n)))
    weight = GRAVITY * _levers(ends, mass, draw.uniform(1.0, 4.0))
    weight[0] *= 0.1 if axes[0][2] else 1.0  # an upright axis bears none
    limit = draw.uniform(1.3, 3.0, n) * (weight + draw.uniform(6.0, 20.0, n) * (inertia + armature))
    limit = np.maximum(limit, 3.0)
    coulomb = (draw.uniform(0.02, 0.15, n) * limit)[:, None] * draw.uniform(0.8, 1.2, (n, 2))
    damping = draw.uniform(0.01, 0.06, n) * limit
    return compile_robot(f"random {seed}", _text(axes, ends, mass, radius, armature, damping, coulomb, limit))


def _axes(draw: np.random.Generator, n: int) -> list[np.ndarray]:
    """Axes of the hinges: the first upright more often than not, each of the others mostly across the one before."""
    axes = [np.eye(3)[2 if draw.uniform() < 0.8 else 1]]
    for _ in range(n - 1):
        before = int(np.argmax(axes[-1]))
        others = [k for k in range(3) if k != before]
        axes.append(np.eye(3)[before if draw.uniform() < 0.25 else draw.choice(others)])
    return axes


def _levers(ends: np.ndarray, mass: np.ndarray, payload: float) -> np.ndarray:
    """Mass times lever [n] kg m of what each joint carries, stretched out."""
    n = len(ends)
    reach = lambda j, k: float(np.linalg.norm(ends[j:k].sum(0)))  # noqa: E731
    own = [sum(mass[k] * (reach(j, k) + 0.5 * np.linalg.norm(ends[k])) for k in range(j, n)) for j in range(n)]
    return np.array(own) + payload * np.array([reach(j, n) + 0.05 for j in range(n)])


def _text(
    axes: list[np.ndarray],
    ends: np.ndarray,
    mass: np.ndarray,
    radius: np.ndarray,
    armature: np.ndarray,
    damping: np.ndarray,
    coulomb: np.ndarray,
    limit: np.ndarray,
) -> str:
    """The arm as MJCF text."""
    numbers = lambda values: " ".join(f"{value:.9g}" for value in values)  # noqa: E731
    links, motors, at = "", "", np.zeros(3)
    for i, axis in enumerate(axes):
        links += (
            f'<body name="link{i + 1}" pos="{numbers(at)}"><joint name="joint{i + 1}" axis="{numbers(axis)}" '
            f'armature="{armature[i]:.9g}" damping="{damping[i]:.9g}" user="{numbers(coulomb[i])}"/>'
            f'<geom type="capsule" size="{radius[i]:.9g}" fromto="0 0 0 {numbers(ends[i])}" mass="{mass[i]:.9g}"/>'
        )
        motors += f'<motor joint="joint{i + 1}" ctrllimited="true" ctrlrange="{-limit[i]:.9g} {limit[i]:.9g}"/>'
        at = ends[i]
    tool, closing = f'<site name="tool" pos="{numbers(at)}"/>', "</body>" * len(axes)
    head = '<mujoco><compiler angle="radian"/><size nuser_jnt="2"/><worldbody>'
    return f"{head}{links}{tool}{closing}</worldbody><actuator>{motors}</actuator></mujoco>"
