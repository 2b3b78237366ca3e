"""File formats of logs: which module reads which suffix. A new format is one file and one line here.

A reader takes a path and returns a ``Table``. Nothing is interpreted there: names and values are as the file has them.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

READERS = {  # suffix: module
    ".csv": "text",
    ".tsv": "text",
    ".txt": "text",
    ".dat": "text",
    ".log": "text",
    ".parquet": "parquet",
    ".pq": "parquet",
    ".db3": "rosbag",
    ".mcap": "rosbag",
    "": "rosbag",  # a folder, as ros2 bag writes it
}

UNITS = {
    "s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "usec": 1e-6,
    "ns": 1e-9, "nsec": 1e-9, "min": 60.0, "h": 3600.0, "deg": "deg", "degree": "deg", "degrees": "deg", "°": "deg",
    "mrad": "mrad", "rev": "turn", "revs": "turn", "turn": "turn", "turns": "turn", "rad": "rad", "radian": "rad",
    "radians": "rad", "nm": "N m", "mnm": "mN m", "ncm": "N cm", "a": "A", "amp": "A", "amps": "A", "ma": "mA", "%": "%",
    "percent": "%", "‰": "permille", "permille": "permille",
}  # fmt: skip


def unit_named(text: str) -> float | str | None:
    """The unit that a text such as ``N·m`` names: a number of seconds, or a name; None where it names none."""
    return UNITS.get(re.sub(r"[\s·⋅*.-]", "", text.lower()))


class Table(NamedTuple):
    """Columns of equal length, in the order of the file; numbers, stamps, or text that may hold either."""

    columns: dict[str, np.ndarray]  # name -> [rows]
    notes: tuple[str, ...] = ()  # what a user should know about the file, one line each
    named: bool = True  # the file names its columns
    units: Mapping[str, str] = MappingProxyType({})  # column -> unit, where the file has a row of them


def table(path: Path) -> Table:
    """The table in a file.

    Raises:
        ValueError: no such file, an unknown suffix, or a file that its reader refuses.
    """
    reader = READERS.get("" if path.is_dir() else path.suffix.lower() or "?")
    if reader is None:
        known = ", ".join(suffix for suffix in READERS if suffix)
        raise ValueError(f"{path}: a log is one of {known}, or the folder of a rosbag2; convert it, for instance to .csv")
    if not path.exists():
        raise ValueError(f"cannot read {path}: there is no such file")
    try:
        found = importlib.import_module(f"jaxftc.logs.{reader}").read(path)
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error}") from error
    if not found.columns or not len(next(iter(found.columns.values()))):
        raise ValueError(f"{path}: the file has no rows; record a motion")
    return found
