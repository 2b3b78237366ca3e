"""Speed and acceleration of a recorded motion: a low-pass without lag, its band found in the readings.

Where the spectrum of a joint's angle meets the encoder's noise, nothing of the motion is left to differentiate. Above some
10 Hz arms swing in their gears, which no rigid model has, so the band ends there. Each joint gets a Butterworth filter of
its band, forward and backward, and differences of what comes out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import signal

from jaxftc.logs.log import Log

LOWEST, RIGID, HIGHEST = 4.0, 10.0, 0.2  # Hz, Hz, and part of the sample rate: limits of the band
ABOVE = 2.0  # times the noise that the spectrum must reach to be motion; there, half of it is
EDGE = 0.1  # s at the ends of a stretch, where the filter has one side only


class Motion(NamedTuple):
    """A log with its derivatives, [T, n] each."""

    q: np.ndarray  # rad, filtered
    qd: np.ndarray  # rad/s
    qdd: np.ndarray  # rad/s^2
    tau: np.ndarray  # as recorded
    inside: np.ndarray  # [T] away from the ends of stretches
    stretch: np.ndarray  # [T] number of the stretch
    band: np.ndarray  # [n] Hz


def band(log: Log) -> np.ndarray:
    """Hz [n] up to which each joint's angle shows motion."""
    dt = log.sample_time
    start, stop = max(log.stretches, key=lambda s: s[1] - s[0])
    q = np.asarray(log.q, float)[start:stop]
    size = min(len(q) - 1, 1 << int(np.log2(max(4.0 / dt, 64))))  # 4 s resolve a quarter of a hertz
    frequency, power = signal.welch(np.diff(q, axis=0), 1 / dt, nperseg=size, axis=0)
    power = power[1:] / (2 * np.sin(np.pi * frequency[1:] * dt))[:, None] ** 2  # of the angle, from that of its differences
    frequency = frequency[1:]
    noise = np.median(power[frequency > 0.3 / dt], axis=0)
    found = np.empty(q.shape[1])
    for j in range(q.shape[1]):
        smooth = signal.medfilt(power[:, j], 5)
        below = np.flatnonzero(smooth < ABOVE * noise[j])
        found[j] = frequency[below[0]] if len(below) else np.inf
    return np.clip(found, LOWEST, min(RIGID, HIGHEST / dt))


def motion(log: Log) -> Motion:
    """A log with speed and acceleration, every stretch by itself."""
    dt = log.sample_time
    limits = band(log)
    q = np.array(log.q, float)
    qd, qdd = np.zeros_like(q), np.zeros_like(q)
    inside, stretch = np.zeros(len(q), bool), np.zeros(len(q), int)
    for k, (start, stop) in enumerate(log.stretches):
        for j, limit in enumerate(limits):
            sections = signal.butter(2, 2 * limit * dt, output="sos")
            pad = min(stop - start - 1, int(3 / (limit * dt)))
            q[start:stop, j] = signal.sosfiltfilt(sections, q[start:stop, j], padtype="odd", padlen=pad)
        part = q[start:stop]
        qd[start:stop] = np.gradient(part, dt, axis=0)
        qdd[start + 1 : stop - 1] = (part[2:] - 2 * part[1:-1] + part[:-2]) / dt**2
        edge = min(round(EDGE / dt) + 1, (stop - start) // 4)
        inside[start + edge : stop - edge] = True
        stretch[start:stop] = k
    return Motion(q, qd, qdd, np.asarray(log.tau, float), inside, stretch, limits)


def encoder(logs: list[Log]) -> tuple[np.ndarray, np.ndarray]:
    """Resolution [n] rad a count (0: too fine to see) and noise [n] rad, standard deviation, of the readings."""
    resolution, noise = [], []
    for log in logs:
        steps = np.abs(np.diff(np.asarray(log.q, float), axis=0))
        counts = [np.unique(np.round(column[column > 1e-7], 9)) for column in steps.T]
        resolution.append([_count(column) for column in counts])
        start, stop = max(log.stretches, key=lambda s: s[1] - s[0])
        fourth = np.diff(np.asarray(log.q, float)[start:stop], 4, axis=0) / np.sqrt(70)  # of noise
        noise.append(1.4826 * np.median(np.abs(fourth), axis=0))
    return np.max(resolution, axis=0), np.median(noise, axis=0)


def _count(steps: np.ndarray) -> float:
    """The step of which most others are whole multiples; 0 where there is none."""
    if len(steps) < 3:
        return 0.0
    small = steps[0]
    near = np.abs(steps / small - np.round(steps / small)) < 0.1
    return float(small) if small > 1e-6 and near[: max(20, len(steps) // 10)].mean() > 0.9 else 0.0
