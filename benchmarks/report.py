"""Pages of the benchmark suites."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING, Any

import plotly.graph_objects as go

from jaxftc.report.figures import COLOURS, finish
from jaxftc.report.page import embed, page, table

if TYPE_CHECKING:
    from benchmarks.curves import Curve
    from benchmarks.ranking import Pair


def curves_page(curves: list[Curve], cost: float, ran: dict[str, Any]) -> str:
    """Held-out objective over simulations and over time, every seed a line; what ran."""
    note = f"A line a seed; a gradient counts as {cost:.1f} simulations, measured; compilation apart."
    return page(
        "jaxftc bench tuning",
        [
            embed(_curves(curves, "simulations", "closed-loop simulations", note)),
            embed(_curves(curves, "seconds", "time without compilation, s", note)),
        ],
        ran=ran,
    )


def _curves(curves: list[Curve], axis: str, title: str, note: str) -> go.Figure:
    figure = go.Figure()
    methods = list(dict.fromkeys(c.method for c in curves))
    for c in curves:
        figure.add_scatter(
            x=getattr(c, axis)[1:],
            y=c.objective[1:],
            name=c.method,
            legendgroup=c.method,
            showlegend=c.seed == 0,
            line_color=COLOURS[methods.index(c.method)],
        )
    start = max(c.objective[0] for c in curves)
    figure.add_hline(y=start, line={"dash": "dot", "color": "#777"}, annotation_text="default gains")  # pyright: ignore[reportArgumentType]
    finish(figure, "Held-out objective of the best gains so far", note)
    figure.update_xaxes(type="log", title_text=title)
    figure.update_yaxes(title_text="held-out objective")
    return figure


def ranking_page(pairs: list[Pair], notes: dict[str, Any], ran: dict[str, Any]) -> str:
    """Both rankings as a table; what ran."""
    rows = [
        (
            *(p.ranking, p.condition, f"{p.before.upper()} to {p.after.upper()}"),
            p.word + (f" ({100 * p.louder:.0f} % cannot be made to chatter alike)" if p.louder else ""),
            *(f"{p.ratio.value:.3f} [{p.ratio.low:.3f}, {p.ratio.high:.3f}]", str(p.n)),
        )
        for p in pairs
    ]
    head = ("ranking", "condition", "pair", "result", "median ratio, 95 %", "n")
    text = "".join(
        f"<li>{html.escape(name)}: {', '.join(f'{k} {v:.3f}' for k, v in note.items())}</li>" for name, note in notes.items()
    )
    return page("jaxftc bench ranking", [table(head, rows, text=4), f"<ul>{text}</ul>"], ran=ran)
