"""``jaxftc inspect``: one page of what was read from a robot file."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from jaxftc.cli import common
from jaxftc.io.text_table import aligned

if TYPE_CHECKING:
    from jaxftc.robot.arm_table import Arm


@dataclasses.dataclass
class Inspect:
    """Print what was read from a robot file: joints, limits, masses, what was welded, what looks like a placeholder."""

    robot: Annotated[str, tyro.conf.Positional] = "puma560"
    """Built-in arm, an MJCF or URDF file, or an arm's own file (arm.toml, or the folder that it is in)."""
    tip: common.MaybeName = None
    """Link, site or joint at which the arm ends, where the file holds more than one arm."""
    lock: common.Poses = ()
    """Joints to weld, each with its position in rad or m, such as gripper=0.5."""
    json: bool = False
    """Print one JSON object on stdout and nothing else there."""

    def run(self) -> None:
        """Read it, print the page."""
        result = as_dict(self._arm())
        print(json.dumps(result, indent=2, allow_nan=False) if self.json else page(result))

    def _arm(self) -> Arm:
        from jaxftc.robot.arm_file import read_arm, read_robot
        from jaxftc.robot.arm_table import Arm

        if self.robot == "puma560":
            return Arm(common.built_in(self.tip, self.lock, coulomb=True))
        if self.tip is None and not self.lock:
            return read_arm(self.robot)
        return Arm(read_robot(self.robot, tip=self.tip, lock=common.numbers("--lock", self.lock)))


def as_dict(arm: Arm) -> dict[str, Any]:
    """The page as data; what is absent is None."""
    import numpy as np

    from jaxftc.robot.doubts import doubts

    robot = arm.robot

    def number(value: float) -> float | None:
        return float(value) if math.isfinite(value) else None

    joints = [
        {
            "joint": j + 1,
            "name": name,
            "link": robot.link_names[j],
            "low_rad": number(robot.q_low[j]),
            "high_rad": number(robot.q_high[j]),
            "torque_limit_nm": number(robot.torque_limit[j]),
            "speed_limit_rads": number(robot.speed_limit[j]),
            "motor_inertia_kgm2": float(robot.armature[j]),
            "viscous_nms": [float(robot.damping_positive[j]), float(robot.damping_negative[j])],
            "coulomb_nm": [float(robot.coulomb_positive[j]), float(robot.coulomb_negative[j])],
            "mass_kg": float(robot.links[j].mass),
            "com_m": (robot.links[j].moment / robot.links[j].mass).tolist() if robot.links[j].mass else None,
            "moment_kgm": robot.links[j].moment.tolist(),
            "inertia_kgm2": robot.links[j].inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)].tolist(),
        }
        for j, name in enumerate(robot.joint_names)
    ]
    source = robot.source
    return {
        "name": robot.name,
        "file": None if source is None else str(source.path),
        "tip": None if source is None else source.tip,
        "lock": {} if source is None else dict(source.lock),
        "n": robot.n,
        "joints": joints,
        "moving_mass_kg": float(np.sum([link.mass for link in robot.links])),
        "gravity_ms2": robot.gravity.tolist(),
        "tool": robot.tool,
        "tool_m": robot.payload_link.moment.tolist(),
        "notes": list(robot.notes),
        "cautions": list(robot.cautions),
        "doubts": list(doubts(robot)),
        "recording": {
            key: value for key, value in dataclasses.asdict(arm.recording).items() if value is not None and value != ()
        },
        "fingerprint": robot.fingerprint,
    }


def page(result: dict[str, Any]) -> str:
    """The page as text."""
    head = f"{result['name']}: {result['n']} joints, {result['moving_mass_kg']:.4g} kg that move"
    lines = [head + (f", from {result['file']}" if result["file"] else ", built in"), ""]
    columns = ("joint", "link", "range", "torque", "speed", "motor", "viscous", "Coulomb", "mass", "centre of mass")
    units = ("", "", "deg", "N m", "rad/s", "kg m^2", "N m s/rad", "N m", "kg", "mm from the joint, its axis is z")
    rows = [_row(joint) for joint in result["joints"]]
    lines += [*(line.rstrip() for line in aligned(columns, units, rows, text=len(columns))), ""]
    at = ", ".join(f"{1e3 * x:.4g}" for x in result["tool_m"])
    lines.append(f"tool (a payload hangs there): {result['tool']}, {at} mm from the last joint")
    lines.append(f"gravity: {', '.join(f'{g:g}' for g in result['gravity_ms2'])} m/s^2")
    titles = {
        "notes": "What was made of the file",
        "cautions": "What makes results doubtful",
        "doubts": "Looks like a placeholder",
    }
    for key, title in titles.items():
        lines += ["", f"{title}:", *(f"  {line}" for line in result[key])] if result[key] else []
    if result["recording"]:
        lines += ["", "Logs:", *(f"  {key}: {value}" for key, value in result["recording"].items())]
    return "\n".join(lines)


def _row(joint: dict[str, Any]) -> tuple[str, ...]:
    def shown(value: float | None, form: str = "{:.4g}") -> str:
        return "-" if value is None else form.format(value)

    def both(values: list[float]) -> str:
        positive, negative = values
        return f"{positive:.3g}" if positive == negative else f"+{positive:.3g} -{negative:.3g}"

    low, high = (None if joint[key] is None else math.degrees(joint[key]) for key in ("low_rad", "high_rad"))
    com = joint["com_m"]
    return (
        f"{joint['joint']} {joint['name']}",
        joint["link"],
        "-" if low is None and high is None else f"{shown(low, '{:.0f}')} to {shown(high, '{:.0f}')}",
        shown(joint["torque_limit_nm"]),
        shown(joint["speed_limit_rads"]),
        f"{joint['motor_inertia_kgm2']:.3g}",
        both(joint["viscous_nms"]),
        both(joint["coulomb_nm"]),
        f"{joint['mass_kg']:.4g}",
        "-" if com is None else ", ".join(f"{1e3 * x:.1f}" for x in com),
    )
