"""The time of a log's rows: its column, dates, its unit, and stamps that are coarser than the rows."""

from __future__ import annotations

import re

import numpy as np

from jaxftc.logs.clock import own_rate
from jaxftc.logs.columns import Columns
from jaxftc.logs.formats import Table
from jaxftc.logs.readings import FAST

UNITS = ((0.2, 1.0, "s"), (200.0, 1e-3, "ms"), (2e5, 1e-6, "us"), (np.inf, 1e-9, "ns"))  # median step below: the unit
MOST = 1e300  # rad/s, in place of a speed that no number holds
_DAY = re.compile(r"(?:^|[ T])(\d{1,2}:\d\d:\d\d(?:[.,]\d+)?)$")  # a time of the day
_ZONE = re.compile(r"Z$|(?<=\d)[+-]\d\d:\d\d$")  # of a date


def times(table: Table, found: Columns, dt: float | None, q: np.ndarray, notes: list[str]) -> np.ndarray:
    """Stamps [rows] in s, as the file has them or ``dt`` apart; angles q [rows, n] in rad tell a unit that cannot be.

    Raises:
        ValueError: no column of time, or one that cannot be read.
    """
    name = found.time
    if name is None and (stamps := _split_stamps(table)) is not None:
        return stamps
    if name is None:
        if dt is None:
            raise ValueError(
                f"no column of time (t, time, timestamp, ...) among {', '.join(list(table.columns)[:20])}; say which it is "
                "with --columns t=NAME, or give the sample time with --dt"
            )
        notes.append(f"no column of time: rows are {1e3 * dt:g} ms apart, as given")
        return dt * np.arange(len(q))
    try:
        t, said = seconds(table.columns[name], found.units["time"][0])
    except ValueError as error:
        if dt is None:
            raise ValueError(f"column {name!r} {error}; without it, --dt gives the time between rows") from error
        notes.append(f"column {name!r} {error}; rows are {1e3 * dt:g} ms apart, as given")
        return dt * np.arange(len(q))
    if found.units["time"][0] is None and said != "time is a date":
        t, said = _plausible(name, t, q, said)
    notes += [said] if said else []
    again = (np.diff(t) == 0) & (q[1:] == q[:-1]).all(1)
    even = None if again.sum() > 0.1 * len(t) or not np.isfinite(t).all() else line_of(t, dt)
    if even is not None:
        notes.append(even[1])
    return t if even is None else even[0]


def _plausible(name: str, t: np.ndarray, q: np.ndarray, said: str) -> tuple[np.ndarray, str]:
    """Stamps in another unit where joints would fly in the one that was guessed."""
    steps = np.abs(np.diff(t))
    moving = steps > 0
    with np.errstate(over="ignore", invalid="ignore"):  # numbers that are no angles are refused later, by their row
        turned = np.nan_to_num(np.abs(np.diff(q, axis=0)[moving]), posinf=MOST)
        speed = np.minimum(turned.max(1) / steps[moving], MOST)
    usual = float(np.quantile(speed, 0.9))
    if usual < FAST:
        return t, said
    if said == "time is in ms" and usual / 1000 < FAST:
        return 1000 * t, f"time is in s: in ms the joints would move at {usual:.3g} rad/s"
    raise ValueError(
        f"column {name!r}: the joints would move at {usual:.3g} rad/s; name the unit of time in the head, such as t [min], "
        "or remove that column and give --dt"
    )


def _split_stamps(table: Table) -> np.ndarray | None:
    """Stamps [rows] in s of a message's head: two columns, seconds and nanoseconds."""
    parts = {re.sub(r"[\W_]", "", name.lower()): name for name in table.columns}
    whole = next((name for key, name in parts.items() if key.endswith(("stampsec", "stampsecs"))), None)
    rest = next((name for key, name in parts.items() if key.endswith(("stampnanosec", "stampnsec", "stampnsecs"))), None)
    if whole is None or rest is None:
        return None
    start = table.columns[whole].astype(float)
    return start - start[0] + 1e-9 * table.columns[rest].astype(float)


