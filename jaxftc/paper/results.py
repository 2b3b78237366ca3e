"""What the paper's experiment found: rows, comparisons, the identified model, and claims."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxftc import identify


class Row(NamedTuple):
    """One condition with one observer and one controller."""

    condition: str
    observer: str
    controller: str
    fault_tau_rms_nm: float
    fault_q_rms_deg: float
    delay_s: float | None
    isolated: bool
    false_alarm_s: float | None
    tracking_rms_deg: float
    chattering: float


class Comparison(NamedTuple):
    """Two controllers in one condition at equal chattering, over the seeds."""

    condition: str
    before: str
    after: str
    seeds: int
    chattering: float  # 1/s, at which both were read off
    louder: bool  # ``before`` is taken at its lowest chattering, which is higher than that
    before_deg: float  # tracking rms, geometric mean
    after_deg: float
    change: tuple[float, float, float]  # relative: mean, and 95 % interval from low to high

    @property
    def word(self) -> str:
        """What became of the error: falls, rises or tie."""
        return "falls" if self.change[2] < 0 else "rises" if self.change[1] > 0 else "tie"


class Arx(NamedTuple):
    """The ARX-Laguerre model identified from one healthy run, on another: same motion, other noise."""

    log: identify.Log
    free_run: np.ndarray  # [T, n] rad, predicted from the first reading and the torques alone
    errors: identify.Errors


class Claim(NamedTuple):
    """A claim of the paper, our number, and whether it was met."""

    id: str
    figure: str  # number of the paper's figure; 15b is ours, beside its 15
    claim: str
    value: float
    unit: str
    met: bool
    detail: str


class Experiment(NamedTuple):
    """Everything that the table, the claims and the report need."""

    rows: list[Row]
    comparisons: list[Comparison]
    traces: dict[tuple[str, str], list[dict[str, np.ndarray]]]  # (observer, controller) -> columns by condition
    wrong: list[dict[str, np.ndarray]]  # columns of the runs of WRONG, T-S with AFESMC
    curves: dict[str, np.ndarray]  # controller -> (chattering 1/s, tracking rms rad) [2, factors, seeds, conditions]
    arx: Arx
    claims: list[Claim]
