"""Figures of a run and of Table 1, and what all have in common: colours, shaded faults, thresholds, the joint they show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from jaxftc.config import Config
from jaxftc.control.fuzzy_gain import surface
from jaxftc.gains import Gains
from jaxftc.report.page import embed, page
from jaxftc.types import KINDS, LABELS, Verdict

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")  # told apart by colour-blind readers
DASHES = ("solid", "dash", "dot", "dashdot")
TRUTH: dict[str, Any] = {"color": "#000", "dash": "dot", "width": 2}
LIMIT: dict[str, Any] = {"color": "#777", "dash": "dash", "width": 1.5}
LOGARITHMIC: dict[str, Any] = {"type": "log", "tickvals": [m * 10.0**e for e in range(-4, 7) for m in (1, 2, 5)]}
MOST = 2000  # points of a curve; no screen shows more
PANEL = 210  # px, height of one of several panels


class Panel(NamedTuple):
    """One panel of a figure: its axis and its curves, each a signal [T, n] of all joints."""

    axis: str  # quantity and unit
    curves: dict[str, tuple[np.ndarray, dict[str, Any]]]  # name -> signal [T, n], line
    threshold: np.ndarray | None = None  # [n], or [T, n] where it moves; drawn at both signs


def by_joint(t: np.ndarray, panels: list[Panel], joints: tuple[str, ...]) -> go.Figure:
    """Panels above each other, of one joint at a time: colours tell the curves apart, the reader chooses the joint."""
    figure = make_subplots(len(panels), 1, shared_xaxes=True, vertical_spacing=0.05)
    named: set[str] = set()
    for row, panel in enumerate(panels, start=1):
        for j in range(len(joints)):
            _threshold(figure, t, panel, j, row)
            for name, (signal, line) in panel.curves.items():
                first = name not in named
                figure.add_trace(curve(t, signal[:, j], name, line, joint=j, showlegend=first), row=row, col=1)
        named |= panel.curves.keys()
        figure.update_yaxes(title_text=panel.axis, row=row, col=1)
    return figure


def together(t: np.ndarray, panels: list[Panel], joints: tuple[str, ...]) -> go.Figure:
    """Panels above each other, a colour a joint; each panel has one curve."""
    figure = make_subplots(len(panels), 1, shared_xaxes=True, vertical_spacing=0.05)
    for row, panel in enumerate(panels, start=1):
        ((signal, line),) = panel.curves.values()
        for j, joint in enumerate(joints):
            _threshold(figure, t, panel, j, row)
            look = line | {"color": COLOURS[j % len(COLOURS)], "dash": DASHES[j // len(COLOURS) % len(DASHES)]}
            figure.add_trace(curve(t, signal[:, j], joint, look, joint=j, showlegend=row == 1), row=row, col=1)
        figure.update_yaxes(title_text=panel.axis, row=row, col=1)
    return figure


def curve(t: np.ndarray, y: np.ndarray, name: str, line: dict[str, Any], *, joint: int, **more: Any) -> go.Scatter:
    """A signal over time, thinned to what a screen shows, of one joint."""
    values, step = thin(np.asarray(y, np.float32))
    spacing = float(t[-1] - t[0]) / max(len(t) - 1, 1)
    even = bool(np.allclose(np.diff(t), spacing, rtol=0.1, atol=0.0))  # then two numbers say it all
    times = {"x0": float(t[0]), "dx": spacing * step} if even else {"x": _at(t, step * np.arange(len(values)))}
    return go.Scatter(
        y=values,
        name=name,
        legendgroup=name,
        mode="lines",
        line={"width": 1.5} | line,
        meta={"joint": joint},
        **times,
        **more,
    )


def _at(t: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Times at places among the samples, whole ones or between."""
    return np.interp(place, np.arange(len(t)), t)