def seconds(stamps: np.ndarray, unit: float | str | None) -> tuple[np.ndarray, str]:
    """Stamps as s from the first one, and what was made of their unit; NaN where a stamp is missing.

    Raises:
        ValueError: text that is no date, or a stamp that never moves.
    """
    if stamps.dtype.kind == "O":
        stamps = _from_text(stamps)
    missing = np.isnat(stamps) if stamps.dtype.kind == "M" else ~np.isfinite(stamps)
    if missing.all():
        raise ValueError("must hold times, it is empty in every row")
    if stamps.dtype.kind == "M":
        steps = (stamps - stamps[~missing][0]).astype("timedelta64[ns]").astype(np.int64) * 1e-9
        return np.where(missing, np.nan, steps), "time is a date"
    t = (stamps - stamps[~missing][0]).astype(float)  # whole ns have more digits than a float
    if isinstance(unit, float):
        return t * unit, ""
    steps = np.diff(t[np.isfinite(t)])
    if not steps.any():
        raise ValueError(f"must increase from row to row, it is {stamps[0]} throughout")
    usual = min(float(np.median(np.abs(steps[steps != 0]))), float(np.abs(steps).mean()))  # of coarse stamps, of gaps
    scale, name = next((scale, name) for limit, scale, name in UNITS if usual < limit)
    return t * scale, "" if name == "s" else f"time is in {name}"


def _from_text(stamps: np.ndarray) -> np.ndarray:
    """Dates as datetime64[ns], times of the day as s, or numbers among which some cells are empty."""
    cells = ["" if s is None else _ZONE.sub("", str(s).strip()) for s in stamps]
    day = [_DAY.search(cell) for cell in cells]
    try:
        if all(day):  # a date that numpy does not know may stand before it
            clock = [[float(part.replace(",", ".")) for part in found[1].split(":")] for found in day if found]
            if not all(re.match(r"\d{4}-", cell) for cell in cells):
                return np.unwrap([3600 * h + 60 * m + s for h, m, s in clock], period=86400)
        return np.array([cell.replace(",", ".") or "NaT" for cell in cells]).astype("datetime64[ns]")
    except ValueError:
        pass
    row = 1
    try:
        for row, cell in enumerate(cells, start=1):  # noqa: B007
            float(cell or "nan")
        return np.array([float(cell or "nan") for cell in cells])
    except ValueError as error:
        raise ValueError(f"must hold the time as numbers or ISO dates, got {cells[row - 1]!r} in row {row}") from error


def line_of(t: np.ndarray, dt: float | None) -> tuple[np.ndarray, str] | None:
    """Even times [T] s for stamps that are coarser than the rows, and what is said of it; None where they are not.

    The rows at which the stamp moves tell the rate better than the stamps: single precision rounds the seconds of a clock
    to a quarter of a second, and some recorders write whole ones. Rows that were lost show: then no line fits.

    Args:
        t: Stamps [T] in s.
        dt: s between rows, where it is given; else a line through the stamps.
    """
    steps = np.diff(t)
    moved = np.flatnonzero(steps > 0) + 1
    if len(moved) < 3 or (steps < 0).any():
        return None
    tick = float(steps[moved - 1].min())
    own = (t[moved[-1]] - t[moved[0]]) / (moved[-1] - moved[0])
    if tick < 0.5 * own or (np.abs(steps - own) > 0.4 * own).mean() < 0.2:
        return None
    own = dt or own_rate(np.array([0.0, own]))
    even = own * np.arange(len(t))
    even += np.median(t[moved] - even[moved])
    if np.abs(t[moved] - even[moved]).max() > max(own, 0.1 * tick) or np.abs(t - even).max() > tick + own:
        return None
    return even - even[0], f"stamps are {tick:.3g} s coarse; rows are taken {1e3 * own:.4g} ms apart, as they are on average"
