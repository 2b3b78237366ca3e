"""Recordings of any length, a piece at a time: tables are cut by rows, and each piece is read as a log of its own."""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxftc.config import Config
from jaxftc.logs.formats import READERS
from jaxftc.logs.log import Log
from jaxftc.logs.read import read

PIECE = 200_000  # rows, at most
SAME = 1e-2  # sample times that pass as none


def rows(path: Path) -> int | None:
    """How many rows a table has; None for files that are read whole.

    Raises:
        ValueError: it cannot be read.
    """
    count = getattr(_reader(path), "count", None)
    return count(path) if count and path.is_file() else None  # of a file that is not there, ``read`` says so


def pieces(
    path: Path, arm: Any, make_config: Callable[[float], Config], **options: Any
) -> Iterator[tuple[Log, float, bool]]:
    """Logs of at most PIECE rows, the time in s at which each begins, and whether it follows the one before without a gap.

    What the first piece says of the sample time and of degrees holds for all.

    Raises:
        ValueError: as ``read``, of any piece.
    """
    count = rows(path)
    if count is None or count <= PIECE:
        yield read(path, arm, **options), 0.0, False
        return
    size = -(-count // -(-count // PIECE))  # all pieces alike, so that none is too short to be a log
    with tempfile.TemporaryDirectory() as folder:
        start, last, config = 0.0, None, None
        for k, part in enumerate(_reader(path).cut(path, size, Path(folder))):
            try:
                log = read(part, arm if config is None else config, **options)
                if last is not None and log.degrees and not last.degrees:
                    raise ValueError(f"{part}: its angles must be in degrees and those before are not; say --degrees")
            except ValueError as error:
                here = f"{path}, counted from row {k * size + 1} on"
                raise ValueError(str(error).replace(str(part), here if k else str(path))) from error
            config = config or make_config(log.dt or 0.0)
            if last is None:
                options |= {"recording": options.get("recording") or getattr(arm, "recording", None)}
                options |= {"degrees": log.degrees or options.get("degrees")}
            else:
                turns = 2 * np.pi * np.nan_to_num(np.round((last.q[-1] - log.q[0]) / (2 * np.pi)))  # NaN: no reading
                log = log._replace(q=log.q + turns)
            t = config.dt * np.arange(len(log.q)) if log.t is None else log.t
            begins, follows = start + float(t[0]), last is not None and len(last.stretches) == 1
            start, last = start + float(t[-1]) + log.rest, log
            more = len(log.stretches) == 1 and (k + 1) * size < count  # the next piece begins with the last row of this one
            between = more and log.rest > SAME * config.dt
            options["begin"] = config.dt - log.rest if between else 0.0
            yield _less_last(log) if more and not between else log, begins, follows


def _less_last(log: Log) -> Log:
    t, jitter = (None if part is None else part[:-1] for part in (log.t, log.jitter))
    return log._replace(q=log.q[:-1], tau=log.tau[:-1], t=t, jitter=jitter, segments=())


def _reader(path: Path) -> Any:
    """The module that reads the file; None for what no reader knows."""
    name = READERS.get(path.suffix.lower())
    return importlib.import_module(f"jaxftc.logs.{name}") if name and path.suffix else None
