"""A log from a file: columns found, time put in order, readings repaired, all of it said; what cannot be is refused.

``formats`` has the files, ``columns`` the names, ``stamps`` and ``clock`` the time, ``readings`` the angles,
``against_model`` the torques.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxftc import checks
from jaxftc.config import Config
from jaxftc.logs.against_model import doubts
from jaxftc.logs.clock import filled, lost, order, resample
from jaxftc.logs.columns import Columns, find, listed
from jaxftc.logs.formats import Table, table
from jaxftc.logs.log import Log
from jaxftc.logs.readings import in_degrees, no_angles, no_readings, no_torques, other_rows, still, timing_error, unwrapped
from jaxftc.logs.stamps import times as stamps
from jaxftc.logs.text import MISSING
from jaxftc.robot.arm_table import Arm, Recording
from jaxftc.robot.model import Robot

LEAST_ROWS = 100
FARTHEST, STRONGEST = 1e4, 1e6  # rad and N m that no joint reads
ANGLES = {"rad": 1.0, "deg": np.pi / 180, "mrad": 1e-3, "turn": 2 * np.pi}  # rad
TORQUES = {"N m": 1.0, "mN m": 1e-3, "N cm": 1e-2}  # N m
UNKNOWN = {"A": "A", "mA": "A", "%": "%", "permille": "permille", "load": "load"}  # units whose N m are not known
UNSURE = 6.0  # standard deviations of the time of a reading
SLOWER = 2.2  # a sample time this much shorter than the log's own would be made up between its rows


def read(
    path: str | Path,
    arm: Robot | Arm | Config,
    *,
    recording: Recording | None = None,
    columns: Mapping[str, str] | None = None,
    dt: float | None = None,
    degrees: bool | None = None,
    torque_per_ampere: float | Sequence[float] | None = None,
    check: bool = True,
    faulty: bool = False,
    begin: float = 0.0,
) -> Log:
    """A recorded motion, at even times.

    Args:
        path: CSV or other text, Parquet, MCAP, or a rosbag2 (.db3 or folder) of ``sensor_msgs/JointState``.
        arm: The robot, or the arm with how its logs are read (``load_arm``); or a config, at whose ``dt`` the log is wanted.
        recording: How the arm's logs are read, where ``arm`` does not say it: columns, torque gain and offset.
        columns: Our names (t, q1, q2, ..., tau1, ...) and the file's, where they are not found; a minus before the file's
            name turns the sign round. Of a file without a head the columns are "column 1", "column 2", ...
        dt: Sample time in s; that of the config or the log's own if not given. A file without time must have it.
        degrees: Whether angles are in degrees; found out if not given.
        torque_per_ampere: N m for one ampere, one number or one a joint, where currents were recorded.
        check: Hold the columns against the model; ``False`` takes them as they are.
        faulty: The log may hold a fault: columns that do not fit the model are noted and not refused, and where a joint has
            no angle for more than five sample times and 20 ms, the log has NaN; else such rows are left out.
        begin: s after the file's first row, at which the log begins; so a file goes on at even times from another.

    Returns:
        The log; its ``notes`` say what was found and repaired. Without torques in the file, ``tau`` is NaN.

    Raises:
        ValueError: the file cannot be read, columns are missing, a cell is no number, rows hold something else than this
            arm's readings, or a column is dead, swapped or negated; one line with file, row and column.
    """
    config = arm if isinstance(arm, Config) else None
    robot: Any = getattr(arm, "robot", arm)
    recording = recording or (arm.recording if isinstance(arm, Arm) else Recording())
    checks.instance("arm", robot, Robot)
    if dt is not None:
        checks.positive("dt", dt, "seconds")
    path = Path(path)
    cells = table(path)
    try:
        columns = _with_recorded(columns, recording, cells)
        options = _Options(
            columns, dt, config.dt if config and dt is None else dt, degrees, torque_per_ampere, check, faulty, begin
        )
        return _log(cells, robot, recording, options)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


class _Options(NamedTuple):
    columns: Mapping[str, str] | None
    dt: float | None  # s, between rows of a file without time
    wanted: float | None  # s, of the log
    degrees: bool | None
    torque_per_ampere: float | Sequence[float] | None
    check: bool
    faulty: bool
    begin: float  # s


def _with_recorded(given: Mapping[str, str] | None, recording: Recording, table: Table) -> Mapping[str, str] | None:
    """The columns that are given, and beside them those that the arm's file names, if this log has them all."""
    found: dict[str, str] = {}
    for key, names in recording.columns:
        if key in ("t", "q", "tau"):
            found |= {key: names[0]} if key == "t" else {f"{key}{j}": name for j, name in enumerate(names, start=1)}
    found |= given or {}
    there = all(name in table.columns or name.removeprefix("-") in table.columns for name in found.values())
    return found if found and there else given


