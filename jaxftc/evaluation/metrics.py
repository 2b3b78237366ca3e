"""Figures of merit of a simulated run, from its stored trace. Plain NumPy: slow, obvious, and the same for every command.

Angles are given in degrees here because people read these numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxftc.config import Config
from jaxftc.types import Verdict

SETTLE = 0.060  # s after the alarm at which the verdict is scored
RECOVERY = 0.100  # s after a fault has gone within which alarms may last


class Metrics(NamedTuple):
    """One run, all joints together."""

    fault_tau_rms_nm: float  # of the torque-fault estimate's error
    fault_q_rms_deg: float  # of the encoder-fault estimate's error
    delay_s: float | None  # from onset to the first alarm; None if there is no fault, infinite if it was missed
    isolated: bool  # every joint's verdict right SETTLE after the alarm; without a fault: no alarm at all
    false_alarm_s: float | None  # first time of an alarm without a fault, None if there was none
    tracking_rms_deg: float  # of the true angle against the reference
    chattering: float  # 1/s, total variation of torque over the torque limit, mean over joints


class Detection(NamedTuple):
    """What became of a fault."""

    delay_s: float | None  # as in Metrics
    isolated: bool
    false_alarm_s: float | None
    verdict: np.ndarray  # [n] as scored
    scored: int | None = None  # tick of that; None without a fault or an alarm


def rms(x: np.ndarray) -> float:
    """Root mean square of all entries."""
    return float(np.sqrt(np.mean(np.square(x, dtype=np.float64))))


def truth(trace: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(verdict [n] that is right while the faults are there, whether any is there [T]) of a trace's true faults [T, n].

    A force is borne by all joints before the last that it turns.
    """
    tau, q, contact = (trace[name] != 0 for name in ("fault_tau", "fault_q", "contact_tau"))
    bears = np.logical_or.accumulate(contact.any(0)[::-1])[::-1]
    wanted = Verdict.ACTUATOR * tau.any(0) | Verdict.SENSOR * q.any(0) | Verdict.CONTACT * bears
    return wanted, (tau | q | contact).any(1)


def detection(config: Config, verdict: np.ndarray, wanted: np.ndarray, present: np.ndarray) -> Detection:
    """What became of the faults of a run.

    The delay runs from onset to the first alarm of a joint and channel that rises then or later; the verdict is scored
    SETTLE after that. An alarm before onset, or later than RECOVERY after the last tick of a fault, is a false one and finds
    nothing, also if it is still up when the fault comes.

    Args:
        config: Robot and time step.
        verdict: [T, n] of ``Verdict``.
        wanted: [n], the one that is right.
        present: [T] bool, when a fault is there.

    Returns:
        Delay, isolation, false alarms and the verdict that was scored.
    """
    alarm, ticks = (verdict != Verdict.NORMAL).any(1), np.arange(len(verdict))
    there = np.flatnonzero(present)
    first, last = (there[0], there[-1]) if there.size else (len(verdict), -1)
    excused = (ticks >= first) & (ticks <= last + round(RECOVERY / config.dt))
    false = np.flatnonzero(alarm & ~excused)
    false_alarm_s = float(false[0] * config.dt) if false.size else None
    if not there.size:
        return Detection(None, not false.size, false_alarm_s, verdict.max(0))
    before = np.vstack([np.zeros_like(verdict[:1]), verdict[:-1]])
    alarms = np.flatnonzero((verdict & ~before > 0).any(1) & excused)
    if not alarms.size:
        return Detection(float("inf"), False, false_alarm_s, np.zeros_like(verdict[0]))
    at = min(int(alarms[0]) + round(SETTLE / config.dt), len(verdict) - 1)
    delay = (int(alarms[0]) - int(first)) * config.dt
    return Detection(delay, bool((verdict[at] == wanted).all()), false_alarm_s, verdict[at], at)


def chattering(tau: np.ndarray, limit: np.ndarray, dt: float) -> float:
    """Total variation per second of torque [T, n] over its limit [n], mean over joints; without a limit, of the torque."""
    scale = np.where(np.isfinite(limit), limit, 1.0)
    return float(np.abs(np.diff(tau / scale, axis=0)).sum(0).mean() / (len(tau) * dt))


def at_level(curve: np.ndarray, level: float) -> tuple[float, float]:
    """(chattering, tracking) where a curve [2, factors] reaches a chattering level, log-log, at its end if it does not.

    Two controllers are compared fairly where they chatter alike.
    """
    x, y = np.log(curve[:, np.argsort(curve[0])])
    reached = np.clip(np.log(level), x[0], x[-1])
    return float(np.exp(reached)), float(np.exp(np.interp(reached, x, y)))


def evaluate(config: Config, trace: dict[str, np.ndarray]) -> Metrics:
    """All figures of one run.

    Args:
        config: Robot and time step.
        trace: Signals by name, [T, n] each, as ``columns`` gives them.

    Returns:
        Figures of all joints together.

    Raises:
        ValueError: the arm diverged.
    """
    lost = np.flatnonzero(~np.isfinite(trace["q"]).all(1))
    if lost.size:
        raise ValueError(
            f"the arm diverged: its angles are not finite from {lost[0] * config.dt:g} s on; "
            + (
                "its file gives no motor inertia and no friction, so give both in an arm.toml; or "
                * config.robot.frictionless
            )
            + "give smaller faults or gains, or a longer motion"
        )
    found = detection(config, trace["verdict"], *truth(trace))
    return Metrics(
        fault_tau_rms_nm=rms(trace["fault_tau_hat"] - (trace["fault_tau"] + trace["contact_tau"])),
        fault_q_rms_deg=float(np.rad2deg(rms(trace["fault_q_hat"] - trace["fault_q"]))),
        delay_s=found.delay_s,
        isolated=found.isolated,
        false_alarm_s=found.false_alarm_s,
        tracking_rms_deg=float(np.rad2deg(rms(trace["q"] - trace["q_ref"]))),
        chattering=chattering(trace["tau"], config.robot.torque_limit, config.dt),
    )


def columns(trace: object, scenario: int | None = None) -> dict[str, np.ndarray]:
    """Signals of a ``Trace`` by name, the controller's outputs among them.

    Args:
        trace: Of ``simulate``.
        scenario: Which one of a set, from 0; None if the trace is of one run.

    Returns:
        Arrays [T, n], or [T] for the time.
    """
    flat = trace._asdict()  # pyright: ignore[reportAttributeAccessIssue]
    flat |= flat.pop("out")._asdict()
    arrays = {name: np.asarray(value) for name, value in flat.items()}
    if scenario is None:
        return arrays
    return {name: value[scenario] for name, value in arrays.items()}
