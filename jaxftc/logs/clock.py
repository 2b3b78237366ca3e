"""Rows of a log in time: the rate that it was recorded at, gaps, and rows brought to even times."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

GAP = 5  # sample times without a row that are bridged by straight lines,
GAP_SECONDS = 0.02  # or this long, whichever is more; longer ones cut the log
LEAST_ROWS = 20  # of a segment
NEAR = 2  # rows before and after, from which it is read how far a row's stamp may be wrong
UNEVEN = 0.5  # of a step, by which steps must differ for that
RESTART_ROWS = 50  # rows behind a backward stamp that make it a new recording
RATES = np.array([2000, 1000, 500, 400, 250, 240, 200, 150, 125, 120, 100, 80, 75, 60, 50, 40, 30, 25, 20, 15, 10.0])  # Hz


class Rows(NamedTuple):
    """Rows of a log in order, cut where nothing bridges them."""

    kept: np.ndarray  # rows of the file that are used, from 0
    t: np.ndarray  # s, from 0, of those
    starts: np.ndarray  # places in ``kept`` at which a segment starts
    dt: float  # s, the log's own sample time
    notes: list[str]


def own_rate(t: np.ndarray) -> float:
    """Sample time in s: the median step, or the usual rate within 2 % of it."""
    steps = np.diff(t)
    median = float(np.median(steps[steps > 0]))
    usual = 1 / RATES[np.abs(RATES * median - 1).argmin()]
    return float(usual) if abs(median / usual - 1) < 0.02 else float(f"{median:.3g}")


def lost(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Where [T, n] a joint has no angle for longer than is bridged, and another one has; of stamps [T] s, angles [T, n]."""
    missing, there = ~np.isfinite(q), np.isfinite(t)
    out = np.zeros(q.shape, bool)
    if not missing.any() or not (np.diff(t[there]) > 0).any():
        return out
    limit = max(GAP * own_rate(t[there]), GAP_SECONDS)
    alone = missing & ~missing.all(1, keepdims=True)
    for j in np.flatnonzero(alone.any(0)):
        edges = np.flatnonzero(np.diff(np.r_[False, alone[:, j], False]))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            bridged = t[min(stop, len(t) - 1)] - t[max(start - 1, 0)] <= limit
            out[start:stop, j] = not bridged
    return out


def filled(values: np.ndarray, gone: np.ndarray) -> np.ndarray:
    """Values [rows, n] with straight lines where they are ``gone``, for what looks at the log before the diagnosis does."""
    values = values.copy()
    for j in np.flatnonzero(gone.any(0)):
        at, there = np.flatnonzero(gone[:, j]), np.flatnonzero(np.isfinite(values[:, j]))
        values[at, j] = np.interp(at, there, values[there, j])
    return values


def order(t: np.ndarray, whole: np.ndarray) -> Rows:
    """The rows that count: stamps that increase, every value there; cut at gaps and where the clock starts anew.

    Args:
        t: Stamps [T] in s; NaN is a missing one.
        whole: [T] rows in which all values are numbers.

    Raises:
        ValueError: nothing is left, or so many stamps go back that the order cannot be known.
    """
    notes: list[str] = []
    rows = _whole(whole & np.isfinite(t), notes)
    t = t[rows]
    if (np.diff(t) <= 0).all() and np.ptp(t) > 0:
        rows, t = rows[::-1], t[::-1] - t[-1]
        notes.append("the rows run backwards in time; turned round")
    dt = own_rate(t)
    t = _one_clock(rows, t, dt, notes)
    rows, t = _increasing(rows, t, notes)
    use, starts = _segments(t, dt, notes)
    return Rows(rows[use], t[use], starts, dt, notes)


def _whole(usable: np.ndarray, notes: list[str]) -> np.ndarray:
    """Numbers of the usable [T] rows."""
    rows, missing = np.flatnonzero(usable), np.flatnonzero(~usable) + 1
    if len(rows) < 2:
        raise ValueError(f"{len(rows)} of {len(usable)} rows have a time and all values; record the motion again")
    if len(missing) > 0.5 * len(usable):
        raise ValueError(
            f"{len(missing)} of {len(usable)} rows miss a value, the first is row {missing[0]}; record it again"
        )
    if len(missing):
        notes.append(f"{len(missing)} rows with a missing value left out, the first is row {missing[0]}")
    return rows


def _one_clock(rows: np.ndarray, t: np.ndarray, dt: float, notes: list[str]) -> np.ndarray:
    """Stamps [rows] s of one clock: a recording that starts anew is put behind the one before, a gap apart."""
    t = t.copy()
    back = np.flatnonzero(np.diff(t) < -10 * dt) + 1
    restarts = [k for k in back if len(t) - k >= RESTART_ROWS and (t[k : k + RESTART_ROWS] < t[k - 1]).all()]
    for k in restarts:
        t[k:] += t[k - 1] - t[k] + max(1.0, 10 * GAP * dt)
    if restarts:
        notes.append(f"the clock starts anew at row {rows[restarts[0]] + 1}; taken as {len(restarts) + 1} recordings")
    return t


