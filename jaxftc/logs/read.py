"""Recorded logs: a table of time, encoder readings and commanded torques, checked and brought to the sample time.

A log is CSV or Parquet with columns ``t`` (s), ``q1``, ``q2``, ... (rad) and ``tau1``, ``tau2``, ... (N m), joints in order,
or with joint names as ``jaxftc simulate`` writes them (``y_joint1``, ``tau_joint1``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jaxftc.config import Config
from jaxftc.io import tables
from jaxftc.logs.log import Log, check_log

GAP = 5  # sample times without a row that still pass


def read(path: str | Path, config: Config) -> Log:
    """A log at the sample time ``config.dt``: angles in between by straight lines, torques held.

    Raises:
        ValueError: a file that cannot be read, missing columns, times that do not increase or leave gaps, values that are
            not finite, or a start in motion.
    """
    table = _table(Path(path))
    q, tau = (_signals(path, table, config, *names) for names in ((("q", "y_", "q_"), "rad"), (("tau", "tau_"), "N m")))
    try:
        t = np.asarray(table.get("t", []), float)
    except ValueError as error:
        raise ValueError(f"{path}: column 't' must hold the time in s: {error}") from error
    if not len(t):
        raise ValueError(f"{path}: column 't' is missing or empty; it is the time in s, one row a sample")
    steps = np.diff(t)
    if len(t) < 2 or not np.isfinite(t).all() or (steps <= 0).any():
        row = int(np.flatnonzero(~(steps > 0))[0]) + 2 if len(t) > 1 and not (steps > 0).all() else 1
        raise ValueError(f"{path}: t must increase from row to row, it does not at row {row}; sort the log and drop doubles")
    if steps.max() > GAP * config.dt:
        row = int(steps.argmax())
        raise ValueError(
            f"{path}: {steps[row]:.3g} s without a row after t = {t[row]:g} s; at most {GAP} sample times of {config.dt:g} "
            "s pass, so cut the log there"
        )
    ticks = int(np.floor((t[-1] - t[0]) / config.dt + 1e-6)) + 1
    if not (len(t) == ticks and np.allclose(steps, config.dt, rtol=0, atol=1e-6)):
        grid = t[0] + config.dt * np.arange(ticks)
        held = np.clip(np.searchsorted(t, grid + 1e-9, side="right") - 1, 0, len(t) - 1)
        q = np.stack([np.interp(grid, t, column) for column in q.T], axis=1)
        tau = tau[held]
    try:
        return check_log(config, Log(q, tau), moving=False)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _table(path: Path) -> dict[str, np.ndarray]:
    if path.suffix.lower() not in tables.READERS:
        raise ValueError(f"a log must be a .csv or .parquet file, got {path}")
    return {name: np.ma.filled(np.ma.asarray(column, dtype=object), np.nan) for name, column in tables.read(path).items()}


def _signals(
    path: str | Path, table: dict[str, np.ndarray], config: Config, names: tuple[str, ...], unit: str
) -> np.ndarray:
    """[T, n] of the first way of naming that is complete."""
    plain, *others = names
    ways = [[f"{plain}{j + 1}" for j in range(config.n)]]
    ways += [[f"{prefix}{joint}" for joint in config.robot.joint_names] for prefix in others]
    for way in ways:
        if all(column in table for column in way):
            try:
                return np.stack([np.asarray(table[column], float) for column in way], axis=1)
            except ValueError as error:
                raise ValueError(f"{path}: columns {way[0]} to {way[-1]} must hold numbers in {unit}: {error}") from error
    raise ValueError(f"{path} must have columns {ways[0][0]} to {ways[0][-1]} in {unit}, or {ways[1][0]} and so on; it has "
                     f"{', '.join(table)}")  # fmt: skip
