"""What in a robot's numbers looks like a placeholder: a line each. Nothing is changed; a file may mean what it says."""

from __future__ import annotations

import numpy as np

from jaxftc.robot.model import Robot
from jaxftc.robot.tree import point_inertia

LARGEST_GYRATION, SMALLEST_GYRATION = 1.0, 1e-3  # m, radii of gyration beyond which an inertia does not fit its mass
LEAST_ALIKE = 3  # joints or links that must be alike to be said so


def doubts(robot: Robot) -> tuple[str, ...]:
    """One line for each quantity that looks like nobody measured it."""
    lines: list[str] = []
    lines += _absent("motor inertia", robot.armature, robot, "armature, or motor_inertia_kgm2 in an arm.toml")
    friction = robot.damping + robot.coulomb_positive + robot.coulomb_negative
    lines += _absent("friction", friction, robot, "damping and frictionloss, or coulomb_nm and viscous_nms in an arm.toml")
    without = np.isinf(robot.torque_limit)
    lines += _absent("torque limit", np.where(without, 0.0, 1.0), robot, "torque_limit_nm in an arm.toml")
    for name, values, unit in (
        ("torque limit", robot.torque_limit, "N m"),
        ("speed limit", robot.speed_limit, "rad/s"),
        ("motor inertia", robot.armature, "kg m^2"),
        ("viscous friction", robot.damping, "N m s/rad"),
        ("Coulomb friction", robot.coulomb_positive, "N m"),
    ):
        if np.isfinite(values).all() and values.any() and _alike(values):
            lines.append(f"every joint has the same {name}, {values[0]:g} {unit}")
    ranges = np.column_stack([robot.q_low, robot.q_high])
    if np.isfinite(ranges).all() and _alike(ranges):
        lines.append("every joint has the same range, {:.0f} to {:.0f} deg".format(*np.rad2deg(ranges[0])))
    masses = np.array([link.mass for link in robot.links])
    if masses.any() and _alike(masses):
        lines.append(f"every link has the same mass, {masses[0]:g} kg")
    for name, link in zip(robot.link_names, robot.links, strict=True):
        if link.mass > 0:
            com = link.moment / link.mass
            largest = np.linalg.eigvalsh(link.inertia - link.mass * point_inertia(com))[-1]
            radius = float(np.sqrt(max(largest, 0.0) / link.mass))
            if not SMALLEST_GYRATION <= radius <= LARGEST_GYRATION:
                lines.append(f"link {name!r} of {link.mass:.3g} kg has a radius of gyration of {radius:.2g} m")
    return tuple(lines)


def _absent(what: str, values: np.ndarray, robot: Robot, where: str) -> list[str]:
    lacking = [name for name, value in zip(robot.joint_names, values, strict=True) if value == 0]
    if not lacking:
        return []
    who = "any joint" if len(lacking) == robot.n else ", ".join(lacking)
    return [f"no {what} for {who}; give it as {where}"]


def _alike(values: np.ndarray) -> bool:
    return len(values) >= LEAST_ALIKE and bool(np.allclose(values, values[0], rtol=1e-9, atol=0.0))
