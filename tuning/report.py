"""The page that a tuning run leaves: what it is worth, how it got there, what it did to the gains, and the worst runs."""

from __future__ import annotations

import html

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from jaxftc import metrics
from jaxftc.closed_loop import simulate
from jaxftc.config import Config
from jaxftc.control.gain import surface
from jaxftc.faults.kinds import Actuator, Sensor
from jaxftc.faults.scenario import Scenario, take, trail
from jaxftc.gains import Gains, specs
from jaxftc.report import COLOURS, embed, finish, page, shade
from tuning.held_out import Comparison
from tuning.loop import Result
from tuning.transform import idle

WORST = 3  # scenarios shown
BEFORE, AFTER = COLOURS[1], COLOURS[0]


def page_of(config: Config, start: Gains, result: Result, comparisons: list[Comparison]) -> str:
    """The whole page; the worst scenarios are simulated again for it."""
    sections = [
        "<h2>Held out</h2>" + "".join(_table(c) for c in comparisons),
        "<h2>How the loss fell</h2>",
        embed(loss_figure(result)),
        "<h2>Gains, before and after</h2>",
        embed(gains_figure(config, start, result.gains)),
    ]
    if config.control == "afesmc":
        sections += ["<h2>Table 1 as a surface, before and after</h2>", embed(surface_figure(config, start, result.gains))]
    sections += ["<h2>The worst scenarios after tuning</h2>", *worst_figures(config, start, result.gains, comparisons[0])]
    return page("jaxftc tune", sections)


def _table(c: Comparison) -> str:
    before, after = c.objective
    title = f"{c.preset}, {c.sign} sgn, {c.before.shape[1]} scenarios"
    rows = [("objective", before, after, c.ratio)]
    rows += [
        (name, b, a, c.term_ratio(name))
        for name, b, a in zip(c.names, c.before.mean(1), c.after.mean(1), strict=True)
        if b or a
    ]
    cells = "".join(
        f"<tr><td>{name}</td><td></td><td></td><td>{b:.4f}</td><td>{a:.4f}</td>"
        f"<td class='{'no' if a > 1.1 * b else 'yes'}'>{r.value:.3f} [{r.low:.3f}, {r.high:.3f}]</td></tr>"
        for name, b, a, r in rows
    )
    head = "<tr><th>mean of term</th><th></th><th></th><th>before</th><th>after</th><th>ratio, 95 % interval</th></tr>"
    lost = f"<p class='no'>diverged: {c.diverged[0]} to {c.diverged[1]} runs</p>" if any(c.diverged) else ""
    return f"<h3>{html.escape(title)}</h3>{lost}<table>{head}{cells}</table>"


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
    finish(figure, "Loss and its terms", "batches differ, so their curves are noisy; the validation set is always the same")
    figure.layout["xaxis2"].title = "closed-loop simulations, a gradient counted as several"
    return figure.update_layout(height=700)


def gains_figure(config: Config, before: Gains, after: Gains) -> go.Figure:
    """Each gain over its starting value, joint by joint, on a logarithmic axis; hover for the values and the unit."""
    names, factors, texts, colours = [], [], [], []
    for block, name, spec in specs():
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
        figure, "Gain after over before", "a dot a joint or set; gains that were 0 or changed sign are in gains.toml only"
    )
    figure.update_xaxes(type="log", title_text="after / before")
    return figure.update_layout(height=220 + 22 * len(set(names)), showlegend=False)


