"""A link of an arm: its place, mass and inertia, and what no body can have of them."""

from __future__ import annotations

import dataclasses

import numpy as np

from jaxftc.robot.tree import point_inertia


@dataclasses.dataclass(frozen=True, eq=False)
class Link:
    """One hinge and what it carries, in the frame at the hinge whose z axis is the hinge."""

    rotation: np.ndarray  # [3, 3] this frame at zero angle, in the frame of the hinge before
    offset: np.ndarray  # [3] m, this origin in the frame of the hinge before
    mass: float  # kg
    moment: np.ndarray  # [3] kg m, mass times centre of mass
    inertia: np.ndarray  # [3, 3] kg m^2, about this origin


def inertial(link: Link) -> tuple[float, np.ndarray, np.ndarray, bool]:
    """Mass, centre, inertia [3, 3] about it, and whether MuJoCo's compiler takes them."""
    com = link.moment / link.mass if link.mass else np.zeros(3)
    inertia = link.inertia - link.mass * point_inertia(com)
    moments = np.linalg.eigvalsh(inertia)
    return link.mass, com, inertia, bool(link.mass > 1e-12 and moments[0] > 1e-14 and moments[0] + moments[1] >= moments[2])


def oddity(mass: float, inertia: np.ndarray) -> str:
    """What no body can have of a mass and an inertia about its centre, in words; empty if nothing."""
    moments = np.linalg.eigvalsh(inertia)
    slack = 1e-6 * max(abs(moments[2]), abs(moments[0]))  # files round to a few digits
    if mass < 0:
        return f"has a mass below zero, {mass:g} kg"
    said = ", ".join(f"{m:.3g}" for m in moments)
    if moments[0] < -slack:
        return f"has an inertia that no body can have: principal moments {said} kg m^2, the least below zero"
    if moments[0] + moments[1] < moments[2] - slack:
        return (
            f"has an inertia that no body can have: principal moments {said} kg m^2, the largest above the sum of the others"
        )
    if mass == 0 and moments[2] > slack:
        return f"has an inertia and no mass: principal moments {said} kg m^2"
    return ""
