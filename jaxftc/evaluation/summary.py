"""What a table of rows says: shares and medians with 95 % intervals, by kind of fault, and the threshold trade-off.

A figure is taken of all kinds of fault before the next: for a table that reads its columns when they are asked for.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from jaxftc.evaluation.intervals import Interval, median, share
from jaxftc.evaluation.online import LEVELS
from jaxftc.evaluation.table import CROSSINGS
from jaxftc.gains import Gains
from jaxftc.types import KINDS, LABELS, Verdict

NORMAL = Verdict.NORMAL.label
FAULTY = LABELS[1:]
ERRORS = {  # and the kinds of scenario that they are taken over: an estimate counts where there is something to estimate
    "fault_tau_rmse_nm": ("actuator", "both", "contact"),
    "fault_q_rmse_deg": ("sensor", "both"),
    "tracking_rmse_deg": KINDS,
    "chattering": KINDS,
}
MORE = ("tracking_max_deg", "rough", "effort", "peak", "saturated_share")  # beside them, by kind of fault
ISOLATION = {"kind": "isolation_kind", "joint": "isolation_joint", "verdict": "isolation"}  # columns' word, figure
FIXED = 0.01  # share of healthy runs with an alarm at which delays are compared

Table = Mapping[str, np.ndarray]


class Part(Mapping[str, np.ndarray]):
    """Some rows of a table."""

    def __init__(self, rows: Table, where: np.ndarray) -> None:
        self._rows, self._where = rows, where

    def __getitem__(self, name: str) -> np.ndarray:
        return self._rows[name][self._where]

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)


def summarise(rows: Table, scheme: str) -> dict[str, Any]:
    """Everything for ``summary.json``; a figure ``x`` has its interval beside it, ``x_95``. Infinite and absent are null."""
    kind = rows["kind"]
    faulty, healthy = kind != NORMAL, kind == NORMAL
    early = faulty & (rows["onset_s"] > 0)
    found = {"n": len(kind), "scheme": scheme, "n_healthy": int(healthy.sum()), "diverged": int(rows["diverged"].sum())}
    found |= _share("false_alarm_runs", rows["false_alarm"][healthy])
    found |= _share("false_alarm_before_onset", rows["false_alarm"][early])
    found |= _detection(Part(rows, faulty))
    names = kinds(rows)
    found["n_by_kind"] = {name: int((kind == name).sum()) for name in names}
    delays = {name: median(rows["delay_s"][kind == name]) for name in names[1:]}
    found["delay_median_s"] = {name: _number(delay.value) for name, delay in delays.items()}
    found["delay_median_s_95"] = {name: _bounds(delay) for name, delay in delays.items()}
    for column in ("visible_s", "complete_s"):
        medians = {name: median(rows[column][kind == name]) for name in names[1:]}
        found[f"{column[:-2]}_median_s"] = {name: _number(found_at.value) for name, found_at in medians.items()}
    found["confusion"] = confusion(rows).tolist()
    gone = rows["detected"] & (rows["kind_hat"] == NORMAL)
    found["alarm_gone"] = [int((gone & (kind == name)).sum()) for name in names]  # of those said to be normal
    found["by_kind"] = _by_kind(rows)
    found["errors"] = {name: _number(median(rows[name][np.isin(kind, over)]).value) for name, over in ERRORS.items()}
    curve = roc(rows)
    return found | {"roc": curve, "at_fixed_false_alarms": _at_fixed(curve)}


def by_kind(rows: Table) -> dict[str, Part]:
    """The rows of each kind of fault, by its name: ``actuator bias``, ``both bias + drift``."""
    fault = rows["fault"]
    names = sorted(set(fault) - {NORMAL})
    return {str(name): Part(rows, np.flatnonzero(fault == name)) for name in names}


def kinds(rows: Table) -> tuple[str, ...]:
    """What was wrong, or said to be: the verdicts 0 to 3, and contact where there is one."""
    touched = (rows["kind"] == KINDS[-1]) | (rows["kind_hat"] == KINDS[-1])
    return KINDS if touched.any() else LABELS


def confusion(rows: Table) -> np.ndarray:
    """Counts [kinds, kinds]: true kind by row, verdict 60 ms after the alarm by column, in the order of ``kinds``."""
    true, said = ([rows[column] == name for name in kinds(rows)] for column in ("kind", "kind_hat"))
    return np.array([[int((t & s).sum()) for s in said] for t in true])


def small(rows: Table, gains: Gains) -> dict[str, float]:
    """Share of the biases of a channel that are smaller than their joint's threshold at rest; without any it is left out."""
    levels = {"actuator bias": ("tau", np.asarray(gains.diagnosis.alpha_tau, float))}
    levels["encoder bias"] = ("q", np.rad2deg(np.asarray(gains.diagnosis.alpha_q, float)))
    found = {}
    for name, (channel, level) in levels.items():
        there = rows[f"fault_{channel}"] == "bias"
        if there.any():
            size, joint = rows[f"magnitude_{channel}"][there], rows[f"joint_{channel}"][there]
            found[name] = float((np.abs(size) < level[joint - 1]).mean())
    return found


