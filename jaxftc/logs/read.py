"""A log from a file: columns found, time put in order, readings repaired, all of it said; what cannot be is refused.

``formats`` has the files, ``columns`` the names, ``clock`` the time, ``readings`` the angles, ``against_model`` the torques.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxftc import checks
from jaxftc.config import Config
from jaxftc.logs import against_model, clock, columns, formats, readings
from jaxftc.logs.log import Log
from jaxftc.robot.model import Robot

LEAST_ROWS = 100
SLOWER = 2.2  # a sample time this much shorter than the log's own would be made up between its rows


def read(
    path: str | Path,
    arm: Robot | Config,
    *,
    columns: Mapping[str, str] | None = None,
    dt: float | None = None,
    degrees: bool | None = None,
    torque_per_ampere: float | Sequence[float] | None = None,
    check: bool = True,
) -> Log:
    """A recorded motion, at even times.

    Args:
        path: CSV or other text, Parquet, MCAP, or a rosbag2 (.db3 or folder) of ``sensor_msgs/JointState``.
        arm: The robot; or a config, at whose ``dt`` the log is wanted.
        columns: Our names (t, q1, q2, ..., tau1, ...) and the file's, where they are not found; a minus before the file's
            name turns the sign round. Of a file without a head the columns are "column 1", "column 2", ...
        dt: Sample time in s; that of the config or the log's own if not given. A file without time must have it.
        degrees: Whether angles are in degrees; found out if not given.
        torque_per_ampere: N m for one ampere, one number or one a joint, where currents were recorded.
        check: Hold the columns against the model; ``False`` takes them as they are.

    Returns:
        The log; its ``notes`` say what was found and repaired. Without torques in the file, ``tau`` is NaN.

    Raises:
        ValueError: the file cannot be read, columns are missing, a cell is no number, rows hold something else than this
            arm's readings, or a column is dead, swapped or negated; one line with file, row and column.
    """
    config, robot = (arm, arm.robot) if isinstance(arm, Config) else (None, arm)
    checks.instance("arm", robot, Robot)
    if dt is not None:
        checks.positive("dt", dt, "seconds")
    path = Path(path)
    table = formats.table(path)
    try:
        return _log(path, table, robot, columns, dt or (config.dt if config else None), dt, degrees, torque_per_ampere, check)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _log(path, table, robot, given, wanted, dt, degrees, torque_per_ampere, check) -> Log:  # noqa: ANN001, ANN202
    found = columns.find(list(table.columns), robot.joint_names, given)
    notes = [*table.notes, *found.notes]
    q = _numbers(table, found, found.angle, "rad")
    tau = _numbers(table, found, found.torque, "N m") if found.torque else None
    t, whole = _time(table, found, dt, len(q), notes), np.isfinite(q).all(1)
    if tau is None:
        notes.append("the file has no torques: readings alone are judged; torques and the model cannot be")
    else:
        whole &= np.isfinite(tau).all(1)
        tau = _torque_unit(tau, found, robot, torque_per_ampere, notes)
    _hollow(found, q, tau)
    rows = clock.order(t, whole)
    notes += rows.notes
    q, tau = q[rows.kept], None if tau is None else tau[rows.kept]
    why = "its columns say so" if found.units.get("angle") == "deg" else readings.in_degrees(robot, q)
    if degrees or (degrees is None and why):
        notes.append(f"angles are in degrees ({why or 'as given'}); turned into rad")
        q = np.deg2rad(q)
    q, said = readings.unwrapped(rows.t, q, rows.starts)
    notes += said
    strange = check and readings.other_rows(rows.t, q, tau, rows.kept, robot.torque_limit)
    if strange:
        raise ValueError(strange)
    step = wanted or rows.dt
    if rows.dt > SLOWER * step:
        raise ValueError(
            f"the log has a row every {1e3 * rows.dt:.4g} ms ({1 / rows.dt:.4g} Hz) and {1e3 * step:.4g} ms are wanted; what "
            f"lies between its rows is not known, so take dt = {rows.dt:g}"
        )
    times, values, segments = clock.resample(rows, [q, np.full_like(q, np.nan) if tau is None else tau], step)
    if len(times) < LEAST_ROWS:
        raise ValueError(f"the log has {len(times)} rows at {1e3 * step:.4g} ms, at least {LEAST_ROWS} are needed")
    log = Log(*values, times, step, segments, unit="N m")
    if tau is not None:
        amperes = found.units.get("torque") in ("A", "mA") and torque_per_ampere is None
        log = log._replace(unit="A" if amperes else "N m")
        if check:
            wrong, noticed = against_model.doubts(robot, log.q, slow_speed(log), log.tau, amperes=amperes)
            if wrong:
                raise ValueError(f"{'; '.join(wrong)} (--no-check takes the columns as they are)")
            notes += noticed
    return log._replace(notes=tuple(notes))


def slow_speed(log: Log) -> np.ndarray:
    """Speed [T, n] rad/s by differences over 50 ms; enough to tell slow from fast and the way of the motion."""
    half = max(1, round(0.025 / (log.dt or 1e-3)))
    out = np.zeros_like(log.q)
    for start, stop in log.stretches:
        q = np.asarray(log.q)[start:stop]
        k = np.arange(len(q))
        ahead, behind = np.minimum(k + half, len(q) - 1), np.maximum(k - half, 0)
        out[start:stop] = (q[ahead] - q[behind]) / ((ahead - behind)[:, None] * (log.dt or 1e-3))
    return out


def _numbers(table: formats.Table, found: columns.Columns, names: list[str], unit: str) -> np.ndarray:
    """[rows, n] of columns; a cell that is no number is refused."""
    out = []
    for name in names:
        column = table.columns[name]
        if column.dtype.kind not in "biuf":
            column = _cells(name, column, unit)
        out.append(found.signs.get(name, 1.0) * column.astype(float))
    return np.stack(out, axis=1)


def _cells(name: str, column: np.ndarray, unit: str) -> np.ndarray:
    from jaxftc.logs.text import MISSING

    out = np.empty(len(column))
    for row, cell in enumerate(column, start=1):
        try:
            out[row - 1] = np.nan if cell is None or str(cell).strip().lower() in MISSING else float(cell)
        except (TypeError, ValueError) as error:
            raise ValueError(f"row {row}, column {name!r}: must be a number in {unit}, got {cell!r}; mend that cell") from error
    return out


def _time(table: formats.Table, found: columns.Columns, dt: float | None, rows: int, notes: list[str]) -> np.ndarray:
    if found.time is not None:
        try:
            t, said = clock.seconds(table.columns[found.time], found.units.get("time"))
        except ValueError as error:
            raise ValueError(f"column {found.time!r} {error}") from error
        notes += [said] if said else []
        return t
    parts = {re.sub(r"[\W_]", "", name.lower()): name for name in table.columns}
    whole = next((name for key, name in parts.items() if key.endswith(("stampsec", "stampsecs"))), None)
    rest = next((name for key, name in parts.items() if key.endswith(("stampnanosec", "stampnsec", "stampnsecs"))), None)
    if whole and rest:
        seconds = table.columns[whole].astype(float)
        return seconds - seconds[0] + 1e-9 * table.columns[rest].astype(float)
    if dt is None:
        raise ValueError(
            f"no column of time (t, time, timestamp, ...) among {', '.join(list(table.columns)[:20])}; say which it is with "
            "--columns t=NAME, or give the sample time with --dt"
        )
    notes.append(f"no column of time: rows are {1e3 * dt:g} ms apart, as given")
    return dt * np.arange(rows)


def _torque_unit(tau, found, robot, torque_per_ampere, notes) -> np.ndarray:  # noqa: ANN001
    if found.units.get("torque") == "mA":
        tau = 1e-3 * tau
    if torque_per_ampere is not None:
        gain = np.asarray(torque_per_ampere, float)
        if gain.shape not in ((), (1,), (robot.n,)) or not np.isfinite(gain).all() or (gain == 0).any():
            raise ValueError(f"torque_per_ampere must be one number or {robot.n}, finite and not 0, got {torque_per_ampere}")
        notes.append(f"torques are currents times {np.array2string(gain, precision=4)} N m/A")
        return tau * gain
    if found.units.get("torque") in ("A", "mA"):
        notes.append("torques are currents in A, and the N m for one are not known: identify finds them, or give torque_per_ampere")
    return tau


def _hollow(found: columns.Columns, q: np.ndarray, tau: np.ndarray | None) -> None:
    for values, names in ((q, found.angle), (tau, found.torque)):
        if values is None or names is None:
            continue
        empty = np.flatnonzero(~np.isfinite(values).any(0))
        if len(empty):
            raise ValueError(f"column {names[empty[0]]!r} holds no number in any row; give another with --columns")
