"""The paper's result figures, redrawn from our runs, in the paper's order and by its numbers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from jaxftc.config import CONTROLS, OBSERVERS, Config
from jaxftc.fuzzy.membership import share
from jaxftc.gains import Gains
from jaxftc.paper.claims import ARX_DEG
from jaxftc.paper.experiment import SEEDS, SWEEP, WRONG
from jaxftc.paper.results import Experiment
from jaxftc.report.figures import (
    COLOURS,
    LIMIT,
    LOGARITHMIC,
    TRUTH,
    Panel,
    by_joint,
    finish,
    residual_figure,
    shade,
    together,
)
from jaxftc.scenarios.scenario import CONDITIONS

Trace = dict[str, np.ndarray]
OBSERVER_NAMES = {"pi": "PI", "eso": "PI + sliding mode (ESO)", "ts": "PI + sliding mode + T-S"}
STAGES = {
    "pi": "With an integrator alone the encoder fault is taken for a torque; it has no encoder estimate.",
    "eso": "The sliding-mode term quickens the torque estimate; the encoder fault is still taken for a torque.",
    "ts": "The fuzzy stage attributes the jump of the reading to the encoder, which frees the torque estimate of it.",
}
RESIDUALS = {  # condition -> number, title, what it shows
    "healthy": ("10", "Residuals without a fault", "Only encoder noise should be left."),
    "actuator": ("12", "Residuals under actuator faults", "Only the torque channel should answer."),
    "sensor": (
        "13",
        "Residuals under encoder faults",
        "Only the encoder channel should answer.",
    ),
    "both": (
        "14",
        "Residuals under actuator and encoder faults at once",
        "Each channel should answer to its own fault.",
    ),
}


def figures(config: Config, gains: Gains, experiment: Experiment) -> Iterator[tuple[str, go.Figure]]:
    """(number in the paper, figure), in the paper's order."""
    best = experiment.traces[OBSERVERS[-1], CONTROLS[-1]]
    yield "2", _identified(config, experiment)
    for number, observer in zip(("3", "4"), OBSERVERS, strict=False):
        yield number, _first_joint(config, observer, experiment.traces[observer, CONTROLS[-1]][-1])
    yield "5", _membership(gains)
    yield "6", _first_joint(config, OBSERVERS[-1], best[-1])
    yield "7", _wrong_thresholds(config, experiment.wrong)
    yield "9", _healthy_motion(config, best[0])
    yield _residuals(config, "healthy", best[0])
    yield "11", _estimation_errors(config, [experiment.traces[observer, CONTROLS[-1]][-1] for observer in OBSERVERS])
    for condition, trace in zip(CONDITIONS[1:], best[1:], strict=True):
        yield _residuals(config, condition, trace)
    last = {control: experiment.traces[OBSERVERS[-1], control][-1] for control in CONTROLS}
    yield "15", _trajectories(config, last)
    yield "15b", _equal_chattering(experiment)
    yield "16", _torques(config, last)


def _identified(config: Config, experiment: Experiment) -> go.Figure:
    arx = experiment.arx
    t = config.dt * np.arange(len(arx.free_run))
    reading, free = np.rad2deg(np.asarray(arx.log.q)), np.rad2deg(arx.free_run)
    bound = np.full(config.n, ARX_DEG)
    panels = [
        Panel("angle, deg", {"reading": (reading, {"color": "#000"}), "model running alone": (free, _line(0, "dash"))}),
        Panel("error, deg", {"error": (free - reading, _line(1))}, bound),
    ]
    figure = by_joint(t, panels, config.robot.joint_names)
    note = (
        "Healthy arm. The model knows the first reading and the torques, and was identified from another run of the same "
        "motion. Dashed: the paper's 0.05 deg."
    )
    return finish(figure, "ARX-Laguerre model: fit and error", note, panels=2)


