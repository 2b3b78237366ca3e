"""Figures from samples, with their intervals. Runs that never end (a missed fault) are infinite, not left out."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import betaincinv

RESAMPLES = 2000
LEVEL = 0.95


class Interval(NamedTuple):
    """A figure and its interval."""

    value: float
    low: float
    high: float


def bootstrap(pairs: np.ndarray, figure: Callable[[np.ndarray], np.ndarray], seed: int = 0) -> Interval:
    """``figure`` of rows [k, scenarios], and its percentile interval over resampled scenarios."""
    rows = np.random.default_rng(seed).integers(0, pairs.shape[1], (RESAMPLES, pairs.shape[1]))
    tails = np.quantile(figure(pairs[:, rows]), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Interval(float(figure(pairs)), *map(float, tails))


def median(x: np.ndarray) -> Interval:
    """Median of a sample and its bootstrap interval; nan without a sample.

    The median of a resample is the entry at a rank which follows a beta distribution, so the bootstrap's quantiles are
    entries of the sorted sample: the result of endless resampling, at the price of one sort.
    """
    n = len(x)
    if n == 0:
        return Interval(math.nan, math.nan, math.nan)
    ordered, half = np.sort(x), (n + 1) / 2
    tails = betaincinv(half, half, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    low, high = ordered[np.minimum((n * tails).astype(int), n - 1)]
    lower, upper = ordered[(n - 1) // 2], ordered[n // 2]  # their mean may be of infinities
    return Interval(float(lower if lower == upper else (lower + upper) / 2), float(low), float(high))


def share(count: int, n: int) -> Interval:
    """Share of n runs and its Clopper-Pearson interval; nan without a run."""
    if n == 0:
        return Interval(math.nan, math.nan, math.nan)
    tail = (1 - LEVEL) / 2
    low = betaincinv(count, n - count + 1, tail) if count > 0 else 0.0
    high = betaincinv(count + 1, n - count, 1 - tail) if count < n else 1.0
    return Interval(count / n, float(low), float(high))


def tolerated(n: int, p: float, confidence: float) -> int:
    """How many of n runs may exceed a level if at most a share p does so in the long run, with that confidence.

    The largest k with P(Binomial(n, p) <= k) <= 1 - confidence; -1 if n runs are too few to say so.
    """
    k = -1
    while k + 1 < n and betaincinv(k + 2, n - k - 1, confidence) <= p:  # upper confidence bound of the share after k + 1
        k += 1
    return k


def check_shares(false_alarms: float, confidence: float) -> None:
    """Refuse a share of false alarms, or a confidence in it, that is none.

    Raises:
        ValueError: one of them lies outside (0, 1).
    """
    for name, value, usual in (("false_alarms", false_alarms, 0.01), ("confidence", confidence, 0.95)):
        if not 0 < value < 1:
            raise ValueError(f"{name} must lie in (0, 1), got {value!r}; {usual:g} is usual")
