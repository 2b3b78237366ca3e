"""Schemes' verdicts beside what an oracle could have said: soon after the alarm, and once they have settled."""

from __future__ import annotations

from typing import Any

from jaxftc.evaluation.metrics import SETTLE
from jaxftc.evaluation.online import SETTLED
from jaxftc.evaluation.summary import FAULTY

SOON, LATE = f"{1e3 * SETTLE:.0f} ms", f"{1e3 * SETTLED:.0f} ms"
HEAD = ("scheme", "detected", "kind", "joint", "exact", "kind", "joint", "exact", *FAULTY, "two faults")
UNITS = ("", "%", *(f"% at {SOON}",) * 3, *(f"% at {LATE}",) * 3, *("delay ms",) * 3, "both named, ms")
SHARES = ("detection", *(f"isolation{part}{when}" for when in ("", "_settled") for part in ("_kind", "_joint", "")))
NOTE = (
    f"Shares of the detected faults whose kind, joints, or exact verdict of every joint was right {SOON} and {LATE} after "
    "the alarm, or at clearance if that is sooner. An oracle knows every fault that has been as large as its threshold "
    "(jaxftc/evaluation/oracle.py)."
)


def cells(found: dict[str, dict[str, Any]]) -> list[tuple[str, ...]]:
    """Two rows a scheme: what it said, and what an oracle could have said at the same moments."""
    rows = []
    for name, result in found.items():
        rows.append(_row(name, result, "", "delay"))
        rows.append(_row(f"oracle, {name}", result, "_ceiling", "visible"))
    return rows


def _row(name: str, result: dict[str, Any], kind: str, time: str) -> tuple[str, ...]:
    shares = [show(result[f"{share}{kind}"], 100, 2) for share in SHARES]
    drawn, times = result["n_by_kind"], result[f"{time}_median_s"]
    delays = [show(times[fault], 1e3, 0, "missed" if drawn[fault] else "-") for fault in FAULTY]
    named = show(result["complete_median_s"]["both"], 1e3, 0, "never" if drawn["both"] else "-") if not kind else "-"
    return (name, *shares, *delays, named)


def guesses(found: dict[str, Any]) -> list[str]:
    """How many verdicts say that they are a guess, and how often they and the others are right: a sentence, or none."""
    parts = []
    for when, moment in (("", SOON), ("_settled", LATE)):
        if found[f"unsure{when}"]:
            right = [show(found[f"isolation_kind{when}_{which}"], 100, 1) for which in ("unsure", "sure")]
            share = show(found[f"unsure{when}"], 100, 1)
            parts.append(f"{share} % at {moment} (their kind is right in {right[0]} %, that of the others in {right[1]} %)")
    return [f"Fault, kind unknown: of {', '.join(parts)}."] if parts else []


def show(x: float | None, factor: float, places: int, absent: str = "-") -> str:
    """A figure as text."""
    return absent if x is None else f"{factor * x:.{places}f}"
