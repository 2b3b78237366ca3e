"""The block diagram of Figures 1 and 8 as a picture: the paper's blocks with the modules that are theirs here."""

from __future__ import annotations

import html
from typing import NamedTuple


class Box(NamedTuple):
    """A block of the paper, or what is around it."""

    x: int
    y: int
    block: str  # the paper's number, or nothing
    name: str
    module: str


WIDE, HIGH = 200, 62
BOXES = {
    "reference": Box(5, 150, "", "Desired motion", "scenarios/reference.py"),
    "control": Box(260, 150, "8", "Sliding-mode control", "control/sliding_mode.py"),
    "gain": Box(260, 20, "9", "Fuzzy gain, Table 1", "control/fuzzy_gain.py"),
    "faults": Box(740, 20, "", "Faults", "simulation/fault_injection.py"),
    "plant": Box(740, 150, "", "Arm and encoders", "robot/dynamics.py"),
    "arx": Box(740, 290, "1", "ARX-Laguerre model", "observer/arx.py"),
    "pi": Box(740, 400, "2", "PI observer", "observer/pi.py"),
    "eso": Box(500, 400, "3", "Extended state", "observer/super_twisting.py"),
    "ts": Box(260, 400, "4", "Takagi-Sugeno stage", "observer/takagi_sugeno.py"),
    "residual": Box(260, 520, "5", "Residuals", "diagnosis/residuals.py"),
    "threshold": Box(500, 520, "6", "Thresholds", "diagnosis/statistics.py"),
    "decide": Box(740, 520, "7", "Decision", "diagnosis/decision.py"),
}
ARROWS = (  # points, and what flows
    (((205, 181), (260, 181)), "q_ref"),
    (((360, 82), (360, 150)), "alpha_online"),
    (((460, 181), (740, 181)), "tau"),
    (((840, 82), (840, 150)), "fault_tau, fault_q"),
    (((840, 212), (840, 290)), "reading y"),
    (((600, 181), (600, 321), (740, 321)), "commanded tau"),
    (((840, 352), (840, 400)), "y - y_hat"),
    (((740, 431), (700, 431)), "psi"),
    (((500, 431), (460, 431)), "psi"),
    (((360, 400), (360, 212)), "q_hat, psi_hat"),
    (((360, 462), (360, 520)), "psi_hat, b"),
    (((460, 551), (500, 551)), "r"),
    (((700, 551), (740, 551)), "S"),
    (((940, 551), (1010, 551)), "verdict"),
)


def draw() -> str:
    """The diagram as SVG in a box that scrolls on narrow screens."""
    boxes = "".join(_box(box) for box in BOXES.values())
    arrows = "".join(_arrow(points, text) for points, text in ARROWS)
    tip = (
        "<defs><marker id='tip' viewBox='0 0 8 8' refX='7' refY='4' markerWidth='8' markerHeight='8' orient='auto'>"
        "<path d='M0 0L8 4L0 8z' fill='#444'/></marker></defs>"
    )
    return (
        "<div class='wide'><svg class='diagram' viewBox='0 0 1040 600' role='img' aria-label='block diagram' "
        f"font-family='system-ui, sans-serif' font-size='13'>{tip}{arrows}{boxes}</svg></div>"
        "<p class='note'>White: one tick, what runs on the robot, <code>schemes/cascade.py</code>, line by line the paper's "
        "Algorithm 1. Grey: the simulation around it, <code>simulation/closed_loop.py</code>. All inside "
        "<code>jaxftc/</code>.</p>"
    )


def _box(box: Box) -> str:
    number = f"<tspan font-weight='700'>{box.block}</tspan> " if box.block else ""
    fill = "#fff" if box.block else "#eee"
    middle = box.x + WIDE // 2
    place = f"x='{box.x}' y='{box.y}' width='{WIDE}' height='{HIGH}' rx='6'"
    return (
        f"<rect {place} fill='{fill}' stroke='#0072B2' stroke-width='1.5'/>"
        f"<text x='{middle}' y='{box.y + 26}' text-anchor='middle'>{number}{html.escape(box.name)}</text>"
        f"<text x='{middle}' y='{box.y + 46}' text-anchor='middle' font-size='11' font-family='monospace' fill='#444'>"
        f"{box.module}</text>"
    )


def _arrow(points: tuple[tuple[int, int], ...], text: str) -> str:
    path = "M" + "L".join(f"{x} {y}" for x, y in points)
    (x0, y0), (x1, y1) = points[-2:] if len(points) == 2 else points[:2]
    if y0 == y1:
        label = f"<text x='{(x0 + x1) / 2}' y='{y0 - 7}' text-anchor='middle' font-size='12'>{html.escape(text)}</text>"
    else:
        label = f"<text x='{x0 + 7}' y='{(y0 + y1) / 2 + 4}' font-size='12'>{html.escape(text)}</text>"
    return f"<path d='{path}' fill='none' stroke='#444' stroke-width='1.5' marker-end='url(#tip)'/>{label if text else ''}"
