"""The tables of an arm's own file: what each key is, and an arm of them and back."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxftc.robot.link import Link
from jaxftc.robot.model import Robot
from jaxftc.robot.model_file import read_model
from jaxftc.robot.puma560 import puma560

BUILT_IN = "puma560"
JOINT_KEYS: dict[str, tuple[str, ...]] = {  # of [joints.NAME]: fields of Robot; two fields are positive and negative speed
    "torque_limit_nm": ("torque_limit",),
    "motor_inertia_kgm2": ("armature",),
    "coulomb_nm": ("coulomb_positive", "coulomb_negative"),
    "viscous_nms": ("damping_positive", "damping_negative"),
    "range_rad": ("q_low", "q_high"),
    "speed_limit_rads": ("speed_limit",),
}
MAY_BE_INFINITE = ("torque_limit_nm", "range_rad", "speed_limit_rads")
LINK_KEYS = {"mass_kg": "mass", "moment_kgm": "moment", "inertia_kgm2": "inertia"}  # of [links.NAME]
LOG_KEYS = ("sample_time_s", "torque_gain", "torque_offset_nm", "encoder_resolution_rad", "encoder_noise_rad", "columns")
COLUMNS = ("t", "q", "tau", "qd")  # of [log.columns]
TOP_KEYS = ("model", "tip", "lock", "gravity_ms2", "coulomb_speed_rads", "joints", "links", "log")
UPPER = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)  # xx yy zz xy xz yz of a tensor


@dataclasses.dataclass(frozen=True)
class Recording:
    """How an arm's logs are read; None where the arm's file says nothing."""

    sample_time: float | None = None  # s
    torque_gain: tuple[float, ...] | None = None  # [n] N m a unit of the log: 1 for N m, the torque constant for A
    torque_offset: tuple[float, ...] | None = None  # [n] N m, added after the gain
    encoder_resolution: tuple[float, ...] | None = None  # [n] rad a count
    encoder_noise: tuple[float, ...] | None = None  # [n] rad, standard deviation
    columns: tuple[tuple[str, tuple[str, ...]], ...] = ()  # t, q, tau, qd: names of the log's columns, joints in order


@dataclasses.dataclass(frozen=True)
class Arm:
    """A robot, and how its logs are read."""

    robot: Robot
    recording: Recording = Recording()


def from_table(table: dict[str, Any], folder: Path) -> Arm:
    """The arm of an arm's file in ``folder``.

    Raises:
        ValueError: an unknown key, or a number that no arm can have.
    """
    return _Reader(table).arm(folder)


def to_table(arm: Arm, folder: Path) -> dict[str, Any]:
    """Its model's path from ``folder``, and every number in which the arm differs from that file."""
    robot, source = arm.robot, arm.robot.source
    if source is None and not robot.name.startswith(BUILT_IN):
        raise ValueError(f"{robot.name!r} did not come from a file, so there is none to name; load_robot it from one first")
    if source is None:
        base, table = puma560(), {"model": BUILT_IN}
    else:
        base = read_model(source.path, tip=source.tip, lock=dict(source.lock))
        table: dict[str, Any] = {"model": Path(os.path.relpath(source.path.resolve(), folder.resolve())).as_posix()}
        table |= {} if source.tip is None else {"tip": source.tip}
        table |= {"lock": dict(source.lock)} if source.lock else {}
    for field in ("q_zero", "payload_link", "joint_names"):
        if not _same(getattr(robot, field), getattr(base, field)):
            raise ValueError(f"{robot.name!r} differs from its model's file in {field}, which an arm's file cannot hold")
    table |= {} if _same(robot.gravity, base.gravity) else {"gravity_ms2": robot.gravity.tolist()}
    table |= {} if robot.coulomb_speed == base.coulomb_speed else {"coulomb_speed_rads": float(robot.coulomb_speed)}
    joints: dict[str, dict[str, Any]] = {}
    for key, fields in JOINT_KEYS.items():
        for j, name in enumerate(robot.joint_names):
            values, before = ([float(getattr(r, field)[j]) for field in fields] for r in (robot, base))
            if values != before:
                joints.setdefault(name, {})[key] = values if len(set(values)) > 1 else values[0]
    links: dict[str, dict[str, Any]] = {}
    for name, link, before in zip(robot.link_names, robot.links, base.links, strict=True):
        for key, field in LINK_KEYS.items():
            value = getattr(link, field)
            if not _same(value, getattr(before, field)):
                flat = value[UPPER] if field == "inertia" else value
                links.setdefault(name, {})[key] = np.asarray(flat, float).tolist()
    log = _log_as_table(arm.recording)
    return table | {key: value for key, value in (("joints", joints), ("links", links), ("log", log)) if value}


