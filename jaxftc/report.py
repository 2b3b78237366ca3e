"""Pages that people look at: self-contained HTML with plotly's figures, opening offline."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING, Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from jaxftc.config import CONTROLS, OBSERVERS, Config
from jaxftc.faults.scenario import CONDITIONS

if TYPE_CHECKING:
    from jaxftc.paper import Experiment, Row

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")  # told apart by colour-blind readers
_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#222;background:#fff}
table{border-collapse:collapse;font-size:.9rem;font-variant-numeric:tabular-nums;display:block;overflow-x:auto}
td,th{padding:.15rem .5rem;border-bottom:1px solid #ddd;text-align:right;white-space:nowrap}
td:nth-child(-n+3),th:nth-child(-n+3){text-align:left} .claims td{white-space:normal;text-align:left}
.no{color:#a33;font-weight:600} .yes{color:#276}
"""


def demo_page(config: Config, experiment: Experiment) -> str:
    """The paper's experiment: claims, comparison table, residuals by condition, estimates by observer, controllers."""
    sections = [
        "<h2>Claims</h2>" + _claims(experiment),
        "<h2>Comparison</h2>" + _table(experiment),
        "<h2>Residuals and thresholds (T-S observer, AFESMC)</h2>",
        *(
            embed(residual_figure(config, experiment.traces[OBSERVERS[-1], CONTROLS[-1]][c], condition))
            for c, condition in enumerate(CONDITIONS)
        ),
        "<h2>Fault estimates of joint 1, both faults</h2>",
        embed(_observers(config, experiment)),
        "<h2>Tracking error of joint 1, both faults (T-S observer)</h2>",
        embed(_controllers(experiment)),
    ]
    return page("jaxftc demo: the paper's experiment", sections)


def trace_page(config: Config, trace: dict[str, np.ndarray], title: str) -> str:
    """One run: motion, torque, residuals with thresholds."""
    return page(title, [embed(motion_figure(config, trace)), embed(residual_figure(config, trace, title))])


def residual_figure(config: Config, trace: dict[str, np.ndarray], title: str, shown: int = 0) -> go.Figure:
    """Both residual channels of every joint, thresholds dashed, fault windows shaded; one joint shows first."""
    figure = make_subplots(2, 1, shared_xaxes=True, vertical_spacing=0.08)
    t = trace["t"]
    for j, joint in enumerate(config.robot.joint_names):
        look: dict[str, Any] = {
            "legendgroup": joint,
            "visible": True if j == shown else "legendonly",
            "line_color": COLOURS[j % 7],
        }
        figure.add_scatter(x=t, y=trace["residual_tau"][:, j], name=joint, **look, row=1, col=1)
        figure.add_scatter(x=t, y=np.rad2deg(trace["fault_q_hat"][:, j]), name=joint, showlegend=False, **look, row=2, col=1)
    for row, (name, degrees) in enumerate((("threshold_tau", False), ("threshold_q", True)), start=1):
        level = float(np.rad2deg(trace[name][0, shown]) if degrees else trace[name][0, shown])
        if not np.isfinite(level):
            continue  # a scheme without that channel
        for sign in (1, -1):
            figure.add_hline(y=sign * level, line={"dash": "dash", "color": "#777"}, row=row, col=1)  # pyright: ignore[reportArgumentType]
    shade(figure, trace)
    figure.update_yaxes(title_text="torque residual, N m", row=1, col=1)
    figure.update_yaxes(title_text="encoder fault b, deg", row=2, col=1)
    return finish(
        figure,
        title,
        f"dashed: threshold of {config.robot.joint_names[shown]}; shaded: fault present; click a joint to show it",
    )


def motion_figure(config: Config, trace: dict[str, np.ndarray]) -> go.Figure:
    """Angles, their distance from the reference, and torques."""
    figure = make_subplots(3, 1, shared_xaxes=True, vertical_spacing=0.06)
    t = trace["t"]
    for j, joint in enumerate(config.robot.joint_names):
        look: dict[str, Any] = {"legendgroup": joint, "line_color": COLOURS[j % 7]}
        figure.add_scatter(x=t, y=np.rad2deg(trace["q"][:, j]), name=joint, **look, row=1, col=1)
        error = np.rad2deg(trace["q"][:, j] - trace["q_ref"][:, j])
        figure.add_scatter(x=t, y=error, showlegend=False, **look, row=2, col=1)
        figure.add_scatter(x=t, y=trace["tau"][:, j], showlegend=False, **look, row=3, col=1)
    shade(figure, trace)
    for row, title in enumerate(("angle, deg", "tracking error, deg", "torque command, N m"), start=1):
        figure.update_yaxes(title_text=title, row=row, col=1)
    return finish(figure, "Motion, tracking and torque", "").update_layout(height=700)


