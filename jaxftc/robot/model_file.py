"""A robot from an MJCF or URDF file."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from jaxftc.robot import chain, mjcf, urdf
from jaxftc.robot.chain import Chain
from jaxftc.robot.model import BARE, COULOMB_SPEED, Robot, assemble
from jaxftc.robot.numbers import Numbers, Source
from jaxftc.robot.tree import Tree


def read_model(path: Path, *, tip: str | None = None, lock: Mapping[str, float] | None = None) -> Robot:
    """The arm of an MJCF or URDF file; its cautions are not warned of."""
    if not path.is_file():
        raise ValueError(f"no robot file at {path}; give an MJCF or URDF file, or 'puma560' for the built-in arm")
    try:
        found = chain.pick(_tree(path), tip, dict(lock or {}))
        return _from_chain(path.stem, found, Source(path, tip, tuple((lock or {}).items())))
    except ValueError as error:
        raise ValueError(f"{path}: {' '.join(str(error).split())}") from error


def compile_robot(name: str, text: str) -> Robot:
    """The arm of MJCF text."""
    try:
        return _from_chain(name, chain.pick(mjcf.read(mujoco.MjSpec.from_string(text))), None)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error


def warn(robot: Robot) -> None:
    """A warning, at the caller's caller, for each link that no body can be; that of the built-in arm is as published."""
    for caution in robot.cautions if robot.source is not None else ():
        if caution != BARE:
            warnings.warn(f"{robot.name}: {caution}", stacklevel=3)


def _tree(path: Path) -> Tree:
    """What the file says, by what it is: its root element, not its name."""
    root = urdf.parse(path.read_bytes())
    if root.tag == "robot":
        return urdf.read(root)
    if root.tag == "sdf":
        raise ValueError("is SDF, which is not read here; give the robot's URDF, or convert it to MJCF")
    if root.tag != "mujoco":
        raise ValueError(f"begins with <{root.tag}>; an MJCF begins with <mujoco>, a URDF with <robot>")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ValueError(f"does not compile: {error}") from error
    return mjcf.read(spec)


def _from_chain(name: str, found: Chain, source: Source | None) -> Robot:
    joints = found.joints

    def column(values: Any) -> np.ndarray:
        return np.array(list(values), float)

    given = Numbers(
        name=name,
        joint_names=_distinct([joint.name for joint in joints]),
        link_names=found.names,
        links=found.links,
        payload_link=found.payload,
        q_zero=column(joint.zero for joint in joints),
        q_low=column(joint.low for joint in joints),
        q_high=column(joint.high for joint in joints),
        gravity=found.gravity,
        armature=column(joint.armature for joint in joints),
        damping_positive=column(joint.damping for joint in joints),
        damping_negative=column(joint.damping for joint in joints),
        coulomb_positive=column(joint.coulomb[0] for joint in joints),
        coulomb_negative=column(joint.coulomb[1] for joint in joints),
        coulomb_speed=COULOMB_SPEED,
        torque_limit=column(joint.torque_limit for joint in joints),
        speed_limit=column(joint.speed_limit for joint in joints),
        tool=found.tool,
        notes=found.notes,
        source=source,
    )
    return assemble(given, found.cautions)


def _distinct(names: list[str]) -> tuple[str, ...]:
    """The joints' names, each with its number where the columns of a table could be the same for two.

    Columns are a signal and a joint: ``q_hat_x`` would be ``q_hat`` of ``x`` and ``q`` of ``hat_x``; case does not count.
    """
    low = [name.lower() for name in names]
    same = any(a == b or a.endswith(f"_{b}") for i, a in enumerate(low) for j, b in enumerate(low) if i != j)
    return tuple(f"{name}_{j + 1}" for j, name in enumerate(names)) if same else tuple(names)
