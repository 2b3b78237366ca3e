"""A robot as URDF, for libraries that read nothing else: links and hinges alone."""

from __future__ import annotations

import numpy as np

from jaxftc.robot.link import Link
from jaxftc.robot.model import Robot


def as_urdf(robot: Robot) -> str:
    """URDF text; hinges turn about z, motor inertia and friction have no place in it."""
    parts = [_link("base", Link(np.eye(3), np.zeros(3), 1.0, np.zeros(3), np.eye(3)))]  # frax reads its inertia
    for i, (name, link) in enumerate(zip(robot.joint_names, robot.links, strict=True)):
        parts.append(_link(f"link{i + 1}", link))
        parts.append(
            f'<joint name="{name}" type="revolute"><parent link="{f"link{i}" if i else "base"}"/>'
            f'<child link="link{i + 1}"/><axis xyz="0 0 1"/>'
            f'<origin xyz="{_numbers(link.offset)}" rpy="{_numbers(_angles(link.rotation))}"/>'
            '<limit lower="-10" upper="10" effort="1000" velocity="100"/></joint>'
        )
    return f'<robot name="arm">{"".join(parts)}</robot>'


def body(link: Link) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass kg, centre of mass [3] m and inertia about it [3, 3] kg m^2."""
    mass = max(link.mass, 1e-12)
    com = link.moment / mass
    return mass, com, link.inertia - mass * (com @ com * np.eye(3) - np.outer(com, com))


def _link(name: str, link: Link) -> str:
    mass, com, central = body(link)
    names = [(a, b, "xyz"[a] + "xyz"[b]) for a in range(3) for b in range(a, 3)]
    entries = " ".join(f'i{name}="{central[a, b]:.15g}"' for a, b, name in names)
    return (
        f'<link name="{name}"><inertial><origin xyz="{_numbers(com)}" rpy="0 0 0"/><mass value="{mass:.15g}"/>'
        f"<inertia {entries}/></inertial></link>"
    )


def _angles(rotation: np.ndarray) -> tuple[float, float, float]:
    """Roll, pitch, yaw rad of a rotation, about the fixed axes x, y, z."""
    level = np.hypot(rotation[2, 1], rotation[2, 2])
    pitch = float(np.arctan2(-rotation[2, 0], level))
    if level < 1e-9:  # roll and yaw turn about the same axis
        return float(np.arctan2(-rotation[1, 2], rotation[1, 1])), pitch, 0.0
    return float(np.arctan2(rotation[2, 1], rotation[2, 2])), pitch, float(np.arctan2(rotation[1, 0], rotation[0, 0]))


def _numbers(values: object) -> str:
    return " ".join(f"{v:.15g}" for v in np.ravel(np.asarray(values, float)))