def _log(table: Table, robot: Robot, recording: Recording, options: _Options) -> Log:
    found = find(list(table.columns), robot.joint_names, options.columns, table.units)
    notes, unit = [*table.notes, *found.notes], "N m"
    q = _numbers(table, found, found.angle, "rad")
    tau = _numbers(table, found, found.torque, "N m") if found.torque else None
    if tau is not None and not np.nan_to_num(tau).any():  # as drivers write that do not know them
        tau = None
        notes.append("torques are 0 or empty in every row of every joint: taken as not recorded, readings alone are judged")
    elif tau is None:
        notes.append(
            f"the file has no torques: readings alone are judged; torques and the model cannot be (columns: "
            f"{listed(list(table.columns))})"
        )
    if tau is not None:
        tau, unit = _torque(tau, found, robot, recording, options.torque_per_ampere, notes)
    _hollow(found, q, tau)
    q, degrees = _angles(robot, q, found, options, notes)
    own_dt = recording.sample_time if found.time is None else None
    t = stamps(table, found, own_dt if options.dt is None else options.dt, q, notes)
    gone = lost(t, q) if options.faulty else np.zeros(q.shape, bool)
    mute = gone if tau is None else gone & ~np.isfinite(tau)
    q, tau = filled(q, gone), None if tau is None else filled(tau, mute)
    for j in np.flatnonzero(gone.any(0)):
        rest = f"has no angle in {gone[:, j].sum()} rows, the first is row {gone[:, j].argmax() + 1}"
        notes.append(f"joint {j + 1} ({robot.joint_names[j]}) {rest}")
    rows = order(t, np.all(np.isfinite(q if tau is None else np.hstack([q, tau])), axis=1))
    notes += rows.notes
    q, tau = q[rows.kept], None if tau is None else tau[rows.kept]
    absent = np.hstack([gone, mute])[rows.kept].astype(float)
    _absurd(found.angle, q, rows.kept, FARTHEST, "rad, no angle of a joint")
    if tau is not None and found.torque:
        _absurd(found.torque, tau, rows.kept, STRONGEST, "N m, no torque of a joint")
    q, said = unwrapped(rows.t, q, rows.starts)
    notes += said
    strange = options.check and (
        (tau is not None and no_torques(tau, robot.torque_limit))
        or other_rows(rows.t, q, tau, rows.kept, robot.torque_limit)
    )
    if strange:
        raise ValueError(strange)
    step = options.wanted or rows.dt
    if rows.dt > SLOWER * step:
        raise ValueError(
            f"the log has a row every {1e3 * rows.dt:.4g} ms ({1 / rows.dt:.4g} Hz) and {1e3 * step:.4g} ms are wanted; "
            f"what lies between its rows is not known, so take dt = {rows.dt:g} and gains that were made with it"
        )
    even = resample(rows, [q, np.full_like(q, np.nan) if tau is None else tau, absent], step, options.begin)
    q, torque, absent = even.values
    notes += still(robot, q)
    if len(q) < LEAST_ROWS:
        raise ValueError(f"the log has {len(q)} rows at {1e3 * step:.4g} ms, at least {LEAST_ROWS} are needed")
    jitter = np.minimum(even.jitter, UNSURE * timing_error(q, step))  # stamps may be uneven and right
    log = Log(q, torque, even.t, step, even.segments, unit=unit, jitter=jitter, degrees=degrees, rest=even.rest)
    if tau is not None and options.check:
        wrong, noticed = doubts(
            robot, q, slow_speed(log), torque, raw=unit != "N m", degrees=degrees, named=any(found.units["angle"])
        )
        if wrong and options.faulty:
            notes.append(f"{'; '.join(wrong)}, unless that is the fault")
        elif wrong:
            before = f"; found before: {'; '.join(rows.notes)}" if rows.notes else ""
            raise ValueError(f"{'; '.join(wrong)} (--no-check takes the columns as they are){before}")
        notes += noticed
    gone, mute = np.hsplit(absent > 0, 2)
    return log._replace(q=np.where(gone, np.nan, q), tau=np.where(mute, np.nan, torque), notes=tuple(notes))


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


def _numbers(table: Table, found: Columns, names: list[str], unit: str) -> np.ndarray:
    """[rows, n] of columns; a cell that is no number is refused."""
    out = []
    for name in names:
        column = table.columns[name]
        if column.dtype.kind not in "biuf":
            column = _cells(name, column, unit)
        out.append(found.signs.get(name, 1.0) * column.astype(float))
    return np.stack(out, axis=1)


