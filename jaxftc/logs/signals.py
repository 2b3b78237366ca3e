"""The columns of a log as numbers in rad and N m, whatever their units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxftc.logs.columns import Columns, listed
from jaxftc.logs.formats import Table
from jaxftc.logs.readings import in_degrees, no_angles, no_readings
from jaxftc.logs.text import MISSING
from jaxftc.robot.arm_table import Recording
from jaxftc.robot.model import Robot

ANGLES = {"rad": 1.0, "deg": np.pi / 180, "mrad": 1e-3, "turn": 2 * np.pi}  # rad
TORQUES = {"N m": 1.0, "mN m": 1e-3, "N cm": 1e-2}  # N m
UNKNOWN = {"A": "A", "mA": "A", "%": "%", "permille": "permille", "load": "load"}  # units whose N m are not known


class Signals(NamedTuple):
    """What a log's rows hold."""

    q: np.ndarray  # [rows, n] rad
    tau: np.ndarray | None  # [rows, n] in ``unit``, where torques were recorded
    unit: str
    degrees: bool  # whether the file's angles are in degrees


def read_signals(
    table: Table,
    found: Columns,
    robot: Robot,
    recording: Recording,
    degrees: bool | None,
    torque_per_ampere: float | Sequence[float] | None,
    check: bool,
    notes: list[str],
) -> Signals:
    """The columns as numbers, in rad and N m; torques whose N m are not known in the file's unit.

    Raises:
        ValueError: a cell is no number, a column is empty, or units that do not go together.
    """
    q, unit = _numbers(table, found, found.angle, "rad"), "N m"
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
        tau, unit = _torque(tau, found, robot, recording, torque_per_ampere, notes)
    _hollow(found, q, tau)
    q, were_degrees = _angles(robot, q, found, degrees, check, notes)
    return Signals(q, tau, unit, were_degrees)


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


def _angles(
    robot: Robot, q: np.ndarray, found: Columns, given: bool | None, check: bool, notes: list[str]
) -> tuple[np.ndarray, bool]:
    """Angles [rows, n] in rad, NaN where a number stands for a reading that was lost; whether they were in degrees.

    Raises:
        ValueError: they cannot be angles.
    """
    units = [unit if unit in ANGLES else None for unit in found.units["angle"]]
    why = "its columns say so" if set(units) == {"deg"} else None if any(units) else in_degrees(robot, q)
    degrees = bool(given or (given is None and why))
    if degrees:
        notes.append(f"angles are in degrees ({why or 'as given'}); turned into rad")
        q = np.deg2rad(q)
    elif any(units) and set(units) != {"rad"} and not (given is False and "deg" in units):
        if None in units:
            j = units.index(None)
            raise ValueError(
                f"column {found.angle[j]!r} has no unit and others have; name the unit of each angle in the head, such as "
                "q1 [rad]"
            )
        told = units[0] if len(set(units)) == 1 else f"{', '.join(map(str, units))} by joint"
        notes.append(f"angles are in {told}, as their columns say; turned into rad")
        q = np.array([ANGLES[str(unit)] for unit in units]) * q
    lost = no_readings(robot, q) if check else np.zeros(q.shape, bool)
    if lost.any():
        row, j = np.argwhere(lost)[0]
        notes.append(
            f"{lost.sum()} numbers are no angle and taken as missing, the first is {q[row, j]:.6g} in row {row + 1}"
        )
        q = np.where(lost, np.nan, q)
    if check and (wrong := no_angles(robot, q)):
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


def _hollow(found: Columns, q: np.ndarray, tau: np.ndarray | None) -> None:
    for values, names in ((q, found.angle), (tau, found.torque)):
        if values is None or names is None:
            continue
        empty = np.flatnonzero(~np.isfinite(values).any(0))
        if len(empty):
            raise ValueError(f"column {names[empty[0]]!r} holds no number in any row; give another with --columns")
