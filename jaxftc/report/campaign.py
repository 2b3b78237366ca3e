"""The report of a campaign: confusion, delays, threshold trade-off, and the worst scenarios with their traces."""

from __future__ import annotations

import html
import math
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from jaxftc.config import Config
from jaxftc.evaluation import comparison as versus
from jaxftc.evaluation import metrics, verdicts
from jaxftc.evaluation.summary import FAULTY, Table, by_kind
from jaxftc.evaluation.verdicts import show
from jaxftc.report.figures import COLOURS, DASHES, LOGARITHMIC, finish, residual_figure
from jaxftc.report.page import embed, page, table
from jaxftc.simulation.closed_loop import Trace
from jaxftc.types import KINDS


def campaign(
    config: Config, folder: Path, rows: Table, result: dict[str, Any], worst: list[tuple[dict[str, Any], Trace]]
) -> str:
    """One scheme's page; ``result`` is its summary, with what ran."""
    sections = [
        table(versus.HEAD, versus.cells({result["scheme"]: result}), units=versus.UNITS) + f"<p>{versus.NOTE}</p>",
        _verdicts({result["scheme"]: result}),
        f"<p>{versus.calibrated(result)} n = {result['n']}; {result['diverged']} runs diverged.</p>",
        *(f"<p>{html.escape(line)}</p>" for line in versus.thresholds(result)),
        "<h2>Confusion of kinds</h2>",
        embed(confusion(result)),
        "<h2>By kind of fault</h2>",
        _kinds(result),
        "<h2>Detection delay</h2>",
        embed(delays(rows)),
        "<h2>Thresholds: false alarms against detection and delay</h2>",
        "<p>All thresholds times a scale, read off the statistics of the same runs; the sensor check and the fuzzy stage "
        "keep the thresholds that they ran with.</p>",
        embed(trade_off({result["scheme"]: result})),
    ]
    for row, trace in worst:
        title = f"Scenario {row['scenario_id']}: {row['kind']} {row['fault_tau']} {row['fault_q']}".strip()
        command = f"jaxftc simulate --from {shlex.quote(str(folder))} --id {row['scenario_id']}"
        sections += [f"<h2>{html.escape(title)}</h2><p>{_fate(row)}. Replay: <code>{html.escape(command)}</code></p>"]
        columns = metrics.columns(trace)
        sections += [embed(residual_figure(config, columns, "Residuals", _shown(row)))]
    title = f"jaxftc campaign: {result['scheme']}, {result['n']} scenarios"
    return page(title, sections, config.robot.joint_names, result["provenance"])


def comparison(found: dict[str, dict[str, Any]], pairs: list[dict[str, Any]], ran: dict[str, Any]) -> str:
    """All schemes of a comparison on one page, and what ran."""
    text = versus.pairs_as_text(pairs)
    sections = [
        table(versus.HEAD, versus.cells(found), units=versus.UNITS) + f"<p>{versus.NOTE} {versus.BEST}</p>",
        _verdicts(found),
        *(
            f"<p>{html.escape(name)}: {html.escape(line)}</p>"
            for name, result in found.items()
            for line in (versus.calibrated(result), *versus.thresholds(result))
        ),
        "<h2>Thresholds: false alarms against detection and delay</h2>",
        embed(trade_off(found)),
        f"<h2>Paired by scenario</h2><pre>{html.escape(text.strip())}</pre>",
        "<h2>Confusion of kinds</h2>",
        *(f"<h3>{html.escape(name)}</h3>" + embed(confusion(result)) for name, result in found.items()),
        "<h2>By kind of fault</h2>",
        *(f"<h3>{html.escape(name)}</h3>" + _kinds(result) for name, result in found.items()),
    ]
    return page(f"jaxftc campaign: {', '.join(found)}", sections, ran=ran)


def confusion(result: dict[str, Any]) -> go.Figure:
    """Counts and shares by true kind."""
    counts = np.asarray(result["confusion"])
    shares = counts / np.maximum(counts.sum(1, keepdims=True), 1)
    text = [[f"{c}<br>{100 * s:.1f} %" for c, s in zip(*pair, strict=True)] for pair in zip(counts, shares, strict=True)]
    for row, gone in zip(text, result["alarm_gone"], strict=True):
        row[0] += f"<br>{gone} ended" if gone else ""
    figure = go.Figure(
        go.Heatmap(
            z=shares,
            x=KINDS[: len(counts)],
            y=KINDS[: len(counts)],
            text=text,
            texttemplate="%{text}",
            colorscale="Blues",
            zmin=0,
            zmax=1,
            showscale=False,
        )
    )
    figure.update_yaxes(autorange="reversed", title_text="true kind")
    title = f"Verdict {1e3 * metrics.SETTLE:.0f} ms after the alarm"
    note = "Counts, and shares of the row. Normal: no alarm, or one that had ended by then, which is counted too."
    figure = finish(figure, title, note)
    return figure.update_xaxes(title_text="verdict")