def _first_joint(config: Config, observer: str, trace: Trace) -> go.Figure:
    """The paper's pair of panels, real and estimated angle and the error between; and the two fault estimates."""
    q, q_hat = np.rad2deg(trace["q"]), np.rad2deg(trace["q_hat"])
    found = _line(OBSERVERS.index(observer))
    panels = [
        Panel("angle, deg", {"true": (q, TRUTH), "estimated": (q_hat, found)}),
        Panel("angle error, deg", {"error": (q_hat - q, _line(3))}),
        Panel("actuator fault, N m", {"true": (trace["fault_tau"], TRUTH), "estimated": (trace["fault_tau_hat"], found)}),
        Panel(
            "encoder fault, deg",
            {"true": (np.rad2deg(trace["fault_q"]), TRUTH), "estimated": (np.rad2deg(trace["fault_q_hat"]), found)},
        ),
    ]
    figure = shade(by_joint(trace["t"], panels, config.robot.joint_names), trace)
    return finish(figure, f"{OBSERVER_NAMES[observer]} observer, both faults on", STAGES[observer], panels=4)


def _membership(gains: Gains) -> go.Figure:
    """Grades of the T-S observer's two inputs, as the rules use them."""
    figure = make_subplots(1, 2, shared_yaxes=True, horizontal_spacing=0.06)
    x = np.linspace(0, 1.5, 151)
    inputs = (
        ("|residual| / TH", gains.observer.tau_centres, gains.observer.tau_widths),
        ("|jump| / J", gains.observer.jump_centres, gains.observer.jump_widths),
    )
    for column, (_, centres, widths) in enumerate(inputs, start=1):
        bell = np.exp(-0.5 * ((x - np.asarray(centres)[:, None]) / np.asarray(widths)[:, None]) ** 2)
        second = np.asarray(share(jnp.asarray(x), centres, widths))
        for k, name in enumerate(("zero", "at threshold")):
            for y, dash in ((bell[k], "dot"), ((1 - second, second)[k], "solid")):
                figure.add_scatter(
                    x=x.astype(np.float32), y=y.astype(np.float32), name=name, legendgroup=name, line=_line(k, dash),
                    showlegend=column == 1 and dash == "solid", row=1, col=column,
                )  # fmt: skip
    figure.update_yaxes(title_text="grade", row=1, col=1)
    note = (
        "Left: the torque residual over its threshold; right: the reading's change in one sample over one that no torque "
        "can cause. Dotted: the Gaussian sets; solid: their normalised shares, which the rules multiply."
    )
    finish(figure, "Membership functions of the T-S observer", note)
    for column, (axis, *_) in enumerate(inputs, start=1):
        figure.update_xaxes(title_text=axis, row=1, col=column)
    return figure


def _wrong_thresholds(config: Config, wrong: list[Trace]) -> go.Figure:
    small, large = wrong
    panels = [
        Panel(f"S, {words}, N m", {"statistic S": (trace["statistic_tau"], _line(k))}, trace["threshold_tau"][0])
        for k, (trace, words) in enumerate(((small, "healthy"), (large, "actuator fault")))
    ]
    figure = by_joint(small["t"], panels, config.robot.joint_names)
    for row, trace in enumerate(wrong, start=1):
        alarm = np.where(trace["verdict"] > 0, 0.0, np.nan)
        for j in range(config.n):
            figure.add_scatter(
                x=trace["t"].astype(np.float32), y=alarm[:, j].astype(np.float32), name="alarm", mode="lines",
                line={"color": "#a33", "width": 5}, legendgroup="alarm", showlegend=row == 1, meta={"joint": j},
                row=row, col=1,
            )  # fmt: skip
    (_, little), (_, much) = WRONG
    note = (
        f"Factors chosen to be wrong. Above: thresholds times {little:g}, no fault. Below: times {much:g}, actuator fault; "
        "the T-S stage reads the same thresholds. Red: alarm."
    )
    return finish(figure, "Wrong thresholds", note, panels=2)


def _healthy_motion(config: Config, trace: Trace) -> go.Figure:
    panels = [
        Panel("angle, deg", {"": (np.rad2deg(trace["q"]), {})}),
        Panel("torque, N m", {"": (trace["tau"], {})}),
    ]
    error = float(np.rad2deg(np.abs(trace["q"] - trace["q_ref"]).max()))
    note = f"Healthy arm. The largest tracking error of any joint is {error:.3f} deg"
    limited = np.isfinite(config.robot.torque_limit)
    if limited.any():
        share = float(np.abs(trace["tau"] / config.robot.torque_limit)[:, limited].max())
        note += f"; the largest torque is {100 * share:.0f} % of its limit"
    figure = together(trace["t"], panels, config.robot.joint_names)
    return finish(figure, "Joint and torque signals", f"{note}.", panels=2, together=True)


