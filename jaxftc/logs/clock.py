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


def order(t: np.ndarray, whole: np.ndarray) -> Rows:
    """The rows that count: stamps that increase, every value there; cut at gaps and where the clock starts anew.

    Args:
        t: Stamps [T] in s; NaN is a missing one.
        whole: [T] rows in which all values are numbers.

    Raises:
        ValueError: nothing is left, or so many stamps go back that the order cannot be known.
    """
    notes: list[str] = []
    usable = np.flatnonzero(whole & np.isfinite(t))
    if len(usable) < 2:
        raise ValueError(f"{len(usable)} of {len(t)} rows have a time and all values; record the motion again")
    if len(usable) < len(t):
        first = int(np.flatnonzero(~(whole & np.isfinite(t)))[0]) + 1
        notes.append(f"{len(t) - len(usable)} rows with a missing value left out, the first is row {first}")
        if len(usable) < 0.5 * len(t):
            raise ValueError(
                f"{len(t) - len(usable)} of {len(t)} rows miss a value, the first is row {first}; record it again"
            )
    t = t[usable]
    if (np.diff(t) <= 0).all() and np.ptp(t) > 0:
        usable, t = usable[::-1], t[::-1] - t[-1]
        notes.append("the rows run backwards in time; turned round")
    dt = own_rate(t)
    restarts = [k for k in np.flatnonzero(np.diff(t) < -10 * dt) + 1 if (t[k : k + RESTART_ROWS] < t[k - 1]).all()]
    restarts = [k for k in restarts if len(t) - k >= RESTART_ROWS]
    t = t.copy()
    for k in restarts:
        t[k:] += t[k - 1] - t[k] + max(1.0, 10 * GAP * dt)
    if restarts:
        notes.append(f"the clock starts anew at row {usable[restarts[0]] + 1}; taken as {len(restarts) + 1} recordings")
    latest = np.maximum.accumulate(t)
    forward = np.r_[True, t[1:] > latest[:-1]]
    equal = np.r_[False, t[1:] == latest[:-1]]
    back = ~forward & ~equal
    if back.sum() > 0.1 * len(t):
        row = int(usable[np.flatnonzero(back)[0]]) + 1
        raise ValueError(
            f"the time goes back in {back.sum()} of {len(t)} rows, the first is row {row}; sort the rows by time"
        )
    for which, word in ((equal, "the same time as the one before"), (back, "a time before that of an earlier one")):
        if which.any():
            notes.append(f"{which.sum()} rows with {word} left out, the first is row {usable[np.flatnonzero(which)[0]] + 1}")
    kept, t = usable[forward], t[forward]
    steps = np.diff(t)
    limit = max(GAP * dt, GAP_SECONDS)
    cuts = np.flatnonzero(steps > limit) + 1
    bridged = (steps > 1.9 * dt) & (steps <= limit)
    spread = np.percentile(steps, [1, 99])
    if spread[1] - spread[0] > 0.2 * dt:
        notes.append(f"steps vary from {1e3 * spread[0]:.3g} to {1e3 * spread[1]:.3g} ms; resampled to {1e3 * dt:.4g} ms")
    if bridged.any():
        longest = 1e3 * steps[bridged].max()
        notes.append(f"{bridged.sum()} gaps of up to {longest:.3g} ms bridged by straight lines")
    bounds = np.r_[0, cuts, len(t)]
    long_enough = np.diff(bounds) >= LEAST_ROWS
    if len(cuts):
        at = ", ".join(f"{t[c - 1]:.4g}" for c in cuts[:5]) + (" ..." if len(cuts) > 5 else "")
        notes.append(f"cut into {long_enough.sum()} segments at gaps of more than {1e3 * limit:.3g} ms, after t = {at} s")
    if not long_enough.any():
        raise ValueError(f"no stretch of {LEAST_ROWS} rows is without a gap of more than {limit:.3g} s; record it again")
    use = np.concatenate([np.arange(a, b) for a, b, ok in zip(bounds, bounds[1:], long_enough, strict=False) if ok])
    if len(use) < len(t):
        notes.append(f"{len(t) - len(use)} rows in stretches of fewer than {LEAST_ROWS} left out")
    starts = np.flatnonzero(np.isin(use, bounds[:-1]))
    return Rows(kept[use], t[use], starts, dt, notes)


class Even(NamedTuple):
    """Rows at even times."""

    t: np.ndarray  # [T] s
    values: list[np.ndarray]  # [T, n] each
    segments: tuple[tuple[int, int], ...]  # [start, stop)
    jitter: np.ndarray  # [T] s, by which the time between readings may be wrong


def resample(rows: Rows, values: list[np.ndarray], dt: float) -> Even:
    """The rows at every ``dt``, by straight lines between them."""
    times, out, segments, jitter, length = [], [[] for _ in values], [], [], 0
    for start, stop in zip(rows.starts, [*rows.starts[1:], len(rows.t)], strict=True):
        t = rows.t[start:stop]
        ticks = int(np.floor((t[-1] - t[0]) / dt + 1e-3)) + 1  # stamps may be of single precision
        grid = t[0] + dt * np.arange(ticks)
        even = len(t) == ticks and np.allclose(t, grid, rtol=0, atol=1e-6 + 1e-3 * dt)
        for column, value in zip(out, values, strict=True):
            part = value[start:stop]
            column.append(part if even else np.stack([np.interp(grid, t, c) for c in part.T], axis=1))
        jitter.append(uneven(t)[np.searchsorted(t, grid).clip(max=len(t) - 1)])
        times.append(grid)
        segments.append((length, length + ticks))
        length += ticks
    joined = [np.concatenate(column) for column in out]
    return Even(np.concatenate(times), joined, tuple(segments), np.concatenate(jitter))


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