def _increasing(rows: np.ndarray, t: np.ndarray, notes: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Rows and their stamps, less those whose stamp is not above all before."""
    latest = np.maximum.accumulate(t)
    forward = np.r_[True, t[1:] > latest[:-1]]
    equal = np.r_[False, t[1:] == latest[:-1]]
    back = ~forward & ~equal

    def first(which: np.ndarray) -> int:
        return int(rows[np.flatnonzero(which)[0]]) + 1

    if back.sum() > 0.1 * len(t):
        raise ValueError(
            f"the time goes back in {back.sum()} of {len(t)} rows, the first is row {first(back)}; sort the rows by time"
        )
    for which, word in ((equal, "the same time as the one before"), (back, "a time before that of an earlier one")):
        if which.any():
            notes.append(f"{which.sum()} rows with {word} left out, the first is row {first(which)}")
    return rows[forward], t[forward]


def _segments(t: np.ndarray, dt: float, notes: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Places of the rows in segments of LEAST_ROWS and more, cut at gaps of the stamps t, and where in these one starts."""
    limit = max(GAP * dt, GAP_SECONDS)
    _note_steps(np.diff(t), dt, limit, notes)
    cuts = np.flatnonzero(np.diff(t) > limit) + 1
    bounds = np.r_[0, cuts, len(t)]
    long_enough = np.diff(bounds) >= LEAST_ROWS
    if len(cuts):
        at = ", ".join(f"{t[c - 1]:.4g}" for c in cuts[:5]) + (" ..." if len(cuts) > 5 else "")
        notes.append(f"cut into {long_enough.sum()} segments at gaps of more than {1e3 * limit:.3g} ms, after t = {at} s")
    if not long_enough.any():
        raise ValueError(f"no stretch of {LEAST_ROWS} rows is without a gap of more than {limit:.3g} s; record it again")
    use = np.flatnonzero(np.repeat(long_enough, np.diff(bounds)))
    if len(use) < len(t):
        notes.append(f"{len(t) - len(use)} rows in stretches of fewer than {LEAST_ROWS} left out")
    return use, np.flatnonzero(np.isin(use, bounds[:-1]))


def _note_steps(steps: np.ndarray, dt: float, limit: float, notes: list[str]) -> None:
    """Say whether steps s vary, and which gaps up to ``limit`` s are bridged."""
    low, high = np.percentile(steps, [1, 99])
    if high - low > 0.2 * dt:
        notes.append(f"steps vary from {1e3 * low:.3g} to {1e3 * high:.3g} ms; resampled to {1e3 * dt:.4g} ms")
    bridged = steps[(steps > 1.9 * dt) & (steps <= limit)]
    if len(bridged):
        notes.append(f"{len(bridged)} gaps of up to {1e3 * bridged.max():.3g} ms bridged by straight lines")


class Even(NamedTuple):
    """Rows at even times."""

    t: np.ndarray  # [T] s
    values: list[np.ndarray]  # [T, n] each
    segments: tuple[tuple[int, int], ...]  # [start, stop)
    jitter: np.ndarray  # [T] s, by which the time between readings may be wrong
    rest: float  # s, from the last of these times to the last row


def resample(rows: Rows, values: list[np.ndarray], dt: float, begin: float = 0.0) -> Even:
    """The rows at every ``dt``, the first ``begin`` s after the first row, by straight lines between them."""
    times, out, segments, jitter, length = [], [[] for _ in values], [], [], 0
    for start, stop in zip(rows.starts, [*rows.starts[1:], len(rows.t)], strict=True):
        t = rows.t[start:stop]
        start_at = t[0] + (0.0 if times else begin)
        ticks = int(np.floor((t[-1] - start_at) / dt + 1e-3)) + 1  # stamps may be of single precision
        grid = start_at + dt * np.arange(ticks)
        even = len(t) == ticks and np.allclose(t, grid, rtol=0, atol=1e-6 + 1e-3 * dt)
        for column, value in zip(out, values, strict=True):
            part = value[start:stop]
            column.append(part if even else np.stack([np.interp(grid, t, c) for c in part.T], axis=1))
        jitter.append(uneven(t)[np.searchsorted(t, grid).clip(max=len(t) - 1)])
        times.append(grid)
        segments.append((length, length + ticks))
        length += ticks
    joined = [np.concatenate(column) for column in out]
    return Even(np.concatenate(times), joined, tuple(segments), np.concatenate(jitter), float(rows.t[-1] - times[-1][-1]))


def uneven(t: np.ndarray) -> np.ndarray:
    """By how much [rows] s the steps of the stamps t [rows] s around each row differ.

    Stamps of a recorder say when it wrote a row, not when the angles were read. Where steps differ by half a step and more,
    so may the two; where they often do, so may the two in every row. Smaller differences are 0: those stamps are believed.
    """
    steps = np.pad(np.diff(t), NEAR, mode="edge")
    near = np.lib.stride_tricks.sliding_window_view(steps, 2 * NEAR)
    apart = np.ptp(near, axis=1)
    apart = np.maximum(apart, np.quantile(apart, 0.9))
    return np.where(apart > UNEVEN * np.median(steps), apart, 0.0)
