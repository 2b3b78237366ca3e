"""A campaign's folder: ``manifest.toml``, ``gains.toml``, ``preset.toml`` and rows in ``chunk-000123.parquet``.

Every file is written aside and renamed, the manifest after what it names, so that a campaign that was killed at any moment
goes on with the same command: chunks that are whole are kept, the others are run. A chunk holds the rows of its ids whatever
the campaign's length, so a longer campaign goes on from a shorter one.
"""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from jaxftc.files import write_parquet, write_text

MANIFEST, GAINS, PRESET, SUMMARY, REPORT = "manifest.toml", "gains.toml", "preset.toml", "summary.json", "report.html"


class Chunk(NamedTuple):
    """Rows of one file."""

    path: Path
    first: int  # scenario id
    rows: int

    @property
    def ids(self) -> np.ndarray:
        """Scenario ids of its rows."""
        return np.arange(self.first, self.first + self.rows, dtype=np.int32)


def fingerprint(text: str) -> str:
    """Of a file's content."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def read_manifest(folder: Path) -> dict[str, Any]:
    """What the folder's campaign is.

    Raises:
        ValueError: there is none, or it cannot be read.
    """
    try:
        return tomllib.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(
            f"{folder} holds no campaign that can be read: {error}; give the --out of jaxftc campaign"
        ) from error


def write_manifest(folder: Path, manifest: dict[str, Any]) -> None:
    """Written last of the files it names."""
    write_text(folder / MANIFEST, tomli_w.dumps(manifest))


def agree(folder: Path, request: dict[str, Any]) -> None:
    """Refuse to go on with another campaign than the folder's.

    Raises:
        ValueError: naming what differs, what the folder has and what was asked for.
    """
    had = read_manifest(folder).get("request", {})
    names = {"gains_from": "gains"}
    other = [
        f"--{names.get(key, key).replace('_', '-')} {had.get(key, 'unset')!r}, asked for {request.get(key, 'unset')!r}"
        for key in sorted({*had, *request})
        if had.get(key) != request.get(key)
    ]
    if other:
        raise ValueError(
            f"{folder} holds another campaign: {'; '.join(other)}; give the options it was started with, or another --out"
        )


def chunks(folder: Path, n: int, size: int) -> Iterator[Chunk]:
    """All chunks of n rows, ``size`` in each but the last."""
    for index, first in enumerate(range(0, n, size)):
        yield Chunk(folder / f"chunk-{index:06d}.parquet", first, min(size, n - first))


def fault_of(chunk: Chunk) -> str | None:
    """What keeps a chunk's file from being used, None if nothing does; ``absent`` if it is not there."""
    import duckdb

    if not chunk.path.exists():
        return "absent"
    query = "select count(*), count(distinct scenario_id), min(scenario_id), max(scenario_id) from read_parquet($path)"
    try:
        with duckdb.connect() as connection:
            found = connection.execute(query, {"path": str(chunk.path)}).fetchone()
    except duckdb.Error:
        return "torn"
    wanted = (chunk.rows, chunk.rows, chunk.first, chunk.first + chunk.rows - 1)
    return None if found == wanted else "of another length"


def write_chunk(chunk: Chunk, rows: dict[str, np.ndarray]) -> None:
    """Whole or not at all.

    Raises:
        OSError: the disk is full, or the folder cannot be written.
    """
    write_parquet(chunk.path, rows)


def read_rows(folder: Path, n: int, columns: str = "*", where: str = "true") -> dict[str, np.ndarray]:
    """Columns of the first n scenarios in the order of their ids; ``where`` is a condition in SQL.

    In the files a figure that does not apply is null; here it is not a number.
    """
    import duckdb

    query = f"select {columns} from read_parquet($files) where scenario_id < $n and ({where}) order by scenario_id"
    with duckdb.connect() as connection:
        found = connection.execute(query, {"files": str(folder / "chunk-*.parquet"), "n": n}).fetchnumpy()
    return {
        name: np.ma.filled(column, np.nan) if column.dtype.kind == "f" else np.asarray(column)
        for name, column in found.items()
    }