def _observers(config: Config, experiment: Experiment) -> go.Figure:
    figure = make_subplots(2, 1, shared_xaxes=True, vertical_spacing=0.08)
    for k, observer in enumerate(OBSERVERS):
        trace = experiment.traces[observer, CONTROLS[-1]][-1]
        look: dict[str, Any] = {"legendgroup": observer, "line_color": COLOURS[k]}
        figure.add_scatter(x=trace["t"], y=trace["fault_tau_hat"][:, 0], name=observer.upper(), **look, row=1, col=1)
        angle = np.rad2deg(trace["fault_q_hat"][:, 0])
        figure.add_scatter(x=trace["t"], y=angle, showlegend=False, **look, row=2, col=1)
    truth = experiment.traces[OBSERVERS[-1], CONTROLS[-1]][-1]
    black: dict[str, Any] = {"name": "truth", "legendgroup": "truth", "line": {"color": "#000", "dash": "dot"}}
    figure.add_scatter(x=truth["t"], y=truth["fault_tau"][:, 0], **black, row=1, col=1)
    figure.add_scatter(x=truth["t"], y=np.rad2deg(truth["fault_q"][:, 0]), showlegend=False, **black, row=2, col=1)
    figure.update_yaxes(title_text="actuator fault, N m", row=1, col=1)
    figure.update_yaxes(title_text="encoder fault, deg", row=2, col=1)
    return finish(figure, f"{config.robot.joint_names[0]}: estimates against the truth", "")


def _controllers(experiment: Experiment) -> go.Figure:
    figure = make_subplots(1, 1)
    for k, control in enumerate(CONTROLS):
        trace = experiment.traces[OBSERVERS[-1], control][-1]
        error = np.rad2deg(trace["q"][:, 0] - trace["q_ref"][:, 0])
        figure.add_scatter(x=trace["t"], y=error, name=control.upper(), line_color=COLOURS[k])
    shade(figure, experiment.traces[OBSERVERS[-1], CONTROLS[-1]][-1])
    figure.update_yaxes(title_text="tracking error, deg")
    return finish(figure, "Gains as given, not at equal chattering", "")


def shade(figure: go.Figure, trace: dict[str, np.ndarray]) -> None:
    """Shade from the first to the last tick at which a fault is there."""
    there = (np.abs(trace["fault_tau"]) > 0).any(1) | (np.abs(trace["fault_q"]) > 0).any(1)
    if there.any():
        window = trace["t"][there]
        figure.add_vrect(x0=float(window[0]), x1=float(window[-1]), fillcolor="#999", opacity=0.15, line_width=0)


def finish(figure: go.Figure, title: str, note: str) -> go.Figure:
    """Title, look and the time axis, the same for every figure."""
    text = html.escape(title) + (f"<br><sup>{html.escape(note)}</sup>" if note else "")
    figure.update_layout(title_text=text, template="plotly_white", height=520, margin={"l": 70, "r": 20, "t": 70, "b": 50})
    figure.layout[list(figure.select_xaxes())[-1].plotly_name].title = "time, s"
    return figure


def _claims(experiment: Experiment) -> str:
    rows = "".join(
        f"<tr><td class='{'yes' if c.met else 'no'}'>{'met' if c.met else 'not met'}</td><td>{html.escape(c.claim)}</td>"
        f"<td>{c.value:.4g} {html.escape(c.unit)}</td><td>{html.escape(c.detail)}</td></tr>"
        for c in experiment.claims
    )
    return f"<table class='claims'><tr><th></th><th>claim</th><th>our figure</th><th>detail</th></tr>{rows}</table>"


def comparison(rows: list[Row]) -> tuple[tuple[str, ...], tuple[str, ...], list[tuple[str, ...]]]:
    """Head, units and cells of the comparison table, for page and terminal alike."""
    head = ("condition", "observer", "controller", "torque est.", "angle est.", "delay", "told apart", "false alarm")
    head += ("tracking", "chattering")
    units = ("", "", "", "rms N m", "rms deg", "ms", "", "at s", "rms deg", "1/s")
    cells = [
        (
            *(r.condition, r.observer, r.controller, f"{r.fault_tau_rms_nm:.3f}", f"{r.fault_q_rms_deg:.4f}"),
            "-" if r.delay_s is None else "missed" if np.isinf(r.delay_s) else f"{r.delay_s * 1e3:.0f}",
            *("yes" if r.isolated else "no", "-" if r.false_alarm_s is None else f"{r.false_alarm_s:.3f}"),
            *(f"{r.tracking_rms_deg:.3f}", f"{r.chattering:.2f}"),
        )
        for r in rows
    ]
    return head, units, cells


def _table(experiment: Experiment) -> str:
    head, units, rows = comparison(experiment.rows)
    titles = "".join(f"<th>{title}<br>{unit}</th>" for title, unit in zip(head, units, strict=True))
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{titles}</tr>{body}</table>"


def embed(figure: go.Figure) -> str:
    """A figure as HTML for ``page``."""
    return figure.to_html(full_html=False, include_plotlyjs=False, config={"responsive": True, "displaylogo": False})


def page(title: str, sections: list[str]) -> str:
    """A self-contained page of sections in HTML, which opens offline."""
    from plotly.offline import get_plotlyjs

    body = "\n".join(sections)
    return (
        f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>{html.escape(title)}</title>"
        f"<meta name='viewport' content='width=device-width'><style>{_STYLE}</style><script>{get_plotlyjs()}</script></head>"
        f"<body><h1>{html.escape(title)}</h1>{body}</body></html>\n"
    )
