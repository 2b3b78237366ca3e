"""From URDF to ``Tree``: links, joints, inertials and limits. Shapes are never opened, so meshes may be missing.

MuJoCo reads URDF too, but weighs the collision shape of a link that has no ``<inertial>``, and refuses odd inertials of
links that do not move.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterator
from xml.parsers import expat

import numpy as np

from jaxftc.robot.tree import HINGE, SLIDE, Body, Joint, Tree, rpy

KINDS = {"revolute": HINGE, "continuous": HINGE, "prismatic": SLIDE, "floating": "floating", "planar": "planar"}
ONCE = {
    "inertial",
    "origin",
    "mass",
    "inertia",
    "parent",
    "child",
    "axis",
    "limit",
    "dynamics",
    "mimic",
    "safety_controller",
}
GRAVITY = (0.0, 0.0, -9.81)  # m/s^2, a URDF has none of its own


@dataclasses.dataclass
class Element:
    """An XML element, with the line on which it begins."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Element] = dataclasses.field(default_factory=list)

    def all(self, tag: str) -> list[Element]:
        """Children of a tag."""
        return [child for child in self.children if child.tag == tag]

    def every(self) -> Iterator[Element]:
        """This element and all below, in their order."""
        yield self
        for child in self.children:
            yield from child.every()

    def one(self, tag: str) -> Element | None:
        """The child of a tag, if there is one."""
        return next(iter(self.all(tag)), None)


def parse(text: bytes) -> Element:
    """The root element.

    Raises:
        ValueError: not XML, with the line.
    """
    parser, open_ = expat.ParserCreate(), [Element("", {}, 0)]

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes, parser.CurrentLineNumber)
        open_[-1].children.append(element)
        open_.append(element)

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda tag: open_.pop()
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise ValueError(f"is not XML: {error}") from error
    return open_[0].children[0]


def read(root: Element) -> Tree:
    """The tree of a ``<robot>``.

    Raises:
        ValueError: what is wrong, and in which line.
    """
    for element in root.every():
        if element.tag.startswith("xacro:"):
            raise ValueError(
                f"line {element.line}: <{element.tag}> is xacro, not URDF; expand the file first: "
                "xacro arm.urdf.xacro > arm.urdf"
            )
    links, joints = root.all("link"), root.all("joint")
    if not links:
        raise ValueError("has no <link>, so it is no URDF (an SRDF names groups of joints only); give the URDF")
    for element in (*links, *joints):
        _once(element)
        _name(element)
    for kind, elements in (("link", links), ("joint", joints)):
        twice = [name for name, count in Counter(e.attributes["name"] for e in elements).items() if count > 1]
        if twice:
            raise ValueError(f"has the {kind} {twice[0]!r} twice; give each its own name")
    parents = _parents(joints, {link.attributes["name"] for link in links})
    roots = [link.attributes["name"] for link in links if link.attributes["name"] not in parents]
    if len(roots) != 1:
        what = f"links {', '.join(map(repr, roots))} have no parent" if roots else "its joints form a circle"
        raise ValueError(f"must have one base link, but {what}; every other link needs one joint to its parent")
    below: dict[str, list[tuple[str, Element]]] = {}
    for child, (parent, joint) in parents.items():
        below.setdefault(parent, []).append((child, joint))
    by_name = {link.attributes["name"]: link for link in links}
    bodies: list[Body] = [_body(by_name[roots[0]], -1, None)]
    waiting = [(child, joint, 0) for child, joint in reversed(below.get(roots[0], []))]
    while waiting:
        name, joint, parent = waiting.pop()
        bodies.append(_body(by_name[name], parent, joint))
        waiting += [(child, j, len(bodies) - 1) for child, j in reversed(below.get(name, []))]
    if len(bodies) < len(links):
        lost = sorted(set(by_name) - {body.name for body in bodies})
        raise ValueError(f"must be one tree, but its joints form a circle at link {lost[0]!r}")
    return Tree(tuple(bodies), {}, np.array(GRAVITY))


def _once(element: Element) -> None:
    for tag, count in Counter(child.tag for child in element.children).items():
        if count > 1 and tag in ONCE:
            second = element.all(tag)[1]
            raise ValueError(f"line {second.line}: <{tag}> stands twice in <{element.tag}>; leave one of them")
    for child in element.children:
        if child.tag == "inertial":
            _once(child)


def _name(element: Element) -> None:
    if not element.attributes.get("name"):
        raise ValueError(f"line {element.line}: <{element.tag}> has no name; give it one")


def _parents(joints: list[Element], links: set[str]) -> dict[str, tuple[str, Element]]:
    found: dict[str, tuple[str, Element]] = {}
    for joint in joints:
        ends = {}
        for end in ("parent", "child"):
            element = joint.one(end)
            ends[end] = element.attributes.get("link") if element is not None else None
            if ends[end] not in links:
                raise ValueError(
                    f"line {joint.line}: joint {joint.attributes['name']!r} has the {end} link {ends[end]!r}, "
                    "which is not there"
                )
        if ends["child"] in found:
            raise ValueError(
                f"line {joint.line}: link {ends['child']!r} is the child of two joints; only trees can be modelled"
            )
        found[str(ends["child"])] = (str(ends["parent"]), joint)
    return found


