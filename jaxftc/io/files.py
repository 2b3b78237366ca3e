"""Files that are whole or not there: written aside, then renamed."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np


@contextlib.contextmanager
def aside(path: Path) -> Iterator[Path]:
    """A path beside ``path`` to write to; it takes the place of ``path`` when the block ends without an error.

    What was written is on the disk before it takes that place; after an error it is removed.
    """
    temporary = path.with_name(path.name + ".tmp")
    try:
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    with aside(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_parquet(path: Path, columns: dict[str, np.ndarray]) -> None:
    """Write columns of equal length whole or not at all.

    Raises:
        ValueError: two names differ in nothing but their case; DuckDB would drop a column.
        OSError: the disk is full, or the folder cannot be written.
    """
    import duckdb

    seen: dict[str, str] = {}
    for name in columns:
        if name.lower() in seen:
            raise ValueError(
                f"columns {seen[name.lower()]!r} and {name!r} of {path.name} have one name but for their case; rename one"
            )
        seen[name.lower()] = name

    with aside(path) as temporary, duckdb.connect() as connection:
        connection.register("columns", columns)
        try:
            connection.execute("copy columns to $path (format parquet)", {"path": str(temporary)})
        except duckdb.IOException as error:
            raise OSError(f"cannot write {path}: {error}") from error
