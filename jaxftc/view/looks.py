"""How an arm looks: the PUMA 560 as a table of parts, any other arm as capsules from joint to joint.

A part belongs to a link and is given in the frame of the body that the link's hinge turns, at the angles where the model is
drawn; link -1 is the base. Parts that say a joint take its colour when something is wrong with it. Lengths of the PUMA are
measured off drawings and photographs of the machine; distances between axes are the model's own.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

from jaxftc.robot import puma560

Point = tuple[float, float, float]
Colour = tuple[float, float, float, float]

SHELL: Colour = (0.90, 0.89, 0.85, 1.0)  # the machine's off-white paint
TRIM: Colour = (0.27, 0.29, 0.32, 1.0)  # castings, and joints with nothing wrong
METAL: Colour = (0.66, 0.68, 0.71, 1.0)
AROUND = 48  # corners of a round mesh


@dataclasses.dataclass(frozen=True)
class Part:
    """One shape: a cylinder or a capsule along a line, a sphere, a box between two corners, or a plate around two discs."""

    link: int  # hinge whose body carries it, -1 the base
    kind: str  # cylinder, capsule, sphere, box, plate
    ends: tuple[Point, Point]  # m; of a sphere twice its centre; of a plate the centres of its discs, in its middle plane
    size: tuple[float, ...]  # m: radius; of a plate two radii and half the thickness, which is along z; of a box nothing
    colour: Colour = SHELL
    joint: int | None = None  # joint whose colour it takes


_HEIGHT, _UPPER, _FORE = puma560.D[0], puma560.A[1], puma560.D[3]  # m: shoulder above the floor, elbow and wrist centre
_CROOK, _SIDE, _FLANGE = puma560.A[2], puma560.D[2], puma560.TOOL[2]  # m: wrist beside the elbow, forearm beside the base
_OUTER = 0.2435  # m, middle plane of the upper arm beside the base

PUMA560 = (
    # base: foot, column, and the band on which the trunk turns
    Part(-1, "cylinder", ((0, 0, 0), (0, 0, 0.025)), (0.17,), TRIM),
    Part(-1, "cylinder", ((0, 0, 0.025), (0, 0, 0.07)), (0.125,), TRIM),
    Part(-1, "cylinder", ((0, 0, 0.07), (0, 0, 0.47)), (0.09,)),
    Part(0, "cylinder", ((0, 0, 0.47), (0, 0, 0.535)), (0.101,), TRIM, 0),
    # trunk: neck, shoulder block across it with its cover at the back
    Part(0, "cylinder", ((0, 0, 0.535), (0, 0, 0.62)), (0.09,)),
    Part(0, "cylinder", ((0, 0.16, _HEIGHT), (0, -0.10, _HEIGHT)), (0.105,)),
    Part(0, "cylinder", ((0, 0.178, _HEIGHT), (0, 0.16, _HEIGHT)), (0.09,), TRIM),
    Part(0, "cylinder", ((0, -0.10, _HEIGHT), (0, -0.195, _HEIGHT)), (0.105,), TRIM, 1),
    # upper arm: wide and round behind the shoulder, where its motors are, and narrow at the elbow
    Part(1, "plate", ((-0.125, 0, _OUTER), (_UPPER, 0, _OUTER)), (0.125, 0.082, 0.047)),
    Part(1, "cylinder", ((0, 0, _OUTER), (0, 0, 0.303)), (0.078,), TRIM, 1),
    # forearm: inside the upper arm, slimmer toward the wrist; the elbow's shaft shows on both sides
    Part(2, "plate", ((0, -0.03, _SIDE), (_CROOK, 0.30, _SIDE)), (0.084, 0.05, 0.044)),
    Part(2, "cylinder", ((0, 0, 0.092), (0, 0, 0.303)), (0.06,), TRIM, 2),
    # wrist: collar that rolls, fork, ball, flange
    Part(3, "cylinder", ((0, 0, 0.335), (0, 0, 0.40)), (0.052,), TRIM, 3),
    Part(3, "box", ((-0.028, 0.038, 0.39), (0.028, 0.054, 0.465)), ()),
    Part(3, "box", ((-0.028, -0.054, 0.39), (0.028, -0.038, 0.465)), ()),
    Part(4, "sphere", ((0, 0, 0), (0, 0, 0)), (0.038,), METAL),
    Part(4, "cylinder", ((0, 0, -0.064), (0, 0, 0.064)), (0.027,), TRIM, 4),
    Part(5, "cylinder", ((0, 0, 0), (0, 0, 0.04)), (0.022,), METAL),
    Part(5, "cylinder", ((0, 0, 0.034), (0, 0, _FLANGE)), (0.038,), TRIM, 5),
)


def capsules(model: mujoco.MjModel, bare: set[int]) -> tuple[Part, ...]:
    """Links as capsules from joint to joint and joints as drums about their axes, for the links in ``bare``; -1 is the base.

    Everything is sized by the length of the arm, thick at the base and about half that at the tool.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    base, tool = int(model.body_parentid[model.jnt_bodyid[0]]), mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tool")
    points = np.array([data.xpos[base], *data.xanchor, data.site_xpos[tool] if tool >= 0 else data.xpos[-1]])
    reach = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()) or 1.0
    parts = []
    for link in sorted(bare):
        carrier = int(model.jnt_bodyid[link]) if link >= 0 else base
        radius = reach * (0.04 - 0.02 * (link + 1) / (model.njnt + 1))
        start, end = points[link + 1], points[link + 2]
        if np.linalg.norm(end - start) > 1e-6 * reach:
            parts.append(Part(link, "capsule", _local(data, carrier, start, end), (radius,)))
        if link >= 0:
            half = 1.5 * radius * data.xaxis[link]
            drum = _local(data, carrier, start - half, start + half)
            parts.append(Part(link, "cylinder", drum, (1.3 * radius,), TRIM, link))
    return tuple(parts)


def _local(data: mujoco.MjData, body: int, *points: np.ndarray) -> tuple[Point, Point]:
    """Points [3] of the world in m in the frame of a body."""
    start, end = ((point - data.xpos[body]) @ data.xmat[body].reshape(3, 3) for point in points)
    return tuple(start.tolist()), tuple(end.tolist())


def plate(ends: tuple[Point, Point], size: tuple[float, ...]) -> np.ndarray:
    """Corners [k, 3] in m of a plate: the hull of two discs of radii size[0] and size[1], 2 size[2] thick, edges broken."""
    angle = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(AROUND)])
    half, edge = size[2], 0.2 * size[2]
    levels = ((edge, -half), (0.0, edge - half), (0.0, half - edge), (edge, half))
    discs = zip(ends, size[:2], strict=True)
    return np.concatenate([np.add(c, (0, 0, z)) + (r - cut) * circle for c, r in discs for cut, z in levels])