def _body(link: Element, parent: int, joint: Element | None) -> Body:
    name = link.attributes["name"]
    position, rotation = (
        _origin(joint, f"joint {joint.attributes['name']!r}") if joint is not None else (np.zeros(3), np.eye(3))
    )
    joints = () if joint is None or joint.attributes.get("type") == "fixed" else (_joint(joint),)
    shape = bool(link.all("visual") or link.all("collision"))
    inertial = link.one("inertial")
    if inertial is None:
        return Body(name, parent, position, rotation, joints, has_inertia=False, has_shape=shape)
    try:
        mass, com, inertia = _inertial(inertial, f"link {name!r}")
    except ValueError as error:
        return Body(name, parent, position, rotation, joints, has_shape=shape, refused=str(error))
    return Body(name, parent, position, rotation, joints, mass, com, inertia, has_shape=shape)


def _inertial(element: Element, of: str) -> tuple[float, np.ndarray, np.ndarray]:
    com, axes = _origin(element, f"inertial of {of}")
    mass, inertia = element.one("mass"), element.one("inertia")
    if mass is None:
        raise ValueError(f"line {element.line}: {of} has an <inertial> without <mass>; give it one")
    kg = _number(mass, "value", f"mass of {of}")
    if inertia is None:
        return kg, com, np.zeros((3, 3))
    xx, yy, zz, xy, xz, yz = (
        _number(inertia, f"i{k}", f"inertia of {of}", 0.0) for k in ("xx", "yy", "zz", "xy", "xz", "yz")
    )
    return kg, com, axes @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ axes.T


def _joint(element: Element) -> Joint:
    name, said = element.attributes["name"], element.attributes.get("type")
    of = f"joint {name!r}"
    if said not in KINDS:
        raise ValueError(f"line {element.line}: {of} has the type {said!r}; URDF has {', '.join(KINDS)} and fixed")
    axis = element.one("axis")
    direction = np.array([1.0, 0.0, 0.0]) if axis is None else _vector(axis, "xyz", f"axis of {of}", 3)
    if KINDS[said] in (HINGE, SLIDE) and not np.linalg.norm(direction) > 1e-9:
        raise ValueError(f"{_line(axis)}axis of {of} must have a direction, got {direction.tolist()}")
    mimic, dynamics = element.one("mimic"), element.one("dynamics")
    follows = None
    if mimic is not None:
        factor, offset = (_number(mimic, key, f"mimic of {of}", d) for key, d in (("multiplier", 1.0), ("offset", 0.0)))
        follows = (mimic.attributes.get("joint", ""), factor, offset)
    damping, friction = (
        0.0 if dynamics is None else _number(dynamics, key, f"dynamics of {of}", 0.0) for key in ("damping", "friction")
    )
    bounds, remarks = _limits(element, said, of)
    return Joint(
        name,
        KINDS[said],
        direction,
        np.zeros(3),
        damping=damping,
        coulomb=(friction, friction),
        follows=follows,
        remarks=remarks,
        **bounds,  # pyright: ignore[reportArgumentType]
    )


def _limits(joint: Element, said: str, of: str) -> tuple[dict[str, float], tuple[str, ...]]:
    """Range, torque and speed limit, infinite where there is none; zeros are placeholders, which the remarks say."""
    found = {"low": -math.inf, "high": math.inf, "torque_limit": math.inf, "speed_limit": math.inf}
    limit = joint.one("limit")
    if limit is None:
        return found, ()
    remarks = []
    for key, name, unit in (("effort", "torque_limit", "N m"), ("velocity", "speed_limit", "rad/s")):
        value = _number(limit, key, f"limit of {of}", math.inf, infinite=True)
        if value > 0:
            found[name] = value
        else:
            remarks.append(f"{of} has {key} {value:g} {unit}, a placeholder: taken as no limit")
    if said != "continuous":
        low, high = (_number(limit, key, f"limit of {of}", 0.0, infinite=True) for key in ("lower", "upper"))
        if low < high:
            found |= {"low": low, "high": high}
        else:
            remarks.append(f"{of} has a range from {low:g} to {high:g}, a placeholder: taken as no range")
    return found, tuple(remarks)


def _origin(element: Element, of: str) -> tuple[np.ndarray, np.ndarray]:
    origin = element.one("origin")
    if origin is None:
        return np.zeros(3), np.eye(3)
    position, angles = (_vector(origin, key, f"origin of {of}", 3, "0 0 0") for key in ("xyz", "rpy"))
    return position, rpy(*angles)


def _number(element: Element, key: str, of: str, default: float | None = None, *, infinite: bool = False) -> float:
    if key not in element.attributes and default is not None:
        return default
    return float(_vector(element, key, of, 1, infinite=infinite)[0])


def _vector(
    element: Element, key: str, of: str, length: int, default: str | None = None, *, infinite: bool = False
) -> np.ndarray:
    text = element.attributes.get(key, default)
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        values = np.array([])
    good = np.isfinite(values) | (np.isinf(values) & infinite)
    if len(values) != length or not good.all():
        many = "a finite number" if length == 1 else f"{length} finite numbers with blanks between"
        raise ValueError(f"{_line(element)}{key} of the {of} must be {many}, got {text!r}")
    return values


def _line(element: Element | None) -> str:
    return "" if element is None else f"line {element.line}: "
