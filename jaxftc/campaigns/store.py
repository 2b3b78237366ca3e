"""A campaign's folder: ``manifest.toml``, ``gains.toml``, ``preset.toml`` and rows in ``chunk-000123.parquet``.

Every file is written aside and renamed, the manifest after what it names, so that a campaign that was killed at any moment
goes on with the same command: chunks that are whole are kept, the others are run. A chunk holds the rows of its ids whatever
the campaign's length, so a longer campaign goes on from a shorter one.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from jaxftc.io.files import write_parquet, write_text

MANIFEST, GAINS, PRESET, SUMMARY, REPORT = "manifest.toml", "gains.toml", "preset.toml", "summary.json", "report.html"
KEPT = 4  # columns of a campaign in memory
_ROWS = "from read_parquet($files) where scenario_id < $n"  # files in the order of the ids: sorting would hold copies


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
        inside = sorted(str(path.parent) for path in folder.glob(f"*/{MANIFEST}"))
        if inside:
            raise ValueError(f"{folder} holds a comparison; name one of its schemes: {', '.join(inside)}") from error
        raise ValueError(
            f"{folder} holds no campaign that can be read: {error}; give the --out of jaxftc campaign"
        ) from error


def write_manifest(folder: Path, manifest: dict[str, Any]) -> None:
    """Written last, with the fingerprints of the files that rows depend on."""
    files = {name: fingerprint((folder / name).read_text(encoding="utf-8")) for name in (GAINS, PRESET)}
    write_text(folder / MANIFEST, tomli_w.dumps(manifest | {"files": files}))


def unaltered(folder: Path) -> None:
    """Refuse to go on from files that are not those that the campaign began with.

    Raises:
        ValueError: naming the first one.
    """
    for name, mark in read_manifest(folder).get("files", {}).items():
        path = folder / name
        if not path.exists() or fingerprint(path.read_text(encoding="utf-8")) != mark:
            raise ValueError(
                f"{path} is not the file that this campaign began with; put it back, or begin anew with another --out"
            )


def agree(folder: Path, request: dict[str, Any]) -> None:
    """Refuse to go on with another campaign than the folder's.

    A value that is a list is a file: its name, for people, and the fingerprint of its content, which counts.

    Raises:
        ValueError: naming what differs, what the folder has and what was asked for.
    """
    had = read_manifest(folder).get("request", {})

    def counts(value: Any) -> Any:
        return value[-1] if isinstance(value, list) else value

    def shown(value: Any) -> str:
        return "unset" if value is None else " of content ".join(value) if isinstance(value, list) else repr(value)

    other = [
        f"--{key.replace('_', '-')} {shown(had.get(key))}, asked for {shown(request.get(key))}"
        for key in sorted({*had, *request})
        if counts(had.get(key)) != counts(request.get(key))
    ]
    if other:
        raise ValueError(
            f"{folder} holds another campaign: {'; '.join(other)}; give the options it was started with, or another --out"
        )


@contextlib.contextmanager
def held(folder: Path) -> Iterator[None]:
    """The folder for this process alone; the system lets go of it when the process ends, however it ends.

    Raises:
        ValueError: another process runs a campaign in it.
    """
    try:
        import fcntl
    except ImportError:  # a system without it: nothing keeps two campaigns apart
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError as error:
        raise ValueError(f"another campaign is running in {folder}; wait for it, or give another --out") from error
    finally:
        os.close(handle)


def empty(folder: Path) -> None:
    """Refuse a folder that holds rows of unknown origin.

    Raises:
        ValueError: there are chunks, but no manifest.
    """
    if any(folder.glob("chunk-*.parquet")):
        raise ValueError(f"{folder} holds chunks but no {MANIFEST} that says what they are; give another --out")


def chunks(folder: Path, n: int, size: int) -> Iterator[Chunk]:
    """All chunks of n rows, ``size`` in each but the last."""
    for index, first in enumerate(range(0, n, size)):
        yield Chunk(folder / f"chunk-{index:06d}.parquet", first, min(size, n - first))


def fault_of(chunk: Chunk) -> str | None:
    """What keeps a chunk's file from being used, None if nothing does; ``absent`` if it is not there.

    A file with more rows than asked for is the chunk of a longer campaign and serves this one.
    """
    import duckdb

    if not chunk.path.exists():
        return "absent"
    query = "select count(*), count(distinct scenario_id), min(scenario_id), max(scenario_id) from read_parquet($path)"
    try:
        with duckdb.connect() as connection:
            found = connection.execute(query, {"path": str(chunk.path)}).fetchone()
    except duckdb.Error:
        return "torn"
    rows, different, first, last = found or (0, 0, None, None)
    if first != chunk.first or different != rows or last != chunk.first + rows - 1:
        return "not this campaign's"
    return None if rows >= chunk.rows else "shorter"


def write_chunk(chunk: Chunk, rows: dict[str, np.ndarray]) -> None:
    """Whole or not at all.

    Raises:
        OSError: the disk is full, or the folder cannot be written.
    """
    write_parquet(chunk.path, rows)


def read_rows(folder: Path, n: int, where: str = "true") -> dict[str, np.ndarray]:
    """All columns of the first n scenarios that are there, in the order of their ids; nothing if there are none.

    ``where`` is a condition in SQL.

    In the files a figure that does not apply is null; here it is not a number.
    """
    import duckdb

    files = _files(folder, n)
    with duckdb.connect() as connection:
        return _query(connection, f"select * {_ROWS} and ({where})", {"files": files, "n": n}) if files else {}


class Columns(Mapping[str, np.ndarray]):
    """The first n scenarios' rows, in the order of their ids: columns that are read when they are asked for.

    A few are kept, so that a million rows need no more memory than a few columns of them do.

    Raises:
        ValueError: there are none.
    """

    def __init__(self, folder: Path, n: int) -> None:
        import duckdb

        self._rows, self._connection = {"files": _files(folder, n), "n": n}, duckdb.connect()
        if not self._rows["files"]:
            raise ValueError(f"{folder} holds no rows; run jaxftc campaign with --out {folder}")
        described = _query(self._connection, "describe select * from read_parquet($files)", {"files": self._rows["files"]})
        self._types = dict(zip(described["column_name"], described["column_type"], strict=True))
        self._read = functools.lru_cache(maxsize=KEPT)(self._fresh)

    def _fresh(self, name: str) -> np.ndarray:
        if self._types[name] != "VARCHAR":
            return _query(self._connection, f'select "{name}" {_ROWS}', self._rows)[name]
        texts = np.sort(_query(self._connection, f'select distinct "{name}" {_ROWS}', self._rows)[name])  # each once
        place = f'select list_position($texts, "{name}") - 1 as place {_ROWS}'
        return texts[_query(self._connection, place, self._rows | {"texts": texts.tolist()})["place"]]

    def __getitem__(self, name: str) -> np.ndarray:
        return self._read(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._types)

    def __len__(self) -> int:
        return len(self._types)


def _files(folder: Path, n: int) -> list[str]:
    """Files that hold rows of the first n scenarios, in the order of their ids."""
    return [str(c.path) for c in chunks(folder, n, read_manifest(folder)["chunk"]) if fault_of(c) in (None, "shorter")]


def _query(connection: Any, query: str, parameters: dict[str, Any]) -> dict[str, np.ndarray]:
    found = connection.execute(query, parameters).fetchnumpy()
    return {
        name: np.ma.filled(column, np.nan) if column.dtype.kind == "f" else np.asarray(column)
        for name, column in found.items()
    }