def roc(rows: Table) -> dict[str, Any]:
    """False alarms, detection and delay with all thresholds times a scale; the loop itself ran at scale 1.

    The sensor check does not scale, and the fuzzy stage keeps the thresholds it ran with.
    """
    kind, names = rows["kind"], kinds(rows)[1:]
    healthy = rows["healthy_ratio"][kind == NORMAL]
    detection: dict[str, list[float | None]] = {name: [] for name in names}
    delay: dict[str, list[float | None]] = {name: [] for name in names}
    for column in CROSSINGS:
        for name in names:
            crossed = rows[column][kind == name]
            detection[name].append(_number(_mean(np.isfinite(crossed))))
            delay[name].append(_number(median(crossed).value))
    return {
        "scale": [round(float(level), 4) for level in LEVELS],
        "false_alarm_runs": [_number(share(int((healthy >= level).sum()), len(healthy)).value) for level in LEVELS],
        "detection": detection,
        "delay_median_s": delay,
    }


def _at_fixed(curve: dict[str, Any]) -> dict[str, Any]:
    """Detection and delay at the smallest scale of the ROC at which at most FIXED of the healthy runs raise an alarm."""
    enough = [k for k, value in enumerate(curve["false_alarm_runs"]) if value is not None and value <= FIXED]
    if not enough:
        return {"false_alarm_runs": FIXED, "scale": None}
    k = enough[0]
    picked = {key: {name: values[k] for name, values in curve[key].items()} for key in ("detection", "delay_median_s")}
    return {"false_alarm_runs": curve["false_alarm_runs"][k], "scale": curve["scale"][k]} | picked


def _by_kind(rows: Table) -> dict[str, dict[str, Any]]:
    parts = by_kind(rows)
    found = {name: _detection(part) for name, part in parts.items()}
    for column in ("delay_s", "visible_s", "isolated_s", "complete_s", "recovery_s", *ERRORS, *MORE):
        for name, part in parts.items():
            found[name] |= _median(column, part[column])
    return found


def _detection(rows: Table) -> dict[str, Any]:
    """Detection, and isolation among the detected, soon and settled; beside each share the ceiling, which an oracle reaches.

    ``x_unseen`` is the share of what was missed, or wrong, that no oracle could have had right. ``unsure`` is the share of
    verdicts that say that they are a guess, ``..._unsure`` and ``..._sure`` how many of these and of the others are right.
    """
    detected, seen = rows["detected"], np.isfinite(rows["visible_s"])
    found: dict[str, Any] = (
        {"n_faults": len(detected)} | _share("detection", detected) | _ceiling("detection", detected, seen)
    )
    for part in ISOLATION:
        for when in ("", "_settled"):
            right, visible = (rows[f"{part}_{word}{when}"][detected] for word in ("right", "visible"))
            name = f"{ISOLATION[part]}{when}"
            found |= _share(name, right) | _ceiling(name, right, visible)
    for when in ("", "_settled"):
        unsure, kind = rows[f"unsure{when}"][detected], rows[f"kind_right{when}"][detected]
        found |= {f"unsure{when}": _number(_mean(unsure)), f"isolation_kind{when}_unsure": _number(_mean(kind[unsure]))}
        found[f"isolation_kind{when}_sure"] = _number(_mean(kind[~unsure]))
    return found


def _ceiling(name: str, right: np.ndarray, visible: np.ndarray) -> dict[str, Any]:
    """Share of the runs that an oracle has right, and of those that are wrong the share that it has wrong too."""
    shares = {f"{name}_ceiling": visible, f"{name}_unseen": ~visible[~right]}
    return {key: _number(_mean(flags)) for key, flags in shares.items()}


def _median(column: str, values: np.ndarray) -> dict[str, Any]:
    """Under the column's name; a time's as ``<name>_median_s``, of a delay with its interval."""
    if not column.endswith("_s"):
        return {column: _number(median(values).value)}
    name = f"{column[:-2]}_median_s"
    if column == "recovery_s":
        return {name: _number(median(values[~np.isnan(values)]).value)}
    interval = median(values)
    return {name: _number(interval.value), f"{name}_95": _bounds(interval)}


def _mean(x: np.ndarray) -> float:
    return float(x.mean()) if len(x) else math.nan


def _share(name: str, flags: np.ndarray) -> dict[str, Any]:
    interval = share(int(flags.sum()), len(flags))
    return {name: _number(interval.value), f"{name}_95": _bounds(interval)}


def _bounds(interval: Interval) -> list[float | None]:
    return [_number(interval.low), _number(interval.high)]


def _number(x: float) -> float | None:
    return float(x) if math.isfinite(x) else None
