"""File formats of logs: which module reads which suffix. A new format is one file and one line here.

A reader takes a path and returns a ``Table``. Nothing is interpreted there: names and values are as the file has them.
"""

from __future__ import annotations

import importlib
from pathlib import Path
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


class Table(NamedTuple):
    """Columns of equal length, in the order of the file; numbers, stamps, or text that may hold either."""

    columns: dict[str, np.ndarray]  # name -> [rows]
    notes: tuple[str, ...] = ()  # what a user should know about the file, one line each
    named: bool = True  # the file names its columns


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
