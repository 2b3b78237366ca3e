"""What a picture needs of a trace: motion, reference, true faults and verdicts, as ``trace_file`` stores them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from jaxftc.evaluation.metrics import SETTLE
from jaxftc.io import tables
from jaxftc.types import Verdict

HEALTHY, FAULT, DETECTED, ALARM = range(4)  # state of a joint: nothing, fault not found, fault found, alarm without a fault
STATES = ("healthy", "fault", "fault, detected", "alarm, no fault")


@dataclasses.dataclass(frozen=True)
class Replay:
    """One run by tick."""

    joints: tuple[str, ...]
    t: np.ndarray  # [T] s
    q: np.ndarray  # [T, n] rad, true angles
    q_ref: np.ndarray  # [T, n] rad
    fault_tau: np.ndarray  # [T, n] N m, true actuator fault
    fault_q: np.ndarray  # [T, n] rad, true encoder fault
    contact_tau: np.ndarray  # [T, n] N m, true torque of a contact
    verdict: np.ndarray  # [T, n] int, as in ``Verdict``

    @property
    def truth(self) -> np.ndarray:
        """The verdict [T, n] that would be right at each tick."""
        bears = np.logical_or.accumulate((self.contact_tau != 0)[:, ::-1], axis=1)[:, ::-1]
        return Verdict.ACTUATOR * (self.fault_tau != 0) | Verdict.SENSOR * (self.fault_q != 0) | Verdict.CONTACT * bears

    @property
    def states(self) -> np.ndarray:
        """State of every joint [T, n]; a fault counts as found whatever kind the verdict says."""
        there, called = self.truth != Verdict.NORMAL, self.verdict != Verdict.NORMAL
        return np.select([there & called, there, called], [DETECTED, FAULT, ALARM], HEALTHY)

    def tick(self, t: float | np.ndarray) -> np.ndarray:
        """The tick nearest to time t s."""
        return np.searchsorted((self.t[1:] + self.t[:-1]) / 2, t)

    def moment(self) -> float:
        """Time, s, that says most in one picture: when verdicts are scored after the first alarm, or the middle of a run."""
        alarms = np.flatnonzero((self.verdict != Verdict.NORMAL).any(1))
        if not alarms.size:
            return float(self.t[len(self.t) // 2])
        return float(self.t[self.tick(self.t[alarms[0]] + SETTLE)])


def read(path: Path) -> Replay:
    """The replay of a trace file, or of a run's folder with ``trace.parquet`` in it; it ends where the arm diverges.

    Raises:
        ValueError: no such file, not a trace, or an arm that diverges at once.
    """
    path = path / "trace.parquet" if path.is_dir() else path
    if not path.is_file():
        raise ValueError(f"no trace at {path}; give a folder that `jaxftc simulate` wrote, or its trace.parquet")
    table = tables.read(path)
    joints = tuple(name.removeprefix("q_ref_") for name in table if name.startswith("q_ref_"))
    signals = ("q", "q_ref", "fault_tau", "fault_q", "contact_tau", "verdict")
    absent = [name for name in ("t", *(f"{s}_{j}" for s in signals for j in joints)) if name not in table]
    if not joints or absent:
        raise ValueError(f"{path} is no trace of `jaxftc simulate`: it has no column {(absent or ['q_ref_joint1'])[0]!r}")
    t = np.ma.filled(table["t"], np.nan).astype(float)
    fill = {"verdict": Verdict.NORMAL}  # DuckDB takes what is not a number for absent
    columns = {s: np.stack([np.ma.filled(table[f"{s}_{j}"], fill.get(s, np.nan)) for j in joints], axis=1) for s in signals}
    lost = np.flatnonzero(~np.isfinite(columns["q"]).all(1))
    ticks = int(lost[0]) if lost.size else len(t)
    if not ticks:
        raise ValueError(
            f"{path} has nothing to show: {'the angles are not finite from the start' if lost.size else 'no row'}"
        )
    columns = {name: values[:ticks] for name, values in columns.items()}
    held = np.where(np.isfinite(columns["q_ref"]), columns["q_ref"], columns["q"])
    return Replay(joints, t[:ticks], **columns | {"q_ref": held})


def check_speed(speed: float) -> None:
    """Refuse a speed that is no speed.

    Raises:
        ValueError: it is not a positive number.
    """
    if not (np.isfinite(speed) and speed > 0):
        raise ValueError(f"speed must be a positive number, got {speed:g}; 0.25 shows a second of the run in four")
