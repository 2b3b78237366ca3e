"""A log from a file: columns found, time put in order, readings repaired, all of it said; what cannot be is refused.

``formats`` has the files, ``columns`` the names, ``signals`` the units, ``stamps`` and ``clock`` the time, ``readings`` the
angles, ``against_model`` the torques.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxftc import checks
from jaxftc.config import Config
from jaxftc.logs.against_model import doubts
from jaxftc.logs.clock import Rows, filled, lost, order, resample
from jaxftc.logs.columns import Columns, find
from jaxftc.logs.formats import Table, table
from jaxftc.logs.log import Log
from jaxftc.logs.readings import no_torques, other_rows, still, timing_error, unwrapped
from jaxftc.logs.signals import Signals, read_signals
from jaxftc.logs.stamps import times as stamps
from jaxftc.robot.arm_table import Arm, Recording
from jaxftc.robot.model import Robot

LEAST_ROWS = 100
FARTHEST, STRONGEST = 1e4, 1e6  # rad and N m that no joint reads
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
    notes = [*table.notes, *found.notes]
    signals = read_signals(table, found, robot, recording, options.degrees, options.torque_per_ampere, options.check, notes)
    rows, signals, absent = _in_order(table, found, robot, signals, recording.sample_time, options, notes)
    log, absent = _resampled(robot, rows, signals, absent, options, notes)
    if signals.tau is not None and options.check:
        notes += _against_model(robot, log, rows, options.faulty, any(found.units["angle"]))
    gone, mute = np.hsplit(absent > 0, 2)
    return log._replace(q=np.where(gone, np.nan, log.q), tau=np.where(mute, np.nan, log.tau), notes=tuple(notes))


def _in_order(
    table: Table,
    found: Columns,
    robot: Robot,
    signals: Signals,
    sample_time: float | None,
    options: _Options,
    notes: list[str],
) -> tuple[Rows, Signals, np.ndarray]:
    """The rows that are kept, in time, their signals without wraps, and where [rows, 2 n] those were absent."""
    q, tau = signals.q, signals.tau
    own_dt = sample_time if found.time is None else None
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
    return rows, signals._replace(q=q, tau=tau), np.hstack([gone, mute])[rows.kept].astype(float)


def _resampled(
    robot: Robot, rows: Rows, signals: Signals, absent: np.ndarray, options: _Options, notes: list[str]
) -> tuple[Log, np.ndarray]:
    """A row a sample time, and where [T, 2 n] it stands for a row with an absent signal."""
    step = options.wanted or rows.dt
    if rows.dt > SLOWER * step:
        raise ValueError(
            f"the log has a row every {1e3 * rows.dt:.4g} ms ({1 / rows.dt:.4g} Hz) and {1e3 * step:.4g} ms are wanted; "
            f"what lies between its rows is not known, so take dt = {rows.dt:g} and gains that were made with it"
        )
    torque = np.full_like(signals.q, np.nan) if signals.tau is None else signals.tau
    even = resample(rows, [signals.q, torque, absent], step, options.begin)
    q, torque, absent = even.values
    notes += still(robot, q)
    if len(q) < LEAST_ROWS:
        raise ValueError(f"the log has {len(q)} rows at {1e3 * step:.4g} ms, at least {LEAST_ROWS} are needed")
    jitter = np.minimum(even.jitter, UNSURE * timing_error(q, step))  # stamps may be uneven and right
    log = Log(
        q, torque, even.t, step, even.segments, unit=signals.unit, jitter=jitter, degrees=signals.degrees, rest=even.rest
    )
    return log, absent


def _against_model(robot: Robot, log: Log, rows: Rows, faulty: bool, named: bool) -> list[str]:
    """What is noticed of columns that do not fit the model; refused, unless that may be the fault."""
    q, torque, raw = np.asarray(log.q), np.asarray(log.tau), log.unit != "N m"
    wrong, noticed = doubts(robot, q, slow_speed(log), torque, raw=raw, degrees=log.degrees, named=named)
    if wrong and faulty:
        return [f"{'; '.join(wrong)}, unless that is the fault", *noticed]
    if wrong:
        before = f"; found before: {'; '.join(rows.notes)}" if rows.notes else ""
        raise ValueError(f"{'; '.join(wrong)} (--no-check takes the columns as they are){before}")
    return noticed


def slow_speed(log: Log) -> np.ndarray:
    """Speed [T, n] rad/s by differences over 50 ms; enough to tell slow from fast and the way of the motion."""
    half = max(1, round(0.025 / log.sample_time))
    out = np.zeros_like(log.q)
    for start, stop in log.stretches:
        q = np.asarray(log.q)[start:stop]
        k = np.arange(len(q))
        ahead, behind = np.minimum(k + half, len(q) - 1), np.maximum(k - half, 0)
        out[start:stop] = (q[ahead] - q[behind]) / ((ahead - behind)[:, None] * log.sample_time)
    return out


def _absurd(names: list[str], values: np.ndarray, rows: np.ndarray, most: float, what: str) -> None:
    """Refuse a finite number that nothing can have measured."""
    beyond = np.argwhere(np.abs(values) > most)
    if len(beyond):
        k, j = beyond[0]
        raise ValueError(
            f"row {rows[k] + 1}, column {names[j]!r}: {values[k, j]:.6g} {what}; mend that cell or cut the row out"
        )
