"""Schemes against each other on the same scenarios: a table of figures, and who is earlier where."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxftc.evaluation import verdicts
from jaxftc.evaluation.intervals import Interval, median, share
from jaxftc.evaluation.summary import ERRORS, FAULTY, Table
from jaxftc.io.text_table import aligned
from jaxftc.types import KINDS

UNFIT = 0.1  # share of healthy runs with an alarm beyond which thresholds are of no use
MOSTLY = 0.5  # share of faults below the thresholds from which it is said
WINS = ("wins", "loses", "ties")  # by the 95 % interval of the paired figure

RISES = {  # what torque thresholds follow, and the unit of the share by which they rise
    "follow_speed": "speed, s/rad",
    "follow_acceleration": "acceleration, s^2/rad",
    "follow_reversal": "turning round, 1",
    "follow_torque": "the links' torque, 1/(N m)",
    "follow_payload": "a payload's torque, 1/(N m)",
}


def against(rows: Mapping[str, Table]) -> list[dict[str, Any]]:
    """The first scheme against each other one, by kind of scenario, paired by scenario.

    ``earlier`` is the share of faults that the first finds sooner among those that one of them finds sooner;
    a ratio is the median over scenarios of the first's error over the other's.
    """
    (first, ours), *others = rows.items()
    return [
        {"scheme": first, "other": other, "kind": kind} | _pair(ours, theirs, kind)
        for other, theirs in others
        for kind in KINDS[1:]
        if (ours["kind"] == kind).any()
    ]


def _pair(ours: Table, theirs: Table, kind: str) -> dict[str, Any]:
    where = ours["kind"] == kind
    mine, other = ours["delay_s"][where], theirs["delay_s"][where]
    sooner, later = int((mine < other).sum()), int((mine > other).sum())
    early = share(sooner, sooner + later)
    found: dict[str, Any] = {
        "n": int(where.sum()),
        "earlier": sooner,
        "later": later,
        "same": int(where.sum()) - sooner - later,
    }
    found |= {"earlier_share": _entry(early), "delay": _word(early, 0.5, more_is_better=True)}
    for error in (name for name, kinds in ERRORS.items() if kind in kinds):
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = ours[error][where] / theirs[error][where]
        interval = median(np.where(np.isnan(ratio), 1.0, ratio))  # both 0 or both infinite: alike
        found |= {error: _entry(interval) | {"word": _word(interval, 1.0, more_is_better=False)}}
    return found


def _entry(interval: Interval) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in interval._asdict().items()}


def _word(interval: Interval, even: float, *, more_is_better: bool) -> str:
    if interval.low > even or interval.high < even:
        return WINS[0] if (interval.low > even) == more_is_better else WINS[1]
    return WINS[2]


HEAD = ("scheme", "false alarms", "detection", "kind right", "joint right", "actuator", "sensor", "both", "torque est.",
        "angle est.", "tracking", "chattering")  # fmt: skip
UNITS = ("", "% of runs", "%", "% of det.", "% of det.", "delay ms", "delay ms", "delay ms", "N m", "deg", "deg", "1/s")


NOTE = (
    "Figures are medians over scenarios, where a missed fault is infinitely late. Detection is a share of all faults, right "
    "verdicts are shares of the detected ones. An estimate counts where its channel is at fault."
)

BEST = "A star is the best of its column."


def cells(found: dict[str, dict[str, Any]]) -> list[tuple[str, ...]]:
    """A row a scheme of the comparison table; the best of each figure carries a star."""
    values, absent = [], []
    for s in found.values():
        delays = [s["delay_median_s"][kind] for kind in FAULTY]
        errors = [s["errors"][error] for error in ERRORS]
        shares = [s[name] for name in ("false_alarm_runs", "detection", "isolation_kind", "isolation_joint")]
        absent.append([s["n_by_kind"][kind] == 0 for kind in FAULTY])
        values.append([_scaled(x, 100) for x in shares] + [_scaled(x, 1e3) for x in delays] + errors)
    digits = (2, 2, 2, 2, 0, 0, 0, 3, 4, 4, 2)
    better = (None, max, max, max, min, min, min, min, min, min, min)
    texts = []
    for k, (places, choose) in enumerate(zip(digits, better, strict=True)):
        column = [row[k] for row in values]
        there = [round(x, places) for x in column if x is not None]
        best = choose(there) if choose and there and len(found) > 1 else None
        never = [4 <= k < 7 and not row[k - 4] for row in absent]  # a delay of faults that were drawn and not found
        texts.append([_text(x, places, best, missed=late) for x, late in zip(column, never, strict=True)])
    return [(name, *row) for name, row in zip(found, zip(*texts, strict=True), strict=True)]


def _scaled(x: float | None, factor: float) -> float | None:
    return None if x is None else factor * x


def _text(x: float | None, places: int, best: float | None, *, missed: bool) -> str:
    if x is None:
        return "missed" if missed else "-"
    return f"{x:.{places}f}" + ("*" if best is not None and round(x, places) == best else "")


def as_text(found: dict[str, dict[str, Any]]) -> str:
    """The comparison table as text, one scheme making one row, and the table of verdicts."""
    star = f" {BEST}" if len(found) > 1 else ""
    tables = [*aligned(HEAD, UNITS, cells(found)), NOTE + star, ""]
    tables += [*aligned(verdicts.HEAD, verdicts.UNITS, verdicts.cells(found)), verdicts.NOTE]
    lines = [
        f"{name}: {line}"
        for name, result in found.items()
        for line in (*verdicts.guesses(result), calibrated(result), *thresholds(result))
    ]
    return "\n".join([*tables, *lines])


def calibrated(result: dict[str, Any]) -> str:
    """What the thresholds are worth, in a sentence."""
    found = result.get("calibration")
    if not found:
        alarms = result["false_alarm_runs"] or 0.0
        unfit = f" {100 * alarms:.0f} % of the healthy runs raise an alarm: calibrate with --false-alarms 0.01."
        return "Thresholds as given." + (unfit if alarms > UNFIT else "")
    low, high = found["false_alarm_runs_95"]
    return (
        f"Thresholds set for {100 * found['wanted']:g} % of healthy runs with an alarm: "
        f"{100 * found['false_alarm_runs']:.2f} % [{100 * low:.2f}, {100 * high:.2f}] of {found['fresh_runs']} fresh ones."
    )


def thresholds(result: dict[str, Any]) -> list[str]:
    """The thresholds that ran, and which kinds of fault are mostly smaller than them, a sentence each."""
    by_channel = result.get("thresholds", {})
    words = {"alpha_tau_nm": "N m of torque", "alpha_q_deg": "deg of the encoder"}
    lines = [f"Thresholds, {words[key]}: {_by_joint(levels)}." for key, levels in by_channel.items() if key in words]
    lines += [
        f"The torque thresholds rise with {what}: {_by_joint(by_channel[name])}."
        for name, what in RISES.items()
        if name in by_channel
    ]
    lines += [
        f"{100 * share:.0f} % OF THE {kind.upper()} FAULTS ARE SMALLER than their joint's threshold: few of them can raise "
        "an alarm. Set the thresholds for these arms (jaxftc calibrate), or draw larger faults."
        for kind, share in result.get("small_faults", {}).items()
        if share > MOSTLY
    ]
    return lines


def _by_joint(levels: dict[str, float]) -> str:
    return ", ".join(f"{joint} {level:.4g}" for joint, level in levels.items())


def pairs_as_text(pairs: list[dict[str, Any]]) -> str:
    """Who wins where, from the 95 % intervals of paired figures."""
    lines = [
        "",
        "Paired by scenario, judged by 95 % intervals. In brackets: the median of its error over the other's.",
    ]
    for pair in pairs:
        words = {"delay": pair["delay"]} | {error: pair[error]["word"] for error in ERRORS if error in pair}
        parts = [
            f"{word} {', '.join(_plain(k, pair[k]) for k, w in words.items() if w == word)}"
            for word in WINS
            if word in words.values()
        ]
        early = f"earlier in {pair['earlier']}, later in {pair['later']}, in the same tick in {pair['same']}"
        lines.append(
            f"  {pair['kind']} faults, {pair['scheme']} against {pair['other']} ({pair['n']}): {early}; {'; '.join(parts)}"
        )
    return "\n".join(lines)


def _plain(name: str, figure: Any) -> str:
    plain = {"fault_tau_rmse_nm": "torque estimate", "fault_q_rmse_deg": "angle estimate", "tracking_rmse_deg": "tracking"}
    ratio = "" if isinstance(figure, str) or figure["value"] is None else f" ({figure['value']:.2f})"
    return plain.get(name, name) + ratio


def kinds_as_text(result: dict[str, Any]) -> str:
    """One scheme by kind of fault."""
    head = f"{'fault':24}{'n':>7}{'detected':>10}{'kind right':>12}{'joint right':>12}{'delay':>9}{'isolated':>10}"
    lines = ["", head, f"{'':24}{'':7}{'%':>10}{'% of det.':>12}{'% of det.':>12}{'ms':>9}{'ms':>10}", "-" * len(head)]
    for name, part in result["by_kind"].items():
        shares = [
            _text(_scaled(part[k], 100), 1, None, missed=False) for k in ("detection", "isolation_kind", "isolation_joint")
        ]
        late = (("delay_median_s", "missed"), ("isolated_median_s", "never"))
        times = [verdicts.show(part[k], 1e3, 0, absent) for k, absent in late]
        lines.append(
            f"{name:24}{part['n_faults']:7d}{shares[0]:>10}{shares[1]:>12}{shares[2]:>12}{times[0]:>9}{times[1]:>10}"
        )
    low, high = result["false_alarm_runs_95"]
    alarms = "none were drawn" if result["false_alarm_runs"] is None else (
        f"{100 * result['false_alarm_runs']:.2f} % [{100 * low:.2f}, {100 * high:.2f}] with an alarm"
    )  # fmt: skip
    return "\n".join(
        [*lines, f"healthy runs ({result['n_healthy']}): {alarms}; diverged: {result['diverged']} of {result['n']} runs"]
    )
