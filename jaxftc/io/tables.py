"""Parquet and CSV, by DuckDB: the one place that names files to it.

To DuckDB a file's name is a pattern (``[1]``, ``*``), may name columns (``kind=sensor``), a home folder (``~``) or a
server. Here it is a file.
"""

from __future__ import annotations

import functools
import glob
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxftc.io.files import atomic_path

if TYPE_CHECKING:
    import duckdb
    import numpy as np

PARQUET = "read_parquet($files, hive_partitioning = false)"  # of ``names``
READERS = {".parquet": PARQUET, ".pq": PARQUET, ".csv": "read_csv($files, hive_partitioning = false)"}


@functools.cache
def _database() -> duckdb.DuckDBPyConnection:
    """One in memory for all connections of the process; it loads nothing from elsewhere."""
    import duckdb

    return duckdb.connect(config={"autoinstall_known_extensions": False, "autoload_known_extensions": False})


def connect() -> duckdb.DuckDBPyConnection:
    """A connection of one's own."""
    return _database().cursor()


def names(paths: Iterable[Path]) -> list[str]:
    """Names of files to read, for ``$files`` of a query: patterns that match just them."""
    return [glob.escape(os.path.abspath(path)) for path in paths]


def read(path: Path) -> dict[str, np.ndarray]:
    """All columns of a .parquet or .csv file; entries that are absent are masked.

    Raises:
        ValueError: it cannot be read, or has another ending.
    """
    import duckdb

    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"a table must be a .csv or .parquet file, got {path}")
    try:
        with connect() as connection:
            return connection.execute(f"select * from {reader}", {"files": names([path])}).fetchnumpy()
    except (duckdb.Error, UnicodeError) as error:
        raise ValueError(f"cannot read {path}: {str(error).splitlines()[0]}") from error


def count(path: Path) -> int:
    """Rows of a Parquet file.

    Raises:
        ValueError: it cannot be read.
    """
    import duckdb

    try:
        with connect() as connection:
            found = connection.execute(f"select count(*) from {PARQUET}", {"files": names([path])}).fetchone()
    except duckdb.Error as error:
        raise ValueError(f"cannot read {path}: {str(error).splitlines()[0]}") from error
    return 0 if found is None else int(found[0])


def copy(path: Path, to: Path, rows: int, first: int) -> None:
    """Copy at most ``rows`` rows of a Parquet file, from the row ``first`` on, counted from 0."""
    with connect() as connection:
        query = f"copy (select * from {PARQUET} limit {rows} offset {first}) to $to (format parquet, use_tmp_file false)"
        connection.execute(query, {"files": names([path]), "to": os.path.abspath(to)})


def write_parquet(path: Path, columns: dict[str, Any]) -> None:
    """Write columns of equal length whole or not at all.

    Raises:
        ValueError: two names differ in nothing but their case; DuckDB would drop a column.
        OSError: the disk is full, or the folder cannot be written.
    """
    import duckdb

    seen: dict[str, str] = {}
    for name in columns:
        other = seen.setdefault(name.lower(), name)
        if other != name:
            raise ValueError(f"columns {other!r} and {name!r} of {path.name} have one name but for their case; rename one")
    with atomic_path(path) as temporary, connect() as connection:
        connection.register("columns", columns)
        try:
            to = {"path": os.path.abspath(temporary)}
            connection.execute("copy columns to $path (format parquet, use_tmp_file false)", to)
        except duckdb.IOException as error:
            raise OSError(f"cannot write {path}: {error}") from error
