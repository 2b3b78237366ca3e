"""The speed suite's results as JSON, as text for the terminal and as a page."""

from __future__ import annotations

import dataclasses
import html
from typing import Any

import plotly.graph_objects as go

from benchmarks.metrics import METRICS
from benchmarks.results import Results, Table
from benchmarks.sizes import Sizes
from jaxftc.config import Config
from jaxftc.report.figures import COLOURS, finish
from jaxftc.report.page import embed, table
from jaxftc.report.page import page as whole

CURVES = {"batch": "scenarios", "horizon": "length of a run, s", "joints": "joints"}  # tables that are drawn too


def as_dict(found: Results, sizes: Sizes, config: Config) -> dict[str, Any]:
    """What ``result.json`` holds beside the machine."""
    return {
        "arm": config.robot.name,
        "quick": not sizes.everything,
        "sizes": dataclasses.asdict(sizes),
        "metrics": [
            {
                "key": m.key,
                "value": found.metrics[m.key],
                "unit": m.unit,
                "direction": m.direction,
                "tolerance": m.tolerance,
                "about": m.about,
            }
            for m in METRICS
            if m.key in found.metrics
        ],
        "tables": {
            name: {"title": table.title, "rows": [dict(zip(table.columns, row, strict=True)) for row in table.rows]}
            for name, table in found.tables.items()
        },
        "checks": [check._asdict() for check in found.checks],
    }


def as_text(found: Results) -> str:
    """Figures, then tables."""
    lines = []
    rows = [(m.key, number(found.metrics[m.key]), m.unit, m.about) for m in METRICS if m.key in found.metrics]
    for title, columns, body in [("", ("figure", "value", "unit", "what"), rows), *found.tables.values()]:
        cells = [[str(name) for name in columns], *([_cell(value) for value in row] for row in body)]
        widths = [max(len(row[k]) for row in cells) for k in range(len(columns))]
        right = [(bool(body) and isinstance(body[0][k], int | float)) or columns[k] == "value" for k in range(len(columns))]
        lines += ["", title] if title else []
        for row in cells:
            padded = (c.rjust(w) if r else c.ljust(w) for c, w, r in zip(row, widths, right, strict=True))
            lines.append("  ".join(padded).rstrip())
        lines.insert(len(lines) - len(body), "-" * (sum(widths) + 2 * len(widths) - 2))
    lines += ["", f"{len(found.checks)} checks of what was timed, all within what is allowed"]
    return "\n".join(lines)


def page(found: Results, ran: dict[str, Any]) -> str:
    """The same as a page, with curves of how the closed loop scales; what ran."""
    figures = [(m.key, m.about, m.unit, found.metrics[m.key]) for m in METRICS if m.key in found.metrics]
    sections = [_html(Table("Figures", ("figure", "what", "unit", "value"), figures))]
    for name, one in found.tables.items():
        sections.append(_html(one))
        if name in CURVES:
            sections.append(embed(_curve(one, CURVES[name])))
    checks = [(check.what, check.error, check.allowed) for check in found.checks]
    sections.append(_html(Table("Checks of what was timed", ("what", "off by", "allowed"), checks)))
    return whole("jaxftc bench speed", sections, ran=ran)


def number(value: float) -> str:
    """Three digits or so, thousands with commas."""
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def _cell(value: object) -> str:
    return number(value) if isinstance(value, float) else f"{value:,}" if isinstance(value, int) else str(value)


def _html(found: Table) -> str:
    words = 1 + max((k for row in found.rows[:1] for k, value in enumerate(row) if isinstance(value, str)), default=0)
    rows = [[_cell(value) for value in row] for row in found.rows]
    return f"<h2>{html.escape(found.title)}</h2>" + table([str(name) for name in found.columns], rows, text=words)


def _curve(found: Table, axis: str) -> go.Figure:
    figure, columns = go.Figure(), list(zip(*found.rows, strict=True))
    names = [(k, name) for k, name in enumerate(found.columns) if k and not name.startswith("compile")]
    for colour, (k, name) in zip(COLOURS, names, strict=False):
        figure.add_scatter(x=columns[0], y=columns[k], name=name, mode="lines+markers", line_color=colour)
    finish(figure, found.title).update_layout(showlegend=True)
    figure.update_xaxes(title_text=axis, type="linear" if axis == "joints" else "log")
    figure.update_yaxes(title_text="scenario-steps/s", rangemode="tozero")
    return figure
