"""Recordings of any length, a piece at a time: tables are cut by rows, and each piece is read as a log of its own."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxftc.config import Config
from jaxftc.io import tables
from jaxftc.logs.log import Log
from jaxftc.logs.read import read

PIECE = 500_000  # rows


def rows(path: Path) -> int | None:
    """How many rows a table has; None for files that are read whole."""
    reader = tables.READERS.get(path.suffix.lower())
    if reader is None:
        return None
    import duckdb

    try:
        with tables.connect() as connection:
            found = connection.execute(f"select count(*) from {reader}", {"files": tables.names([path])}).fetchone()
            return None if found is None else int(found[0])
    except duckdb.Error:
        return None  # ``read`` says what is wrong with it


def pieces(
    path: Path, arm: Any, make_config: Callable[[float], Config], **options: Any
) -> Iterator[tuple[Log, float, bool]]:
    """Logs of at most PIECE rows, the time in s at which each begins, and whether it follows the one before without a gap.

    Raises:
        ValueError: as ``read``, of any piece.
    """
    count = rows(path)
    if count is None or count <= PIECE:
        yield read(path, arm, **options), 0.0, False
        return
    with tempfile.TemporaryDirectory() as folder:
        part, begins, last, config = Path(folder) / path.with_suffix(".parquet").name, 0.0, None, None
        for first in range(0, count, PIECE):
            reader = tables.READERS[path.suffix.lower()]
            with tables.connect() as connection:
                query = f"copy (select * from {reader} limit {PIECE + 1} offset {first}) to $out (format parquet)"
                connection.execute(query, {"files": tables.names([path]), "out": str(part)})
            source: Any = arm if config is None else config
            log = read(part, source, **options)
            config = config or make_config(log.dt or 0.0)
            if last is not None:  # a piece takes the first row of the next one with it: the same reading
                turns = 2 * np.pi * np.round((last.q[-1] - log.q[0]) / (2 * np.pi))
                log = log._replace(q=log.q + turns)
            whole = len(log.stretches) == 1 and first + PIECE < count
            t, jitter = (None if part is None else part[:-1] for part in (log.t, log.jitter))
            kept = log._replace(q=log.q[:-1], tau=log.tau[:-1], t=t, jitter=jitter, segments=())
            yield (kept if whole else log), begins, last is not None and len(last.stretches) == 1
            begins += float(log.t[-1]) if log.t is not None else len(log.q) * config.dt
            last = log
            if isinstance(arm, Config) or not dataclasses.is_dataclass(arm):
                continue
            options |= {"recording": getattr(arm, "recording", None)}
