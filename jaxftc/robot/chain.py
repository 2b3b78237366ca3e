"""The arm in a robot file: one serial chain of hinges, everything else welded where it stands, its mass kept."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from jaxftc.robot.link import Link, oddity
from jaxftc.robot.tree import HINGE, SLIDE, Joint, Place, Tree, point_inertia, turn
from jaxftc.robot.which_arm import Ends, no_hinge, path, refuse_within, there, tip_body

TOOL = "tool"  # the site where a payload hangs
TOOLS = (  # links and sites that are one, the likeliest first; also behind a prefix
    *("tool0", "tool", "tcp", "tool_center_point", "ee_link", "ee", "end_effector_link", "end_effector", "grasp_link"),
    *("attachment_site", "flange", "ee_gripper_link", "gripper_link", "gripper", "hand"),
)
JAWS = ("gripper", "jaw", "finger", "claw", "hand")


class Chain(NamedTuple):
    """The arm."""

    links: tuple[Link, ...]
    payload: Link  # one kilogram at the tool, in the frame of the last hinge
    joints: tuple[Joint, ...]
    names: tuple[str, ...]  # of the links
    tool: str  # where the payload hangs, in words
    gravity: np.ndarray
    notes: tuple[str, ...]  # what was welded, left out, taken for something else
    cautions: tuple[str, ...]  # links that no body can be


class Pose(NamedTuple):
    """A frame in the world."""

    rotation: np.ndarray
    position: np.ndarray

    def moved(self, rotation: np.ndarray, position: np.ndarray) -> Pose:
        """A frame given in this one."""
        return Pose(self.rotation @ rotation, self.position + self.rotation @ position)


def pick(tree: Tree, tip: str | None = None, lock: dict[str, float] | None = None) -> Chain:
    """The arm of a robot file.

    Raises:
        ValueError: no chain of hinges, two of them, an unknown tip or joint, or what is not modelled here.
    """
    lock = lock or {}
    joints = {joint.name: joint for body in tree.bodies for joint in body.joints}
    for name, value in lock.items():
        there("joint", name, list(joints))
        if not math.isfinite(value):
            raise ValueError(f"lock {name!r} must be a finite number of rad or m, got {value!r}")
        if value and joints[name].kind not in (HINGE, SLIDE):
            raise ValueError(f"lock {name!r} must be 0, where it stands: it is a {joints[name].kind} joint; got {value!r}")
    ends = Ends(tree, lock)
    last = ends.without_tip() if tip is None else tip_body(tree, tip)
    on_the_way = path(tree, last)
    arm = [joint for b in on_the_way for joint in tree.bodies[b].joints if ends.counts(joint)]
    if not arm:
        raise ValueError(
            f"has no hinge on the way to {tip!r}; give the last link of the arm" if tip else no_hinge(joints, lock)
        )
    refuse_within(tree, on_the_way, arm, lock)
    hinges = {joint.name: k for k, joint in enumerate(arm)}
    values = {name: _value(joint, joints, lock) for name, joint in joints.items()}
    poses, frames, link_of = _kinematics(tree, hinges, values)
    for joint, frame in zip(arm, frames, strict=True):
        if not (np.isfinite(frame.rotation).all() and np.isfinite(frame.position).all()):
            raise ValueError(f"axis and position of joint {joint.name!r} must be finite, got axis {joint.axis.tolist()}")
    for body, link in zip(tree.bodies, link_of, strict=True):
        if link >= 0 and body.refused:
            raise ValueError(f"link {body.name!r} {body.refused}" if "link" not in body.refused else body.refused)
    parts = [[b for b, link in enumerate(link_of) if link == j] for j in range(len(arm))]
    links = _links(tree, parts, poses, frames)
    names = tuple(_link_name(tree, parts[j], joint) for j, joint in enumerate(arm))
    place, tool = _tool(tree, tip, link_of, len(arm) - 1, last)
    frame = poses[place.body].moved(place.rotation, place.position)
    back = frames[-1].rotation.T
    at = back @ (frame.position - frames[-1].position)
    payload = Link(_clean(back @ frame.rotation), np.zeros(3), 1.0, _clean(at), _clean(point_inertia(at)))
    notes = _welded(tree, hinges, values, lock, link_of, names) + [r for joint in arm for r in joint.remarks]
    notes += _massless(tree, parts)
    if tip is None and any(word in arm[-1].name.lower() for word in JAWS):
        notes.append(
            f"the last joint {arm[-1].name!r} may be a gripper's, not the arm's; give the arm's last link as tip if so"
        )
    return Chain(links, payload, tuple(arm), names, tool, tree.gravity, tuple(notes), tuple(_odd(tree, link_of)))


def _value(joint: Joint, joints: dict[str, Joint], lock: dict[str, float]) -> float:
    """Where a joint is welded: where it is locked, where its mimic rule puts it, or where it is drawn."""
    if joint.name in lock:
        return lock[joint.name]
    if joint.follows is None or joint.follows[0] not in joints:
        return joint.zero
    other, factor, offset = joint.follows
    leader = joints[other]
    return joint.zero + offset + factor * (lock.get(other, leader.zero) - leader.zero)


def _kinematics(tree: Tree, hinges: dict[str, int], values: dict[str, float]) -> tuple[list[Pose], list[Pose], list[int]]:
    """Poses of all bodies with the arm as it is drawn, frames of the hinges, and the hinge that moves each body, or -1."""
    poses: list[Pose] = []
    frames: list[Pose] = [Pose(np.eye(3), np.zeros(3))] * len(hinges)
    link_of: list[int] = []
    for body in tree.bodies:
        above = poses[body.parent] if body.parent >= 0 else Pose(np.eye(3), np.zeros(3))
        at, link = above.moved(body.rotation, body.position), link_of[body.parent] if body.parent >= 0 else -1
        for joint in body.joints:
            if joint.name in hinges:
                link = hinges[joint.name]
                frames[link] = at.moved(_axis_frame(joint.axis), joint.anchor)
            elif joint.kind in (HINGE, SLIDE):
                at = _displaced(at, joint, values[joint.name] - joint.zero)
        poses.append(at)
        link_of.append(link)
    return poses, frames, link_of


def _displaced(at: Pose, joint: Joint, by: float) -> Pose:
    axis = joint.axis / np.linalg.norm(joint.axis)
    if joint.kind == SLIDE:
        return at.moved(np.eye(3), by * axis)
    rotation = turn(axis, by)
    return at.moved(rotation, joint.anchor - rotation @ joint.anchor)


def _axis_frame(axis: np.ndarray) -> np.ndarray:
    """A rotation whose third column is ``axis``; exact permutations where the axis is a coordinate axis."""
    axis = axis / np.linalg.norm(axis)
    other = np.roll(np.eye(3)[np.argmax(np.abs(axis))], 1)
    first = other - axis * (other @ axis)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis, first), axis])


def _links(tree: Tree, parts: list[list[int]], poses: list[Pose], frames: list[Pose]) -> tuple[Link, ...]:
    links, before = [], Pose(np.eye(3), np.zeros(3))
    for frame, bodies in zip(frames, parts, strict=True):
        mass, moment, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
        for b in bodies:
            body, axes = tree.bodies[b], frame.rotation.T @ poses[b].rotation
            com = frame.rotation.T @ (poses[b].moved(np.eye(3), body.com).position - frame.position)
            mass, moment = mass + body.mass, moment + body.mass * com
            inertia = inertia + axes @ body.inertia @ axes.T + body.mass * point_inertia(com)
        rotation, offset = before.rotation.T @ frame.rotation, before.rotation.T @ (frame.position - before.position)
        links.append(Link(_clean(rotation), _clean(offset), mass, _clean(moment), _clean((inertia + inertia.T) / 2)))
        before = frame
    return tuple(links)


def _clean(values: np.ndarray) -> np.ndarray:
    """Rounding dust to exact 0 and +-1, so that the unrolled chain can leave out what it multiplies by them."""
    values = np.where(np.abs(values) < 1e-14, 0.0, values)
    return np.where(np.abs(np.abs(values) - 1) < 1e-14, np.sign(values), values)


def _link_name(tree: Tree, parts: list[int], joint: Joint) -> str:
    """The body of the hinge; of hinges that share a body, all but the last are named after themselves."""
    own = next((tree.bodies[b].name for b in parts if any(j.name == joint.name for j in tree.bodies[b].joints)), "")
    return own or f"{joint.name}_link"


def _tool(tree: Tree, tip: str | None, link_of: list[int], link: int, last: int) -> tuple[Place, str]:
    """Where a payload hangs, and that in words."""
    bodies = {body.name: Place(b, np.zeros(3), np.eye(3)) for b, body in enumerate(tree.bodies)}
    for named in (bodies, tree.sites):
        if tip in named:
            return named[tip], f"the tip {tip!r}"
    if TOOL in tree.sites:
        if tree.sites[TOOL].body < 0 or link_of[tree.sites[TOOL].body] != link:
            raise ValueError("the site 'tool' must sit on the last link, where a payload hangs; move it there")
        return tree.sites[TOOL], "the site 'tool'"
    fixed = {name: at for name, at in bodies.items() if not tree.bodies[at.body].joints} | tree.sites
    carried = {name: at for name, at in fixed.items() if at.body >= 0 and link_of[at.body] == link}
    for wanted in TOOLS:
        for name, at in carried.items():
            if name.lower() == wanted or name.lower().endswith(("_" + wanted, "-" + wanted, "/" + wanted)):
                return at, repr(name)
    return bodies[tree.bodies[last].name], f"the origin of {tree.bodies[last].name!r}"


def _welded(
    tree: Tree,
    hinges: dict[str, int],
    values: dict[str, float],
    lock: dict[str, float],
    link_of: list[int],
    names: tuple[str, ...],
) -> list[str]:
    """One line for each joint that is welded."""
    lines = []
    for b, body in enumerate(tree.bodies):
        for joint in body.joints:
            if joint.name in hinges:
                continue
            unit = "rad" if joint.kind == HINGE else "m"
            at = f"at {values[joint.name]:g} {unit}" if joint.kind in (HINGE, SLIDE) else "where it stands"
            why = "locked" if joint.name in lock else joint.kind
            if joint.follows is not None and joint.name not in lock:
                why = f"mimics {joint.follows[0]!r}"
            above = link_of[b]
            holder = f"its mass stays on {names[above]!r}" if above >= 0 else "it does not move with the arm"
            lines.append(f"joint {joint.name!r} ({why}) is welded {at}; {holder}")
    return lines


def _massless(tree: Tree, parts: list[list[int]]) -> list[str]:
    """One line for each moving link with a shape and no inertial, and for each hinge that carries nothing."""
    lines = []
    for bodies in parts:
        for b in bodies:
            body = tree.bodies[b]
            if not body.has_inertia and (body.has_shape or body.joints):
                lines.append(f"link {body.name!r} moves and has no <inertial>: taken as without mass, as the file has it")
    return lines


def _odd(tree: Tree, link_of: list[int]) -> list[str]:
    """One line for each moving link that no body can be; one that is not a number is refused."""
    lines = []
    for body, link in zip(tree.bodies, link_of, strict=True):
        if link < 0:
            continue
        if not (math.isfinite(body.mass) and np.isfinite(body.com).all() and np.isfinite(body.inertia).all()):
            raise ValueError(f"link {body.name!r} must have a finite mass and inertia, got {body.mass:g} kg and moments "
                             f"{np.diag(body.inertia).tolist()} kg m^2")  # fmt: skip
        text = oddity(body.mass, body.inertia)
        if text:
            lines.append(f"link {body.name!r} {text}")
    return lines
