"""The page of an identified arm: torques before and after, friction, what is left, and what the logs could show."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from jaxftc.identify.derivatives import motion
from jaxftc.identify.physical import Identified, Share, torques
from jaxftc.logs.log import Log
from jaxftc.report.figures import COLOURS, MOST, Panel, by_joint, finish
from jaxftc.report.page import embed, notes, page, table
from jaxftc.robot.dynamics import coulomb
from jaxftc.robot.model import Robot

SPEEDS = 101  # points of a friction curve
STATUS = (
    "Shown: by how much these logs reduce the prior variance of a parameter. Left: they do not show it, so it keeps the "
    "file's value. Combined: only a sum of it and others is certain."
)
FIRST = "The first joint, until another is chosen above."


def identify_page(before: Robot, found: Identified, log: Log, title: str, ran: Mapping[str, Any]) -> str:
    """The whole page; ``log`` is the one whose torques are drawn, ``ran`` what ran."""
    names = before.joint_names
    m = motion(log)
    recorded = found.gain * m.tau
    models = {"file": torques(before, m), "identified": torques(found.robot, m) + found.offset}
    sections = [
        "<h2>Torque left over, on parts that were not fitted</h2>",
        share_table(found.held_out, names),
        notes((*log.notes, *found.notes)),
        embed(_torque_figure(log, recorded, models, names)),
        embed(_friction_figure(before, found, m.qd, recorded - models["identified"])),
        "<h2>Parameters</h2>",
        notes([STATUS]),
        parameter_table(found, names),
    ]
    return page(title, sections, names, ran)


def share_table(held: Share, names: tuple[str, ...]) -> str:
    """Rms of the torque and of what the models leave of it."""
    rows = [
        [name, f"{torque:.3g}", f"{was:.3g}", f"{now:.3g}", f"{100 * now / torque if torque else 0:.1f}"]
        for name, torque, was, now in zip(names, held.torque, held.before, held.after, strict=True)
    ]
    sums = [held.torque.sum(), held.before.sum(), held.after.sum()]
    rows.append(["all", *(f"{s:.3g}" for s in sums), f"{100 * held.share_after:.1f}"])
    return table(["joint", "torque", "left by the file", "left now", "share"], rows, units=["", "N m", "N m", "N m", "%"])


def parameter_table(found: Identified, names: tuple[str, ...]) -> str:
    """Every parameter before and after."""
    rows = [
        [names[p.joint - 1], p.name, f"{p.before:.4g}", f"{p.after:.4g}", p.unit, f"{100 * p.shown:.0f}", p.status]
        for p in found.parameters
    ]
    head = ["joint", "parameter", "file", "now", "unit", "shown", "status"]
    return table(head, rows, units=["", "", "", "", "", "%", ""], text=2)


def _torque_figure(log: Log, recorded: np.ndarray, models: dict[str, np.ndarray], names: tuple[str, ...]) -> go.Figure:
    curves = {"recorded": (recorded, {"color": COLOURS[6], "width": 1.0})}
    curves |= {name: (value, {"color": COLOURS[k]}) for (name, value), k in zip(models.items(), (1, 0), strict=True)}
    left = {
        f"left by {name}": (recorded - value, {"color": COLOURS[k], "width": 1.0})
        for (name, value), k in zip(models.items(), (1, 0), strict=True)
    }
    t = np.arange(len(recorded)) * log.sample_time
    figure = by_joint(t, [Panel("torque, N m", curves), Panel("left over, N m", left)], names)
    return finish(
        figure, "Torque, recorded and modelled", f"The first log. File: the model before. {FIRST}", panels=2, first=0
    )


def _friction_figure(before: Robot, found: Identified, qd: np.ndarray, left: np.ndarray) -> go.Figure:
    figure = go.Figure()
    step = max(1, len(qd) // MOST)
    for j in range(before.n):
        reach = np.abs(qd[:, j]).max() or 1.0
        x = reach * np.linspace(-1, 1, SPEEDS) ** 3
        grid = np.zeros((before.n, SPEEDS))
        grid[j] = x
        curves = {name: _friction(robot, grid)[j] for name, robot in (("file", before), ("identified", found.robot))}
        dots = np.interp(qd[::step, j], x, curves["identified"]) + left[::step, j]
        figure.add_scatter(
            x=qd[::step, j], y=dots, mode="markers", name="recorded less the links' torque", legendgroup="dots",
            showlegend=j == 0, marker={"size": 3, "color": "#bbb"}, meta={"joint": j},
        )  # fmt: skip
        for (name, y), colour in zip(curves.items(), (COLOURS[1], COLOURS[0]), strict=True):
            figure.add_scatter(
                x=x,
                y=y,
                mode="lines",
                name=name,
                legendgroup=name,
                showlegend=j == 0,
                line={"color": colour},
                meta={"joint": j},
            )
    finish(figure, "Friction over speed", FIRST, panels=2, first=0)
    return figure.update_xaxes(title_text="speed, rad/s").update_yaxes(title_text="friction, N m")


def _friction(robot: Robot, qd: np.ndarray) -> np.ndarray:
    import jax.numpy as jnp

    return np.asarray(coulomb(robot, jnp.asarray(qd, jnp.float32))) + robot.damping[:, None] * qd