def _cells(name: str, column: np.ndarray, unit: str) -> np.ndarray:
    out = np.empty(len(column))
    for row, cell in enumerate(column, start=1):
        try:
            out[row - 1] = np.nan if cell is None or str(cell).strip().lower() in MISSING else float(cell)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"row {row}, column {name!r}: must be a number in {unit}, got {cell!r}; mend that cell"
            ) from error
    return out


def _angles(robot: Robot, q: np.ndarray, found: Columns, options: _Options, notes: list[str]) -> tuple[np.ndarray, bool]:
    """Angles [rows, n] in rad, NaN where a number stands for a reading that was lost; whether they were in degrees.

    Raises:
        ValueError: they cannot be angles.
    """
    units = [unit if unit in ANGLES else None for unit in found.units["angle"]]
    why = "its columns say so" if set(units) == {"deg"} else None if any(units) else in_degrees(robot, q)
    degrees = bool(options.degrees or (options.degrees is None and why))
    if degrees:
        notes.append(f"angles are in degrees ({why or 'as given'}); turned into rad")
        q = np.deg2rad(q)
    elif any(units) and set(units) != {"rad"} and not (options.degrees is False and "deg" in units):
        if None in units:
            j = units.index(None)
            raise ValueError(
                f"column {found.angle[j]!r} has no unit and others have; name the unit of each angle in the head, such as "
                "q1 [rad]"
            )
        listed = units[0] if len(set(units)) == 1 else f"{', '.join(map(str, units))} by joint"
        notes.append(f"angles are in {listed}, as their columns say; turned into rad")
        q = np.array([ANGLES[str(unit)] for unit in units]) * q
    lost = no_readings(robot, q) if options.check else np.zeros(q.shape, bool)
    if lost.any():
        row, j = np.argwhere(lost)[0]
        notes.append(
            f"{lost.sum()} numbers are no angle and taken as missing, the first is {q[row, j]:.6g} in row {row + 1}"
        )
        q = np.where(lost, np.nan, q)
    if options.check and (wrong := no_angles(robot, q)):
        raise ValueError(wrong)
    return q, degrees


def _torque(
    tau: np.ndarray,
    found: Columns,
    robot: Robot,
    recording: Recording,
    torque_per_ampere: float | Sequence[float] | None,
    notes: list[str],
) -> tuple[np.ndarray, str]:
    """Torques [rows, n] with the gain and offset that are known, and their unit."""
    units = [unit if unit in TORQUES or unit in UNKNOWN else "N m" for unit in found.units["torque"]]
    raw = next((UNKNOWN[str(unit)] for unit in units if unit in UNKNOWN), None)
    if raw and len(set(units)) > 1:
        raise ValueError(
            f"the torque columns are in {', '.join(map(str, units))} by joint; give all in one unit, or --torque-per-ampere"
        )
    tau = tau * np.array([1e-3 if unit == "mA" else TORQUES.get(str(unit), 1.0) for unit in units])
    gain = recording.torque_gain if torque_per_ampere is None else torque_per_ampere
    if gain is not None:
        gain = np.asarray(gain, float)
        if gain.shape not in ((), (1,), (robot.n,)) or not np.isfinite(gain).all() or (gain == 0).any():
            raise ValueError(f"torque_per_ampere must be one number or {robot.n}, finite and not 0, got {torque_per_ampere}")
        notes.append(f"torques are the columns times {np.array2string(gain, precision=4)} N m")
        tau, raw = tau * gain, None
    if raw:
        what = {"A": "torques are currents in A", "load": "torques are loads as the servos count them"}
        notes.append(
            f"{what.get(raw, f'torques are in {raw}')}, and the N m for one are not known: identify finds them, or give "
            "torque_per_ampere"
        )
    elif recording.torque_offset is not None:
        tau = tau + np.asarray(recording.torque_offset)
    return tau, raw or "N m"


def _absurd(names: list[str], values: np.ndarray, rows: np.ndarray, most: float, what: str) -> None:
    """Refuse a finite number that nothing can have measured."""
    beyond = np.argwhere(np.abs(values) > most)
    if len(beyond):
        k, j = beyond[0]
        raise ValueError(
            f"row {rows[k] + 1}, column {names[j]!r}: {values[k, j]:.6g} {what}; mend that cell or cut the row out"
        )


def _hollow(found: Columns, q: np.ndarray, tau: np.ndarray | None) -> None:
    for values, names in ((q, found.angle), (tau, found.torque)):
        if values is None or names is None:
            continue
        empty = np.flatnonzero(~np.isfinite(values).any(0))
        if len(empty):
            raise ValueError(f"column {names[empty[0]]!r} holds no number in any row; give another with --columns")
