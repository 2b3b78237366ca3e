"""A campaign's folder: ``manifest.toml``, ``gains.toml``, ``preset.toml`` and rows in ``chunk-000123.parquet``.

Every file is written beside its place and renamed, the manifest after what it names, so that a campaign that was killed at
any moment goes on with the same command: chunks that are whole are kept, the others are run. ``SHA256SUMS`` tells which are:
a file that was changed since, by anyone or anything, is not used. A chunk holds the rows of its ids whatever the campaign's
length, so a longer campaign goes on from a shorter one.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from jaxftc.io import checksums, tables
from jaxftc.io.files import digest, write_text
from jaxftc.io.folder import differences
from jaxftc.io.toml import read_toml

MANIFEST, GAINS, PRESET, SUMMARY, REPORT = "manifest.toml", "gains.toml", "preset.toml", "summary.json", "report.html"
ABSENT, SHORTER, DAMAGED = "absent", "shorter", "not what its checksum says"  # what a chunk can be
KEPT = 4  # columns of a campaign in memory
_ROWS = f"from {tables.PARQUET} where scenario_id < $n"  # files in the order of the ids: sorting would hold copies


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
        ValueError: there is none, or it is not the one that was written.
    """
    path = folder / MANIFEST
    if not path.is_file():
        inside = sorted(str(path.parent) for path in folder.glob(f"*/{MANIFEST}"))
        if inside:
            raise ValueError(f"{folder} holds a comparison; name one of its schemes: {', '.join(inside)}")
        raise ValueError(f"{folder} holds no campaign; give the --out of jaxftc campaign")
    _as_written(path)
    return read_toml(path, "campaign")


def scheme_of(manifest: dict[str, Any]) -> str:
    """Name of the scheme that ran; of one of the user's the request has a digest of its source, too."""
    value = manifest["request"]["scheme"]
    return value[0] if isinstance(value, list) else value


def write_manifest(folder: Path, manifest: dict[str, Any]) -> None:
    """Written last, after the checksums of what rows depend on."""
    text = tomli_w.dumps(manifest)
    checksums.record(folder, {GAINS: None, PRESET: None, MANIFEST: text})
    write_text(folder / MANIFEST, text)


def check_inputs_unchanged(folder: Path) -> None:
    """Refuse to go on from files that are not those that the campaign began with.

    Raises:
        ValueError: naming the first one.
    """
    for name in (GAINS, PRESET):
        _as_written(folder / name)


def _as_written(path: Path) -> None:
    if not checksums.agrees(path):
        raise ValueError(
            f"{path} is not the file that this campaign began with; put it back, or begin anew with --force or another "
            f"--out ({checksums.NAME} has its checksum)"
        )


def check_same_request(folder: Path, request: dict[str, Any]) -> None:
    """Refuse to go on with another campaign than the folder's.

    Raises:
        ValueError: naming what differs, what the folder has and what was asked for.
    """
    other = differences(read_manifest(folder)["request"], request)
    if other:
        raise ValueError(
            f"{folder} holds another campaign: {'; '.join(other)}; give the options it was started with, another --out, "
            "or --force"
        )


def refuse_orphan_chunks(folder: Path) -> None:
    """Refuse a folder that holds rows of unknown origin.

    Raises:
        ValueError: there are chunks, but no manifest.
    """
    if any(folder.glob("chunk-*.parquet")):
        raise ValueError(f"{folder} holds chunks but no {MANIFEST} that says what they are; give another --out, or --force")


def clear(folder: Path) -> None:
    """Remove a campaign from a folder, its manifest first."""
    for path in (folder / MANIFEST, folder / checksums.NAME, *folder.glob("chunk-*.parquet")):
        path.unlink(missing_ok=True)


def chunks(folder: Path, n: int, size: int) -> Iterator[Chunk]:
    """All chunks of n rows, ``size`` in each but the last."""
    for index, first in enumerate(range(0, n, size)):
        yield Chunk(folder / f"chunk-{index:06d}.parquet", first, min(size, n - first))


def fault_of(chunk: Chunk) -> str | None:
    """What keeps a chunk's file from being used, None if nothing does.

    A file with more rows than asked for is the chunk of a longer campaign and serves this one.
    """
    if not chunk.path.exists():
        return ABSENT
    if not checksums.agrees(chunk.path):
        return DAMAGED
    with tables.connect() as connection:
        query = f"select count(*) from {tables.PARQUET}"
        ((rows,),) = connection.execute(query, {"files": tables.names([chunk.path])}).fetchall()
    return None if rows >= chunk.rows else SHORTER


def write_chunk(chunk: Chunk, rows: dict[str, np.ndarray]) -> str:
    """Write the file whole or not at all; its SHA-256, without which it is not used (``keep``).

    Raises:
        OSError: the disk is full, or the folder cannot be written.
    """
    tables.write_parquet(chunk.path, rows)
    return digest(chunk.path)


def keep(chunk: Chunk, sha256: str) -> None:
    """Add the checksum of a chunk that was written: one process's work, as all checksums are in one file."""
    checksums.add(chunk.path.parent, {chunk.path.name: sha256})


def read_rows(folder: Path, n: int, first: int = 0) -> dict[str, np.ndarray]:
    """All columns of the scenarios from ``first`` to n - 1 that are there, by their ids; nothing if there are none.

    In the files a figure that does not apply is null; here it is not a number.

    Raises:
        ValueError: a file of them is not what its checksum says.
    """
    files = _files(folder, n, first)
    with tables.connect() as connection:
        query = f"select * {_ROWS} and scenario_id >= $first"
        return _query(connection, query, {"files": files, "n": n, "first": first}) if files else {}


class Columns(Mapping[str, np.ndarray]):
    """The first n scenarios' rows, in the order of their ids: columns that are read when they are asked for.

    A few are kept, so that a million rows need no more memory than a few columns of them do.

    Raises:
        ValueError: there are none.
    """

    def __init__(self, folder: Path, n: int) -> None:
        self._rows, self._connection = {"files": _files(folder, n), "n": n}, tables.connect()
        if not self._rows["files"]:
            raise ValueError(f"{folder} holds no rows; run jaxftc campaign with --out {folder}")
        described = _query(self._connection, f"describe select * from {tables.PARQUET}", {"files": self._rows["files"]})
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


def _files(folder: Path, n: int, first: int = 0) -> list[str]:
    """Files that hold rows of the scenarios from ``first`` to n - 1, in the order of their ids."""
    found = []
    for chunk in chunks(folder, n, read_manifest(folder)["chunk"]):
        if chunk.first + chunk.rows <= first:
            continue
        fault = fault_of(chunk)
        if fault == DAMAGED:
            raise ValueError(f"{chunk.path} is {DAMAGED}; the command that made the campaign runs its rows again")
        found += [] if fault == ABSENT else [chunk.path]
    return tables.names(found)


def _query(connection: Any, query: str, parameters: dict[str, Any]) -> dict[str, np.ndarray]:
    found = connection.execute(query, parameters).fetchnumpy()
    return {
        name: np.ma.filled(column, np.nan) if column.dtype.kind == "f" else np.asarray(column)
        for name, column in found.items()
    }