def surface_figure(config: Config, before: Gains, after: Gains) -> go.Figure:
    """alpha_online over joint position and sliding surface, the 7 x 7 rule base with its sets, as two maps on one scale."""
    q, s = np.meshgrid(np.deg2rad(np.linspace(-110, 110, 56)), np.linspace(-1.2, 1.2, 49))
    figure = make_subplots(1, 2, shared_yaxes=True, subplot_titles=("before", "after"), horizontal_spacing=0.06)
    for column, gains in enumerate((before, after), start=1):
        value = surface(config, gains, q, s)
        figure.add_heatmap(
            x=np.rad2deg(q[0]), y=s[:, 0], z=value, zmin=0, zmax=3, colorscale="Cividis", showscale=column == 2,
            colorbar={"title": "alpha_online"}, row=1, col=column,
        )  # fmt: skip
        centres = [np.asarray(c, float) for c in (gains.control.q_centres, gains.control.s_centres)]
        cq, cs = np.meshgrid(np.rad2deg(centres[0]), centres[1])
        figure.add_scatter(
            x=cq.ravel(), y=cs.ravel(), mode="markers", marker={"color": "#fff", "size": 5, "symbol": "cross"},
            showlegend=False, hoverinfo="skip", row=1, col=column,
        )  # fmt: skip
    figure.update_yaxes(title_text="s, rad/s", row=1, col=1)
    finish(figure, "Factor on the switching gain (joint 1's floor)", "crosses: centres of the sets")
    figure.update_xaxes(title_text="joint position, deg")
    return figure


def worst_figures(config: Config, before: Gains, after: Gains, c: Comparison) -> list[str]:
    """Tracking error and residual statistics of the scenarios with the largest objective after tuning."""
    own = c.weights @ c.after
    rows = np.argsort(own)[::-1][:WORST]
    chosen = trail(take(c.scenarios, rows))
    traces = [simulate(config, gains, chosen, c.key) for gains in (before, after)]
    found = []
    for k, row in enumerate(rows):
        columns = [metrics.columns(trace, k) for trace in traces]
        was, now = (c.weights @ c.before)[row], own[row]
        title = f"{c.preset} scenario {row}: {_describe(config, take(c.scenarios, row))}; objective {was:.2f} to {now:.2f}"
        found.append(embed(_trace_figure(config, columns, take(c.scenarios, row), title)))
    return found


def _trace_figure(config: Config, columns: list[dict[str, np.ndarray]], scenario: Scenario, title: str) -> go.Figure:
    """Before and after: tracking error, torque statistic over threshold, encoder fault and estimate, of a faulty joint."""
    joint = int(np.argmax((scenario.fault_tau.kind > 0) | (scenario.fault_q.kind > 0)))
    figure = make_subplots(3, 1, shared_xaxes=True, vertical_spacing=0.06)
    for trace, name, colour in zip(columns, ("before", "after"), (BEFORE, AFTER), strict=True):
        error = np.rad2deg(trace["q"][:, joint] - trace["q_ref"][:, joint])
        ratio = np.abs(trace["statistic_tau"][:, joint]) / trace["threshold_tau"][:, joint]
        look = {"name": name, "legendgroup": name, "line_color": colour}
        figure.add_scatter(x=trace["t"], y=error, **look, row=1, col=1)
        figure.add_scatter(x=trace["t"], y=ratio, showlegend=False, **look, row=2, col=1)
        angle = np.rad2deg(trace["fault_q_hat"][:, joint])
        figure.add_scatter(x=trace["t"], y=angle, showlegend=False, **look, row=3, col=1)
    truth = np.rad2deg(columns[1]["fault_q"][:, joint])
    black = {"name": "true encoder fault", "line": {"color": "#000", "dash": "dot"}}
    figure.add_scatter(x=columns[1]["t"], y=truth, **black, row=3, col=1)
    figure.add_hline(y=1.0, line={"dash": "dash", "color": "#777"}, row=2, col=1)  # pyright: ignore[reportArgumentType]
    shade(figure, columns[1])
    for row, text in enumerate(("tracking error, deg", "|S| / threshold, torque", "encoder fault, deg"), start=1):
        figure.update_yaxes(title_text=text, row=row, col=1)
    note = f"{config.robot.joint_names[joint]}; shaded: fault present"
    return finish(figure, title, note).update_layout(height=620)


def _describe(config: Config, scenario: Scenario) -> str:
    """The faults of a scenario in words."""
    parts = []
    for fault, kinds in ((scenario.fault_tau, Actuator), (scenario.fault_q, Sensor)):
        for joint in np.flatnonzero(fault.kind):
            who = "actuator" if kinds is Actuator else "encoder"
            parts.append(f"{who} {kinds(int(fault.kind[joint])).name.lower()} on {config.robot.joint_names[joint]}")
    return ", ".join(parts) or "healthy"