def thin(y: np.ndarray) -> tuple[np.ndarray, float]:
    """At most MOST points of a signal [T], least and largest of each stretch in order, and the samples that one is."""
    if len(y) <= MOST:
        return y, 1.0
    stretch = -(-len(y) // (MOST // 2))
    rows = np.pad(y, (0, -len(y) % stretch), mode="edge").reshape(-1, stretch)
    ends = np.sort([rows.argmin(1), rows.argmax(1)], axis=0)
    return np.take_along_axis(rows, ends.T, axis=1).ravel(), stretch / 2


def _threshold(figure: go.Figure, t: np.ndarray, panel: Panel, joint: int, row: int) -> None:
    """Both signs of a joint's threshold; a scheme without that channel has none that is finite."""
    if panel.threshold is None or not np.isfinite(panel.threshold[..., joint]).all():
        return
    level = np.atleast_1d(panel.threshold[..., joint])
    level = thin(level)[0] if np.ptp(level) else np.repeat(level[:1], 2)
    for sign in (1, -1):
        figure.add_scatter(
            x=_at(t, np.linspace(0, len(t) - 1, len(level))), y=sign * level, name="threshold", mode="lines", line=LIMIT,
            showlegend=False, meta={"joint": joint}, row=row, col=1,
        )  # fmt: skip


def shade(figure: go.Figure, trace: dict[str, np.ndarray]) -> go.Figure:
    """Shade the times at which a fault is there."""
    for start, end in windows(trace):
        figure.add_vrect(x0=start, x1=end, fillcolor="#999", opacity=0.18, line_width=0, layer="below")
    return figure


def windows(trace: dict[str, np.ndarray]) -> Iterator[tuple[float, float]]:
    """Start and end, s, of each time at which a fault is there."""
    there = np.any([(np.abs(trace[name]) > 0).any(1) for name in ("fault_tau", "fault_q", "contact_tau")], axis=0)
    edges = np.flatnonzero(np.diff(np.r_[False, there, False].astype(int)))
    for start, end in edges.reshape(-1, 2):
        yield float(trace["t"][start]), float(trace["t"][end - 1])


def finish(figure: go.Figure, title: str, note: str = "", *, panels: int = 1, **meta: Any) -> go.Figure:
    """Look, size and time axis, the same for every figure; title and note go into ``meta``, for ``page.embed``."""
    figure.update_layout(
        template="plotly_white",
        font={"family": "system-ui, sans-serif", "size": 13, "color": "#222"},
        height=max(380, PANEL * panels + 90),
        margin={"l": 64, "r": 12, "t": 16, "b": 48},
        legend={"orientation": "h", "x": 0, "y": 1.01, "yanchor": "bottom"},
        meta={"title": title, "note": note} | meta,
    )
    figure.update_yaxes(automargin=True, title_standoff=8, exponentformat="e")
    figure.layout[list(figure.select_xaxes())[-1].plotly_name].title = "time, s"
    return figure


def residual_figure(config: Config, trace: dict[str, np.ndarray], title: str, shown: int | None = None) -> go.Figure:
    """S of both channels, Eq. (14), with thresholds, and verdicts; faults shaded; all joints, or ``shown`` at first."""
    torque = Panel("S, torque residual, N m", {"": (trace["statistic_tau"], {})}, trace["threshold_tau"])
    angle = Panel(
        "S, encoder residual, deg", {"": (np.rad2deg(trace["statistic_q"]), {})}, np.rad2deg(trace["threshold_q"][0])
    )
    apart = 0.08 * (np.arange(config.n) - (config.n - 1) / 2)  # joints that say the same are drawn beside each other
    contact = trace["verdict"] & Verdict.CONTACT > 0
    level = np.where(contact, KINDS.index("contact"), trace["verdict"])
    verdict = Panel("verdict", {"": (level + apart, {"shape": "hv"})})
    words = KINDS if contact.any() else LABELS
    figure = shade(together(trace["t"], [torque, angle, verdict], config.robot.joint_names), trace)
    figure.update_yaxes(tickvals=[*range(len(words))], ticktext=words, range=[-0.4, len(words) - 0.6], row=3, col=1)
    meta = {"together": True} if shown is None else {"first": shown}
    return finish(
        figure,
        title,
        "S is the residual as the alarm weighs it. Dashed: thresholds; shaded: a fault on any joint.",
        panels=3,
        **meta,
    )


def motion_figure(config: Config, trace: dict[str, np.ndarray]) -> go.Figure:
    """Angles, their distance from the reference, and torques."""
    error = np.rad2deg(trace["q"] - trace["q_ref"])
    signals = {
        "angle, deg": np.rad2deg(trace["q"]),
        "tracking error, deg": error,
        "torque command, N m": trace["tau"],
    }
    panels = [Panel(axis, {"": (signal, {})}) for axis, signal in signals.items()]
    figure = shade(together(trace["t"], panels, config.robot.joint_names), trace)
    return finish(figure, "Motion, tracking and torque", panels=3, together=True)


def surface_figure(config: Config, gains: dict[str, Gains], title: str) -> go.Figure:
    """alpha_online over joint position and sliding surface, the 7 x 7 rules with their sets, a map for each set of gains."""
    q, s = np.meshgrid(np.deg2rad(np.linspace(-110, 110, 56)), np.linspace(-1.2, 1.2, 49))
    figure = make_subplots(1, len(gains), shared_yaxes=True, subplot_titles=[*gains], horizontal_spacing=0.06)
    for column, one in enumerate(gains.values(), start=1):
        figure.add_heatmap(
            x=np.rad2deg(q[0]), y=s[:, 0], z=surface(config, one, q, s).astype(np.float32), zmin=0, zmax=3,
            colorscale="Cividis", showscale=column == len(gains), colorbar={"title": "factor"}, row=1, col=column,
        )  # fmt: skip
        cq, cs = np.meshgrid(np.rad2deg(np.asarray(one.control.q_centres, float)), np.asarray(one.control.s_centres, float))
        figure.add_scatter(
            x=cq.ravel(), y=cs.ravel(), mode="markers", marker={"color": "#fff", "size": 5, "symbol": "cross"},
            showlegend=False, hoverinfo="skip", row=1, col=column,
        )  # fmt: skip
    figure.update_yaxes(title_text="s, rad/s", row=1, col=1)
    finish(
        figure,
        title,
        "alpha_online over joint position q and sliding surface s, with joint 1's floor; crosses: centres of the sets.",
    )
    return figure.update_xaxes(title_text="q, deg").update_layout(margin_t=40 if len(gains) > 1 else 16)


def trace_page(
    config: Config, trace: dict[str, np.ndarray], title: str, ran: Mapping[str, Any] = MappingProxyType({})
) -> str:
    """One run: motion, torque, residuals with thresholds; and what ran."""
    shown = [motion_figure(config, trace), residual_figure(config, trace, "Residuals and thresholds")]
    return page(title, [embed(figure) for figure in shown], config.robot.joint_names, ran)
