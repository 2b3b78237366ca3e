"""Logs as Parquet; a column of lists, as LeRobot writes states, becomes one column an entry."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from jaxftc.io import tables
from jaxftc.logs.formats import Table


def read(path: Path) -> Table:
    """The table of a Parquet file.

    Raises:
        ValueError: DuckDB cannot read it.
    """
    columns: dict[str, np.ndarray] = {}
    for name, column in tables.read(path).items():
        values = np.ma.asarray(column)
        first = next((v for v in values.data[:1] if isinstance(v, list | np.ndarray)), None)
        if first is None:
            columns[name] = _plain(values)
            continue
        if any(v is None or len(v) != len(first) for v in values.data):
            row = next(k for k, v in enumerate(values.data, start=1) if v is None or len(v) != len(first))
            raise ValueError(f"{path}: row {row} of column {name!r} is not a list of {len(first)}; mend or remove that row")
        matrix = np.stack([np.asarray(v) for v in values.data])
        columns |= {f"{name}.{k}": matrix[:, k] for k in range(matrix.shape[1])}
    return Table(columns)


def count(path: Path) -> int:
    """Rows of the file.

    Raises:
        ValueError: DuckDB cannot read it.
    """
    return tables.count(path)


def cut(path: Path, rows: int, folder: Path) -> Iterator[Path]:
    """The file in parts of ``rows`` rows, in order, each with the first row of the next; one part is there at a time."""
    part = folder / path.name
    for first in range(0, count(path), rows):
        tables.copy(path, part, rows + 1, first)
        yield part


def _plain(values: np.ma.MaskedArray) -> np.ndarray:
    if values.dtype.kind in "biuf":
        return values.filled() if not np.ma.is_masked(values) else np.ma.filled(values.astype(float), np.nan)
    return np.ma.filled(values, None) if values.dtype == object else values.data
