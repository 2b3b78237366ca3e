"""Logs as ROS 2 bags of ``sensor_msgs/JointState``: an SQLite file (.db3), MCAP, or the folder that ros2 bag writes.

An SQLite file is read as it is, without metadata beside it. MCAP and compressed bags take the extra ``logs`` (rosbags).
"""

from __future__ import annotations

import contextlib
import sqlite3
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from jaxftc.logs.formats import Table

TYPE = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
PLAIN = "/joint_states"  # where robots publish; taken if there are several


def read(path: Path) -> Table:
    """Stamps (ns, from the message's head where it is set) and ``<joint>.position``, ``.velocity``, ``.effort``.

    Raises:
        ValueError: no JointState in the bag, a damaged message, or the extra ``logs`` is needed and not installed.
    """
    messages = _sqlite(path) if path.suffix.lower() == ".db3" else _rosbags(path)
    topic, count = "", 0
    publishers: dict[frozenset[str], tuple[list[str], list[int], list[tuple[np.ndarray, ...]]]] = {}
    for at, received, data in messages:
        topic, count = at, count + 1
        try:
            stamp, found, signals = joint_state(data)
        except (struct.error, UnicodeDecodeError, IndexError, ValueError) as error:
            raise ValueError(f"{path}: message {count} on {topic} is damaged ({error}); cut the bag there") from error
        names, stamps, values = publishers.setdefault(frozenset(found), (found, [], []))
        if found != names:
            signals = tuple(s[[found.index(name) for name in names]] if len(s) else s for s in signals)
        stamps.append(stamp or received)
        values.append(signals)
    if not any(publishers):
        raise ValueError(f"{path}: there is no message of sensor_msgs/JointState in the bag; record /joint_states")
    names, stamps, values = max(publishers.values(), key=lambda one: (len(one[0]), len(one[1])))  # not a gripper's
    dropped, notes = count - len(stamps), []
    if dropped:
        notes.append(f"{dropped} messages on {topic} name other joints than {', '.join(names)} and are left out")
    columns: dict[str, np.ndarray] = {"t_ns": np.array(stamps, np.int64)}
    for word, rows in zip(("position", "velocity", "effort"), zip(*values, strict=True), strict=True):
        lengths = {len(row) for row in rows}
        if lengths == {len(names)}:
            columns |= {f"{name}.{word}": column for name, column in zip(names, np.array(rows).T, strict=True)}
        elif lengths != {0}:
            row = next(k for k, r in enumerate(rows, start=1) if len(r) != len(names))
            raise ValueError(f"{path}: message {row} has {len(rows[row - 1])} values of {word} for {len(names)} joints")
    return Table(columns, tuple(notes))


def joint_state(data: bytes) -> tuple[int, list[str], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Stamp in ns, joint names, and positions, velocities, efforts of one message in CDR."""
    order = "<" if data[1] & 1 else ">"
    place = 4  # behind the encapsulation's head; alignment counts from here

    def number() -> int:
        nonlocal place
        place += -(place - 4) % 4
        (value,) = struct.unpack_from(order + "I", data, place)
        place += 4
        return value

    def text() -> str:
        nonlocal place
        size = number()
        place += size
        return data[place - size : place - 1].decode()

    def doubles() -> np.ndarray:
        nonlocal place
        count = number()
        place += -(place - 4) % 8 if count else 0
        place += 8 * count
        return np.frombuffer(data, order + "f8", count, place - 8 * count).astype(float)

    stamp = number() * 1_000_000_000 + number()
    text()  # frame
    names = [text() for _ in range(number())]
    return stamp, names, (doubles(), doubles(), doubles())


def _chosen(path: Path, topics: list[str]) -> str:
    if not topics:
        raise ValueError(f"{path}: there is no topic of sensor_msgs/JointState in the bag; record /joint_states")
    if len(topics) > 1 and PLAIN not in topics:
        raise ValueError(f"{path}: joint states are on {', '.join(topics)}; keep one of them (ros2 bag convert)")
    return PLAIN if PLAIN in topics else topics[0]


def _sqlite(path: Path) -> Iterator[tuple[str, int, bytes]]:
    try:  # immutable: nothing is written beside a file that may be in a folder without permission
        database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
        with contextlib.closing(database) as connection:
            topics = {
                name: key for key, name, kind in connection.execute("select id, name, type from topics") if kind in TYPE
            }
            topic = _chosen(path, list(topics))
            order = "select timestamp, data from messages where topic_id = ? order by timestamp"
            for received, data in connection.execute(order, (topics[topic],)):
                yield topic, received, data
    except sqlite3.Error as error:
        raise ValueError(f"cannot read {path}: {error}; is it a rosbag2 file?") from error


def _rosbags(path: Path) -> Iterator[tuple[str, int, bytes]]:
    try:
        from rosbags.rosbag2 import Reader, ReaderError  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError as error:
        raise ValueError(f"{path}: reading this takes rosbags; pip install 'jaxftc[logs]'") from error
    try:
        with Reader(path) as bag:
            kept = [c for c in bag.connections if c.msgtype in TYPE]
            topic = _chosen(path, sorted({c.topic for c in kept}))
            for _, received, data in bag.messages([c for c in kept if c.topic == topic]):
                yield topic, received, bytes(data)
    except (ReaderError, FileNotFoundError, KeyError) as error:
        raise ValueError(f"cannot read {path}: {error}; is it a rosbag2?") from error