def delays(rows: Table) -> go.Figure:
    """Share of the faults detected within a time, by kind."""
    figure = go.Figure()
    last = 1e3 * max((x for x in rows["delay_s"] if math.isfinite(x)), default=0.0)
    for k, (name, part) in enumerate(by_kind(rows).items()):
        delay = np.sort(part["delay_s"])
        found = delay[np.isfinite(delay)] * 1e3
        step = max(1, len(found) // 400)  # no eye sees more
        shown = np.unique(np.r_[np.arange(0, len(found), step), len(found) - 1]) if len(found) else np.arange(0)
        points = np.r_[found[shown], last]  # all curves end at the same time, those that are at 100 % at once included
        level = np.r_[shown + 1, len(found)] / max(len(delay), 1)
        dash = DASHES[k // len(COLOURS) % len(DASHES)]
        figure.add_scatter(
            x=np.maximum(points, 0.5), y=100 * level, name=f"{name} ({len(delay)})", mode="lines",
            line={"shape": "hv", "color": COLOURS[k % len(COLOURS)], "dash": dash},
        )  # fmt: skip
    figure.update_yaxes(title_text="% of faults detected", range=[0, 102])
    figure = finish(
        figure, "Detected within", "Delays below a tick are drawn at 0.5 ms; a curve that ends below 100 % has misses."
    )
    return figure.update_xaxes(LOGARITHMIC, title_text="delay, ms")


def trade_off(found: dict[str, dict[str, Any]]) -> go.Figure:
    """Detection and delay of each kind against the share of healthy runs with an alarm, over the threshold scale.

    A curve ends at the lowest thresholds that find the most. Below them it would bend back: an alarm that is up before the
    fault has not found it.
    """
    curves = [result["roc"]["detection"] for result in found.values()]
    kinds = [kind for kind in FAULTY if any(x is not None for curve in curves for x in curve[kind])] or list(FAULTY[:1])
    titles = [title for kind in kinds for title in (f"{kind} faults", "")]
    figure = make_subplots(
        len(kinds), 2, shared_xaxes=True, vertical_spacing=0.28 / len(kinds), horizontal_spacing=0.28, subplot_titles=titles
    )
    for k, (scheme, result) in enumerate(found.items()):
        curve = result["roc"]
        least = 50 / max(result["n_healthy"], 1)  # none of them: half a run
        alarms = [None if x is None else max(100 * x, least) for x in curve["false_alarm_runs"]]
        for row, kind in enumerate(kinds, start=1):
            detection = curve["detection"][kind]
            share = [None if x is None else 100 * x for x in detection]
            late = [None if x is None else 1e3 * x for x in curve["delay_median_s"][kind]]
            first = max(range(len(detection)), key=lambda at: detection[at] or 0.0)
            scale = curve["scale"][first:]
            look: dict[str, Any] = {
                "x": alarms[first:], "legendgroup": scheme, "mode": "lines+markers",
                "line_color": COLOURS[k % len(COLOURS)], "marker": _ringed(scale), "customdata": scale,
                "hovertemplate": "scale %{customdata}: %{x:.2f} %, %{y}",
            }  # fmt: skip
            figure.add_scatter(y=share[first:], name=scheme, showlegend=row == 1, **look, row=row, col=1)
            figure.add_scatter(y=late[first:], showlegend=False, **look, row=row, col=2)
    figure.update_yaxes(title_text="% detected", col=1).update_yaxes(title_text="delay, ms", rangemode="tozero", col=2)
    note = (
        "Across: the share of healthy runs with an alarm; delays are medians. Ringed: scale 1, what ran. No alarm "
        "at all is drawn as half a run. A curve ends where lower thresholds detect no more: alarms precede the fault."
    )
    figure = finish(figure, "Each point is a scale of all thresholds", note, panels=len(kinds))
    figure.update_xaxes(title_text="").update_xaxes(title_text="% false alarms", row=len(kinds))
    decades = [10.0**e for e in range(-4, 3)]  # few enough for a phone
    return figure.update_xaxes(LOGARITHMIC | {"tickvals": decades}).update_layout(legend_y=1.06)


def _ringed(scales: list[float]) -> dict[str, Any]:
    """Markers of a curve over threshold scales: the scale 1 as a large ring."""
    own = np.isclose(scales, 1.0)
    return {
        "symbol": np.where(own, "circle-open", "circle"),
        "size": np.where(own, 13, 6),
        "line": {"width": np.where(own, 2, 0)},
    }


def _verdicts(found: dict[str, dict[str, Any]]) -> str:
    more = [f"<p>{name}: {line}</p>" for name, result in found.items() for line in verdicts.guesses(result)]
    return table(verdicts.HEAD, verdicts.cells(found), units=verdicts.UNITS) + f"<p>{verdicts.NOTE}</p>" + "".join(more)


def _kinds(result: dict[str, Any]) -> str:
    """Two tables by kind of fault: verdicts beside the oracle's, then times and errors."""
    kinds = result["by_kind"].items()
    head = ("fault", "n", "detected", "kind right", "joint right", "kind settled", "joint settled")
    units = ("", "", *("% (oracle)",) * 5)
    rows = [
        (name, str(part["n_faults"]), *(f"{show(part[k], 100, 1)} ({show(part[f'{k}_ceiling'], 100, 1)})" for k in SHARES))
        for name, part in kinds
    ]
    note = "Detected is a share of all faults, the others are shares of the detected ones. Times and errors are medians."
    verdict = table(head, rows, units=units) + f"<p class='note'>{note}</p>"
    head = ("fault", "delay", "95 % interval", "all named", "isolated", "torque est.", "angle est.", "tracking")
    units = ("", *("ms",) * 4, "rms N m", "rms deg", "rms deg")
    rows = [(name, *_times(part), *(show(part[k], 1, 3) for k in ERRORS)) for name, part in kinds]
    return verdict + table(head, rows, units=units)


def _times(part: dict[str, Any]) -> tuple[str, ...]:
    bounds = " to ".join(show(x, 1e3, 0, "missed") for x in part["delay_median_s_95"])
    delay, named, isolated = (
        show(part[f"{k}_median_s"], 1e3, 0, absent)
        for k, absent in (("delay", "missed"), ("complete", "never"), ("isolated", "never"))
    )
    return delay, bounds, named, isolated


ERRORS = ("fault_tau_rmse_nm", "fault_q_rmse_deg", "tracking_rmse_deg")
SHARES = ("detection", "isolation_kind", "isolation_joint", "isolation_kind_settled", "isolation_joint_settled")


def _shown(row: dict[str, Any]) -> int:
    """The joint that a trace shows first."""
    return max(row["joint_tau"] or row["joint_q"] or row["joint_hat"], 1) - 1


def _fate(row: dict[str, Any]) -> str:
    """What became of a scenario, in words."""
    if row["diverged"]:
        return "The run diverged"
    if math.isnan(row["delay_s"]):
        said = (
            "no alarm" if not row["false_alarm"] else f"false alarm at {row['false_alarm_s']:.3f} s, said {row['kind_hat']}"
        )
        return f"No fault; {said}"
    where = ", ".join(f"{c} of joint {row[j]}" for c, j in (("actuator", "joint_tau"), ("encoder", "joint_q")) if row[j])
    size = "" if math.isnan(row["magnitude"]) else f", {row['magnitude']:.3g}" + f" {row['unit']}" * (row["unit"] != "1")
    what = f"Fault of the {where}" if where else f"Contact at link {row['link']}"
    text = f"{what}{size}, from {row['onset_s']:.3f} s: "
    false = f"; false alarm at {row['false_alarm_s']:.3f} s" if row["false_alarm"] else ""
    if math.isinf(row["delay_s"]):
        return f"{text}missed{false}"
    blamed = f"joint {row['joint_hat']} first" if row["joint_hat"] else "no joint"
    guess = ", a guess" if row["unsure"] else ""
    after, later = (f"{1e3 * seconds:.0f} ms" for seconds in (row["delay_s"], metrics.SETTLE))
    return f"{text}alarm after {after}, {later} later said {row['kind_hat']}{guess}, {blamed}{false}"
