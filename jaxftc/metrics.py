"""Figures of merit of a simulated run, from its stored trace. Plain NumPy: slow, obvious, and the same for every command.

Angles are given in degrees here because people read these numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxftc.config import Config
from jaxftc.types import ACTUATOR, BOTH, NORMAL, SENSOR

SETTLE = 0.060  # s after the alarm at which the verdict is scored


class Metrics(NamedTuple):
    """One run, all joints together."""

    fault_tau_rms_nm: float  # of the torque-fault estimate's error
    fault_q_rms_deg: float  # of the encoder-fault estimate's error
    delay_s: float | None  # from onset to the first alarm; None if there is no fault, infinite if it was missed
    isolated: bool  # every joint's verdict right SETTLE after the alarm; without a fault: no alarm at all
    tracking_rms_deg: float  # of the true angle against the reference
    chattering: float  # 1/s, total variation of torque over the torque limit, mean over joints


def rms(x: np.ndarray) -> float:
    """Root mean square of all entries."""
    return float(np.sqrt(np.mean(np.square(x, dtype=np.float64))))


def true_verdict(fault_tau_kind: np.ndarray, fault_q_kind: np.ndarray) -> np.ndarray:
    """Verdict [n] that is right while the faults are there, from their kinds [n]."""
    actuator, sensor = np.asarray(fault_tau_kind) > 0, np.asarray(fault_q_kind) > 0
    return np.select([actuator & sensor, actuator, sensor], [BOTH, ACTUATOR, SENSOR], NORMAL)


def detection(
    config: Config, verdict: np.ndarray, wanted: np.ndarray, onset: float
) -> tuple[float | None, bool, np.ndarray]:
    """(delay s, isolated, scored verdict [n]) of a run's verdicts [T, n] against the wanted one [n]."""
    if not (wanted != NORMAL).any():
        return None, not (verdict != NORMAL).any(), verdict.max(0)
    first_tick = int(np.ceil(onset / config.dt - 1e-6))
    alarms = np.flatnonzero((verdict[first_tick:] != NORMAL).any(1))
    if not alarms.size:
        return float("inf"), False, verdict[-1]
    at = min(first_tick + int(alarms[0]) + round(SETTLE / config.dt), len(verdict) - 1)
    return int(alarms[0]) * config.dt, bool((verdict[at] == wanted).all()), verdict[at]


def chattering(tau: np.ndarray, limit: np.ndarray, dt: float) -> float:
    """Total variation per second of torque [T, n] over its limit [n], mean over joints; without a limit, of the torque."""
    scale = np.where(np.isfinite(limit), limit, 1.0)
    return float(np.abs(np.diff(tau / scale, axis=0)).sum(0).mean() / (len(tau) * dt))


def evaluate(config: Config, trace: dict[str, np.ndarray], wanted: np.ndarray, onset: float) -> Metrics:
    """All figures of one run; ``trace`` is a column per signal, [T, n], as ``columns`` gives it."""
    delay, isolated, _ = detection(config, trace["verdict"], wanted, onset)
    return Metrics(
        fault_tau_rms_nm=rms(trace["fault_tau_hat"] - trace["fault_tau"]),
        fault_q_rms_deg=float(np.rad2deg(rms(trace["fault_q_hat"] - trace["fault_q"]))),
        delay_s=delay,
        isolated=isolated,
        tracking_rms_deg=float(np.rad2deg(rms(trace["q"] - trace["q_ref"]))),
        chattering=chattering(trace["tau"], config.robot.torque_limit, config.dt),
    )


def columns(trace: object, scenario: int | None = None) -> dict[str, np.ndarray]:
    """Signals of a ``Trace`` by name, the controller's outputs among them; one scenario of several if asked for."""
    flat = trace._asdict()  # pyright: ignore[reportAttributeAccessIssue]
    flat |= flat.pop("out")._asdict()
    arrays = {name: np.asarray(value) for name, value in flat.items()}
    if scenario is None:
        return arrays
    return {name: value if name == "t" else value[..., scenario] for name, value in arrays.items()}
