"""A run's signals as one Parquet table: a row a tick, a column a joint and signal (``y_joint1``, ...)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jaxftc.io.tables import write_parquet


def write(path: Path, trace: dict[str, np.ndarray], joints: tuple[str, ...]) -> None:
    """Write columns [T] and [T, n] whole or not at all."""
    table: dict[str, np.ndarray] = {}
    for name, values in trace.items():
        if values.ndim == 1:
            table[name] = np.ascontiguousarray(values)
        else:
            table |= {f"{name}_{joint}": np.ascontiguousarray(values[:, j]) for j, joint in enumerate(joints)}
    write_parquet(path, table)