def _same(one: Any, other: Any) -> bool:
    """Whether two fields of a robot hold the same numbers."""
    if isinstance(one, Link):
        return all(_same(getattr(one, f.name), getattr(other, f.name)) for f in dataclasses.fields(Link))
    return bool(np.array_equal(one, other))


def _log_as_table(recording: Recording) -> dict[str, Any]:
    values = (recording.sample_time, recording.torque_gain, recording.torque_offset, recording.encoder_resolution)
    found: dict[str, Any] = dict(zip(LOG_KEYS, (*values, recording.encoder_noise), strict=False))
    found = {key: list(value) if isinstance(value, tuple) else value for key, value in found.items() if value is not None}
    columns = {key: names[0] if key == "t" else list(names) for key, names in recording.columns}
    return found | ({"columns": columns} if columns else {})


class _Reader:
    """The tables of a file, checked as they are taken."""

    def __init__(self, table: dict[str, Any]) -> None:
        self.table = table

    def arm(self, folder: Path) -> Arm:
        """The arm: its model, read from ``folder``, with the file's numbers in place of the model's."""
        _known("", self.table, TOP_KEYS)
        model, tip = self.table.get("model"), self.table.get("tip")
        if not isinstance(model, str) or not model:
            raise ValueError(f"model must name the MJCF or URDF file, such as model = 'arm.urdf', got {model!r}")
        if tip is not None and not isinstance(tip, str):
            raise ValueError(f"tip must name a link, got {tip!r}")
        lock = self._subtable(self.table, "", "lock")
        lock = {name: _number(f"lock.{name}", value) for name, value in lock.items()}
        if model == BUILT_IN:
            if tip is not None or lock:
                raise ValueError("tip and lock do nothing with the built-in arm; leave them out")
            robot = puma560()
        elif Path(model).suffix == ".toml":
            raise ValueError(f"model must be an MJCF or URDF file, got {model!r}")
        else:
            robot = read_model(folder / model, tip=tip, lock=lock)
        return Arm(self._numbers(robot), self._recording(robot))

    def _subtable(self, table: dict[str, Any], place: str, key: str) -> dict[str, Any]:
        found = table.get(key, {})
        if not isinstance(found, dict):
            raise ValueError(f"{place}{key} must be a table, got {found!r}")
        return found

    def _numbers(self, robot: Robot) -> Robot:
        numbers: dict[str, Any] = {}
        joints = self._subtable(self.table, "", "joints")
        _known("joints.", joints, robot.joint_names)
        for name in joints:
            entries, j = self._subtable(joints, "joints.", name), robot.joint_names.index(name)
            _known(f"joints.{name}.", entries, tuple(JOINT_KEYS))
            for key, value in entries.items():
                fields = JOINT_KEYS[key]
                if key == "range_rad" and not isinstance(value, list):
                    raise ValueError(f"joints.{name}.{key} must be [low, high], got {value!r}")
                given = _numbers(f"joints.{name}.{key}", value, len(fields), infinite=key in MAY_BE_INFINITE)
                for field, number in zip(fields, given, strict=True):
                    numbers.setdefault(field, getattr(robot, field).copy())[j] = number
        links = self._subtable(self.table, "", "links")
        _known("links.", links, robot.link_names)
        changed = list(robot.links)
        for name in links:
            entries, j = self._subtable(links, "links.", name), robot.link_names.index(name)
            _known(f"links.{name}.", entries, tuple(LINK_KEYS))
            for key, value in entries.items():
                changed[j] = dataclasses.replace(
                    changed[j], **{LINK_KEYS[key]: _inertial(f"links.{name}.{key}", key, value)}
                )
        if "gravity_ms2" in self.table:
            numbers["gravity"] = np.array(_many("gravity_ms2", self.table["gravity_ms2"], 3, _number, "number"))
        if "coulomb_speed_rads" in self.table:
            numbers["coulomb_speed"] = _number("coulomb_speed_rads", self.table["coulomb_speed_rads"])
        return robot.replace(**numbers, links=tuple(changed)) if numbers or links else robot

    def _recording(self, robot: Robot) -> Recording:
        log = self._subtable(self.table, "", "log")
        _known("log.", log, LOG_KEYS)
        given = {key: _numbers(f"log.{key}", log[key], robot.n) for key in LOG_KEYS[1:5] if key in log}
        for key in ("encoder_resolution_rad", "encoder_noise_rad"):
            if min(given.get(key, (0.0,))) < 0:
                raise ValueError(f"log.{key} must not be negative, got {log[key]!r}")
        if 0.0 in given.get("torque_gain", ()):
            raise ValueError(f"log.torque_gain must not be zero, got {log['torque_gain']!r}; it is N m a unit of the log")
        time = _number("log.sample_time_s", log["sample_time_s"]) if "sample_time_s" in log else None
        if time is not None and time <= 0:
            raise ValueError(f"log.sample_time_s must be above zero, got {time!r}")
        columns = self._subtable(log, "log.", "columns")
        _known("log.columns.", columns, COLUMNS)
        names = tuple(
            (key, _names(f"log.columns.{key}", value, 1 if key == "t" else robot.n)) for key, value in columns.items()
        )
        return Recording(time, *(given.get(key) for key in LOG_KEYS[1:5]), columns=names)


