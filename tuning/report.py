"""The page that a tuning run leaves: what it is worth, how it got there, what it did to the gains, and the worst runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from jaxftc.config import Config
from jaxftc.evaluation import metrics
from jaxftc.evaluation.intervals import Interval
from jaxftc.gains import Gains, specs
from jaxftc.report.figures import COLOURS, LIMIT, LOGARITHMIC, TRUTH, Panel, by_joint, finish, shade, surface_figure
from jaxftc.report.page import embed, page, table
from jaxftc.scenarios.faults import Actuator, Sensor
from jaxftc.scenarios.scenario import Scenario, take
from jaxftc.simulation.closed_loop import simulate
from tuning.held_out import Comparison
from tuning.loop import Result
from tuning.transform import idle

WORST = 3  # scenarios shown
SURFACE = "Factor on the switching gain, before and after"
BEFORE, AFTER = COLOURS[1], COLOURS[0]
SYMBOLS = ("circle", "square", "diamond", "triangle-up")
MANY = 8  # values of a gain that are not all printed
LEAST, MOST = 0.01, 100.0  # smallest and largest ratio drawn


def page_of(config: Config, start: Gains, result: Result, comparisons: list[Comparison], ran: Mapping[str, Any]) -> str:
    """The whole page, and what ran; the worst scenarios are simulated again for it."""
    sections = [
        "<h2>Held out</h2>",
        embed(held_out_figure(comparisons)),
        *(_table(c) for c in comparisons),
        *(["<h2>Loss</h2>", embed(loss_figure(result))] if len(result.history["loss"]) > 1 else []),
        "<h2>Gains, before and after</h2>",
        embed(gains_figure(config, start, result.gains)) if moved(start, result.gains) else "<p>No gain moved.</p>",
    ]
    if config.control == "afesmc":
        sections += [
            "<h2>Table 1 as a surface, before and after</h2>",
            embed(surface_figure(config, {"before": start, "after": result.gains}, SURFACE)),
        ]
    sections += ["<h2>The worst scenarios after tuning</h2>", *worst_figures(config, start, result.gains, comparisons[0])]
    return page("jaxftc tune", sections, config.robot.joint_names, ran)


def held_out_figure(comparisons: list[Comparison]) -> go.Figure:
    """Every term after tuning over before, with its interval, for each preset and sgn."""
    figure = go.Figure()
    for k, c in enumerate(comparisons):
        rows = _ratios(c)[::-1]
        mean, low, high = np.clip([ratio[:3] for *_, ratio in rows], LEAST, MOST).T
        figure.add_scatter(
            x=mean, y=[name for name, *_ in rows], name=_name(c), mode="markers",
            orientation="h", offsetgroup=str(k),
            marker={"color": COLOURS[k % len(COLOURS)], "symbol": SYMBOLS[k % len(SYMBOLS)], "size": 9},
            error_x={"array": high - mean, "arrayminus": mean - low, "thickness": 1.5, "width": 3},
        )  # fmt: skip
    figure.add_vline(x=1.0, line=LIMIT)  # pyright: ignore[reportArgumentType]
    note = f"Left of the dashed line is better. Bars: 95 % intervals over scenarios, cut at {LEAST:g} and {MOST:g}."
    finish(figure, "What tuning changed on scenarios it never saw", note, panels=3)
    figure.update_layout(scattermode="group", scattergap=0.4)
    return figure.update_xaxes(LOGARITHMIC, title_text="mean after tuning / mean before")


def _ratios(c: Comparison) -> list[tuple[str, float, float, Interval]]:
    """Name, before, after and ratio of the objective and of every term that is not 0 throughout."""
    rows = [
        (name, float(b), float(a), c.term_ratio(name))
        for name, b, a in zip(c.names, c.before.mean(1), c.after.mean(1), strict=True)
        if b or a
    ]
    return [("objective", *c.objective, c.ratio), *rows]


def _name(c: Comparison) -> str:
    return f"{c.preset}, {c.sign} sgn"


def _table(c: Comparison) -> str:
    look = {"worse": "no", "better": "yes", "same": ""}
    cells = [
        (name, f"{b:.4f}", f"{a:.4f}", (f"{r.value:.3f} [{r.low:.3f}, {r.high:.3f}]", look[c.word(name)]))
        for name, b, a, r in _ratios(c)
    ]
    lost = f"<p class='no'>diverged: {c.diverged[0]} to {c.diverged[1]} runs</p>" if any(c.diverged) else ""
    head = ("mean of term", "before", "after", "ratio, 95 % interval")
    return f"<h3>{_name(c)}, {c.before.shape[1]} scenarios</h3>{lost}" + table(head, cells)


def loss_figure(result: Result) -> go.Figure:
    """Loss on batches and on the validation set, and every term, against closed-loop simulations."""
    figure = make_subplots(2, 1, shared_xaxes=True, vertical_spacing=0.08)
    h = result.history
    x = h["simulations"]
    figure.add_scatter(x=x, y=h["loss"], name="objective, last batch", line_color=COLOURS[5], row=1, col=1)
    figure.add_scatter(x=x, y=h["validation"], name="validation loss", line_color=COLOURS[0], row=1, col=1)
    figure.add_scatter(x=x, y=h["best"], name="best so far", line={"color": "#000", "dash": "dot"}, row=1, col=1)
    terms = [name for name in h if name.startswith("term_")]
    for k, name in enumerate(terms):
        dash = "solid" if k < len(COLOURS) else "dash"
        line = {"color": COLOURS[k % len(COLOURS)], "dash": dash}
        figure.add_scatter(x=x, y=h[name], name=name[5:], line=line, row=2, col=1)
    figure.update_yaxes(title_text="loss", row=1, col=1)
    figure.update_yaxes(title_text="mean of term, last batch", row=2, col=1)
    note = (
        "Batches differ, so their curves are noisy; the validation set is always the same. A gradient counts as several "
        "simulations."
    )
    finish(figure, "Loss and its terms", note, panels=3)
    figure.layout["xaxis2"].title = "closed-loop simulations"
    return figure


def moved(before: Gains, after: Gains) -> list[str]:
    """A line of text for each gain that moved: name, old and new values, unit."""
    lines = []
    for block, name, spec in specs(before):
        old, new = (np.asarray(getattr(getattr(gains, block), name), float).ravel() for gains in (before, after))
        if not np.array_equal(old, new):
            lines.append(f"  {f'{block}.{name}':24} {_values(old)} -> {_values(new)}  {spec.unit}")
    return lines


def _values(values: np.ndarray) -> str:
    """Values in a line: one if all are alike, least and largest if they are many."""
    if (values == values[0]).all():
        return f"{values[0]:.4g}"
    if len(values) > MANY:
        return f"{values.min():.4g} to {values.max():.4g}"
    return "[" + " ".join(f"{value:.4g}" for value in values) + "]"


def gains_figure(config: Config, before: Gains, after: Gains) -> go.Figure:
    """Each gain over its starting value, joint by joint, on a logarithmic axis; hover for the values and the unit."""
    names, factors, texts, colours = [], [], [], []
    for block, name, spec in specs(before):
        path = f"{block}.{name}"
        b, a = (np.asarray(getattr(getattr(g, block), name), float) for g in (before, after))
        if path in idle(config) or np.array_equal(a, b):
            continue
        for k, (old, new) in enumerate(zip(b.ravel(), a.ravel(), strict=True)):
            if old * new <= 0:
                continue
            names.append(path)
            factors.append(new / old)
            texts.append(f"{path}[{k}]: {old:.4g} to {new:.4g} {spec.unit}")
            colours.append(COLOURS[k % len(COLOURS)])
    figure = go.Figure(
        go.Scatter(x=factors, y=names, mode="markers", text=texts, hoverinfo="text", marker={"color": colours, "size": 9})
    )
    figure.add_vline(x=1.0, line={"color": "#777", "dash": "dash"})
    figure.update_yaxes(autorange="reversed")
    finish(
        figure,
        "Gain after over before",
        "A dot is one joint or set; hover for values. Gains that were 0 or changed sign are in gains.toml only.",
    )
    figure.update_xaxes(type="log", title_text="after / before")
    return figure.update_layout(height=220 + 22 * len(set(names)), showlegend=False)


def worst_figures(config: Config, before: Gains, after: Gains, c: Comparison) -> list[str]:
    """Tracking error and residual statistics of the scenarios with the largest objective after tuning."""
    own = c.weights @ c.after
    rows = np.argsort(own)[::-1][:WORST]
    chosen = take(c.scenarios, rows)
    traces = [simulate(config, gains, chosen, c.key) for gains in (before, after)]
    found = []
    for k, row in enumerate(rows):
        columns = [metrics.columns(trace, k) for trace in traces]
        was, now = (c.weights @ c.before)[row], own[row]
        title = f"{c.preset} scenario {row}: {_describe(config, take(c.scenarios, row))}; objective {was:.2f} to {now:.2f}"
        found.append(embed(_trace_figure(config, columns, take(c.scenarios, row), title)))
    return found


def _trace_figure(config: Config, columns: list[dict[str, np.ndarray]], scenario: Scenario, title: str) -> go.Figure:
    """Before and after: tracking error, torque statistic over its threshold, and both faults with their estimates."""
    runs = dict(zip(("before", "after"), columns, strict=True))
    look = {"before": {"color": BEFORE, "dash": "dash"}, "after": {"color": AFTER}}

    def of(signal: Callable[[dict[str, np.ndarray]], np.ndarray]) -> dict[str, Any]:
        return {name: (signal(trace), look[name]) for name, trace in runs.items()}

    last = columns[-1]
    panels = [
        Panel("tracking error, deg", of(lambda trace: np.rad2deg(trace["q"] - trace["q_ref"]))),
        Panel("S / threshold", of(lambda trace: trace["statistic_tau"] / trace["threshold_tau"]), np.ones(config.n)),
        Panel("actuator fault, N m", {"true": (last["fault_tau"], TRUTH)} | of(lambda trace: trace["fault_tau_hat"])),
        Panel(
            "encoder fault, deg",
            {"true": (np.rad2deg(last["fault_q"]), TRUTH)} | of(lambda trace: np.rad2deg(trace["fault_q_hat"])),
        ),
    ]
    first = int(np.argmax((scenario.fault_tau.kind > 0) | (scenario.fault_q.kind > 0)))
    figure = shade(by_joint(last["t"], panels, config.robot.joint_names), last)
    note = f"{config.robot.joint_names[first]} shows first. Dashed grey: threshold; shaded: a fault on any joint."
    return finish(figure, title, note, panels=4, first=first)


def _describe(config: Config, scenario: Scenario) -> str:
    """The faults of a scenario in words."""
    parts = []
    for fault, kinds in ((scenario.fault_tau, Actuator), (scenario.fault_q, Sensor)):
        for joint in np.flatnonzero(fault.kind):
            who = "actuator" if kinds is Actuator else "encoder"
            parts.append(f"{who} {kinds(int(fault.kind[joint])).name.lower()} on {config.robot.joint_names[joint]}")
    if scenario.contact is not None and scenario.contact.size > 0:
        parts.append(f"force on link {int(scenario.contact.link)}")
    return ", ".join(parts) or "healthy"
