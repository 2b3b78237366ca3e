"""``arm.toml``: a robot file and what it lacks, and how the arm's logs are read. A person can write it; ``identify`` does.

The robot's own side (torque limits, friction, motor inertia, links) makes a ``Robot``. What belongs to recordings
(torque gain and offset, encoder, sample time, columns) stays beside it in ``Recording``: the model knows nothing of it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path

import tomli_w

from jaxftc.io.files import write_text
from jaxftc.robot.arm_table import Arm, from_table, to_table
from jaxftc.robot.model import Robot
from jaxftc.robot.model_file import read_model, warn

ARM_FILE = "arm.toml"


def load_robot(path: str | Path, *, tip: str | None = None, lock: Mapping[str, float] | None = None) -> Robot:
    """Read a serial arm of hinges from an MJCF or URDF file, or from an arm's own file (``arm.toml``, or its folder).

    Joints beyond the arm (fingers, heads, other branches, mimic joints) are welded where they stand, and their mass is
    kept. Without ``tip`` the arm goes from the base into the branch with the most hinges and ends where the branches that
    follow have fewer hinges than it has itself. Shapes are not opened where inertials are given, so meshes may be missing.
    A payload hangs at ``tip``, else at a site ``tool``, a link such as ``tool0``, ``ee_link`` or ``flange``, or the last
    link's origin. Joint attribute ``user`` of an MJCF gives the Coulomb torques for positive and negative speed; without
    it, ``frictionloss`` serves for both. What was welded or is a placeholder stands in ``notes`` of the robot, what makes
    results doubtful in ``cautions``; a link that no body can be is a warning, too.

    Args:
        path: The file.
        tip: Link, site or joint at which the arm ends.
        lock: Joints to weld and where, rad or m.

    Returns:
        The arm.

    Raises:
        ValueError: the file is not a serial arm of hinges, or holds numbers that no arm can have.
    """
    robot = read_robot(path, tip=tip, lock=lock)
    warn(robot)
    return robot


def read_robot(path: str | Path, *, tip: str | None = None, lock: Mapping[str, float] | None = None) -> Robot:
    """The same without warnings, for callers that print the cautions themselves."""
    path = Path(path)
    if path.suffix != ".toml" and not path.is_dir():
        return read_model(path, tip=tip, lock=lock)
    if tip is not None or lock:
        raise ValueError(f"{path} names tip and locked joints itself; change them there, or give its model's file")
    return read_arm(path).robot


def load_arm(path: str | Path) -> Arm:
    """Read an arm's own file, or the folder that it is in; a robot file alone is an arm that says nothing of its logs.

    Args:
        path: ``arm.toml``, its folder, an MJCF or a URDF.

    Returns:
        The robot, and how its logs are read.

    Raises:
        ValueError: the file, or the model that it names, cannot be read; an unknown key; a number that no arm can have.
    """
    arm = read_arm(path)
    warn(arm.robot)
    return arm


def read_arm(path: str | Path) -> Arm:
    """The same without warnings, for callers that print the cautions themselves."""
    given = path = Path(path)
    if path.is_dir():
        path = path / ARM_FILE
    if path.suffix != ".toml" and path.is_file():
        return Arm(read_model(path))
    try:
        table = tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except FileNotFoundError as error:
        what = f"an MJCF or URDF file, or 'puma560' for the built-in arm, or a folder with an {ARM_FILE}"
        raise ValueError(f"no robot file at {given}; give {what}") from error
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ValueError(f"cannot read {path}: {error}") from error
    try:
        return from_table(table, path.parent)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def save_arm(path: str | Path, arm: Arm) -> None:
    """Write an arm's file: its model's path, and every number in which the arm differs from that file.

    ``load_arm`` of it gives the same arm to the last bit.

    Args:
        path: The file, or the folder for an ``arm.toml``.
        arm: A robot that came from a file or is the built-in one, with numbers of its own or not.

    Raises:
        ValueError: a robot that came from neither.
        OSError: the file cannot be written.
    """
    path = Path(path)
    path = path / ARM_FILE if path.suffix != ".toml" else path
    write_text(path, tomli_w.dumps(to_table(arm, path.parent)))