def _known(place: str, table: dict[str, Any], allowed: tuple[str, ...]) -> None:
    for key in table:
        if key not in allowed:
            near = difflib.get_close_matches(key, allowed, n=1, cutoff=0.5)
            hint = f"; did you mean {near[0]!r}?" if near else f"; allowed are {', '.join(allowed)}"
            raise ValueError(f"unknown key {place + key!r}{hint}")


def _number(place: str, value: Any, *, infinite: bool = False) -> float:
    real = isinstance(value, int | float) and not isinstance(value, bool)
    if not real or math.isnan(value) or (math.isinf(value) and not infinite):
        raise ValueError(f"{place} must be a {'' if infinite else 'finite '}number, got {value!r}")
    return float(value)


def _numbers(place: str, value: Any, count: int, *, infinite: bool = False) -> tuple[float, ...]:
    """``count`` numbers; a single one stands for all."""
    each = functools.partial(_number, infinite=infinite)
    return _many(place, value, count, each, "number") if isinstance(value, list) else (each(place, value),) * count


def _names(place: str, value: Any, count: int) -> tuple[str, ...]:
    def name(place: str, value: Any) -> str:
        if not isinstance(value, str) or not value:
            raise ValueError(f"{place} must be a column's name, got {value!r}")
        return value

    return _many(place, [value] if count == 1 and not isinstance(value, list) else value, count, name, "name")


def _many(place: str, value: Any, count: int, each: Callable[[str, Any], Any], word: str) -> tuple[Any, ...]:
    if not isinstance(value, list) or len(value) != count:
        got = f"{len(value)}" if isinstance(value, list) else repr(value)
        raise ValueError(f"{place} must hold {count} {word}s, got {got}")
    return tuple(each(place, one) for one in value)


def _inertial(place: str, key: str, value: Any) -> Any:
    if key == "mass_kg":
        return _number(place, value)
    numbers = np.array(_many(place, value, 3 if key == "moment_kgm" else 6, _number, "number"))
    if key == "moment_kgm":
        return numbers
    xx, yy, zz, xy, xz, yz = numbers
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