def _residuals(config: Config, condition: str, trace: Trace) -> tuple[str, go.Figure]:
    """Both channels, and where the verdict says what."""
    number, title, note = RESIDUALS[condition]
    figure = residual_figure(config, trace, title)
    meta: Any = figure.layout["meta"]
    return number, figure.update_layout(meta=meta | {"note": f"{note} {meta['note']}"})


def _estimation_errors(config: Config, traces: list[Trace]) -> go.Figure:
    torque, angle = (
        {
            OBSERVER_NAMES[name]: (scale * (trace[f"{channel}_hat"] - trace[channel]), _line(k, ("dot", "dash", "solid")[k]))
            for k, (name, trace) in enumerate(zip(OBSERVERS, traces, strict=True))
        }
        for channel, scale in (("fault_tau", 1.0), ("fault_q", 180 / np.pi))
    )
    panels = [Panel("actuator, N m", torque), Panel("encoder, deg", angle)]
    figure = shade(by_joint(traces[0]["t"], panels, config.robot.joint_names), traces[0])
    return finish(figure, "Error of the fault estimates, both faults on", "Estimated less true fault.", panels=2)


def _trajectories(config: Config, traces: dict[str, Trace]) -> go.Figure:
    reference = next(iter(traces.values()))
    angles: dict[str, Any] = {"reference": (np.rad2deg(reference["q_ref"]), TRUTH)}
    angles |= {name.upper(): (np.rad2deg(trace["q"]), _line(k)) for k, (name, trace) in enumerate(traces.items())}
    errors = {
        name.upper(): (np.rad2deg(trace["q"] - trace["q_ref"]), _line(k)) for k, (name, trace) in enumerate(traces.items())
    }
    panels = [Panel("angle, deg", angles), Panel("tracking error, deg", errors)]
    figure = shade(by_joint(reference["t"], panels, config.robot.joint_names), reference)
    note = "Gains as given: the three do not chatter alike, so this alone ranks nothing. The next figure does."
    return finish(figure, "Trajectories of the three controllers, both faults on", note, panels=2)


def _equal_chattering(experiment: Experiment) -> go.Figure:
    """Tracking error against chattering over the switching gain, where the claims read off their numbers."""
    figure = make_subplots(1, 3, shared_yaxes=True, subplot_titles=CONDITIONS[1:], horizontal_spacing=0.04)
    for k, (control, curve) in enumerate(experiment.curves.items()):
        for column in range(1, len(CONDITIONS)):
            x, y = curve[:, :, :, column].mean(-1)
            figure.add_scatter(
                x=x, y=np.rad2deg(y), name=control.upper(), legendgroup=control, showlegend=column == 1,
                mode="lines+markers",
                line=_line(k), marker={"symbol": ("circle", "square", "diamond")[k], "size": 7}, row=1, col=column,
            )  # fmt: skip
    for column, condition in enumerate(CONDITIONS[1:], start=1):
        level = next(pair.chattering for pair in experiment.comparisons if pair.condition == condition)
        figure.add_vline(x=level, line=LIMIT, row=1, col=column)  # pyright: ignore[reportArgumentType]
    figure.update_yaxes(title_text="tracking rms, deg", type="log", row=1, col=1)
    figure.update_yaxes(type="log")
    note = (
        f"Each curve scales one controller's switching gain by {SWEEP[0]:g} to {SWEEP[-1]:g}; mean of {SEEDS} noises. "
        "Dashed: ESMC's level with the gains as given, at which, or at the nearest end, they are compared. Lower is better."
    )
    figure = finish(figure, "Tracking error at equal chattering", note)
    figure.update_yaxes(dtick=1)
    figure.update_xaxes(LOGARITHMIC, title_text="")
    figure.update_xaxes(title_text="chattering, 1/s", col=2)
    return figure.update_layout(legend_y=1.1)


def _torques(config: Config, traces: dict[str, Trace]) -> go.Figure:
    curves = {name.upper(): (trace["tau"], _line(k)) for k, (name, trace) in enumerate(traces.items())}
    first = next(iter(traces.values()))
    figure = shade(by_joint(first["t"], [Panel("torque, N m", curves)], config.robot.joint_names), first)
    return finish(figure, "Torque of the three controllers, both faults on", "Gains as given.")


def _line(k: int, dash: str = "solid") -> dict[str, Any]:
    return {"color": COLOURS[k], "dash": dash}
