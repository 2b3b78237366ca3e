"""Logs as Parquet; a column of lists, as LeRobot writes states, becomes one column an entry."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jaxftc.logs.formats import Table


def read(path: Path) -> Table:
    """The table of a Parquet file.

    Raises:
        ValueError: DuckDB cannot read it.
    """
    import duckdb

    literal = "".join(f"[{c}]" if c in "*?[" else c for c in str(path))  # DuckDB reads paths as patterns
    try:
        with duckdb.connect() as connection:
            found = connection.execute("select * from read_parquet($path)", {"path": literal}).fetchnumpy()
    except duckdb.Error as error:
        raise ValueError(f"cannot read {path}: {str(error).splitlines()[0]}") from error
    columns: dict[str, np.ndarray] = {}
    for name, column in found.items():
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


def _plain(values: np.ma.MaskedArray) -> np.ndarray:
    if values.dtype.kind in "biuf":
        return values.filled() if not np.ma.is_masked(values) else np.ma.filled(values.astype(float), np.nan)
    return np.ma.filled(values, None) if values.dtype == object else values.data
