"""The page: its look, tables, figures with their captions, and the choice of the joint that they show."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from importlib.resources import files
from types import MappingProxyType
from typing import Any

import plotly.graph_objects as go

Cell = str | tuple[str, str]  # text, or text and the class of its look, or text and the #anchor that it leads to


def page(title: str, sections: list[str], joints: Sequence[str] = (), ran: Mapping[str, Any] = MappingProxyType({})) -> str:
    """A self-contained page of sections in HTML, which opens offline.

    ``joints`` are names of the joints between which the reader may choose; figures say by ``meta`` what belongs to which.
    ``ran`` is what it takes to make it again, the last section.
    """
    from plotly.offline import get_plotlyjs

    style, script = ((files("jaxftc.report") / name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    body = "\n".join([_choice(joints), *sections, _provenance(ran)])
    return (
        f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>{html.escape(title)}</title>"
        f"<meta name='viewport' content='width=device-width,initial-scale=1'><link rel='icon' href='data:,'>"
        f"<style>{style}</style><script>{get_plotlyjs()}</script></head>"
        f"<body><h1>{html.escape(title)}</h1>{body}<script>{script}</script></body></html>\n"
    )


def _choice(joints: Sequence[str]) -> str:
    if len(joints) < 2:
        return ""
    buttons = "".join(
        f"<label><input type='radio' name='joint' value='{value}'{' checked' if value == 'all' else ''}> "
        f"{html.escape(name)}</label>"
        for value, name in [("all", "all joints"), *enumerate(joints)]
    )
    return f"<fieldset class='joints' aria-label='joint shown'>{buttons}</fieldset>"


def embed(figure: go.Figure, *, number: str = "", below: str = "") -> str:
    """A figure of ``figures.finish`` as HTML, its title and note above it and ``below`` under it.

    ``number`` is that of the paper's figure; it makes the anchor ``#figure-<number>``.
    """
    layout: Any = figure.layout
    meta = layout.meta
    anchor, before = (f" id='figure-{number}'", f"Figure {number}. ") if number else ("", "")
    note = f"<p class='note'>{html.escape(meta['note'])}</p>" if meta["note"] else ""
    data = figure.to_json()  # it escapes what would end the script
    return (
        f"<figure{anchor}><h3>{before}{html.escape(meta['title'])}</h3>{note}"
        f"<div class='canvas' style='height:{layout.height}px'></div>"
        f"<script type='application/json'>{data}</script>{below}</figure>"
    )


def table(
    head: Sequence[str], rows: Sequence[Sequence[Cell]], *, units: Sequence[str] = (), text: int = 1, look: str = ""
) -> str:
    """A table of cells under a head, with units; the first ``text`` columns hold words, the others figures.

    ``look`` is a class of the style sheet.
    """
    units = units or [""] * len(head)
    titles = "".join(
        f"<th{_class('text' if k < text else '')}>{html.escape(name)}"
        + (f"<br><span class='unit'>{html.escape(unit)}</span>" if unit else "")
        + "</th>"
        for k, (name, unit) in enumerate(zip(head, units, strict=True))
    )
    body = "".join(f"<tr>{''.join(_cell(k, cell, text) for k, cell in enumerate(row))}</tr>" for row in rows)
    return f"<div class='wide'><table{_class(look)}><thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table></div>"


def notes(lines: Sequence[str]) -> str:
    """A small paragraph for each line of text."""
    return "".join(f"<p class='note'>{html.escape(line)}</p>" for line in lines)


def _provenance(ran: Mapping[str, Any]) -> str:
    rows = [(name.replace("_", " "), _plain(value)) for name, value in ran.items()]
    return "<h2>What ran</h2>" + table(("", ""), rows, text=2, look="provenance") if rows else ""


def _plain(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_plain(one)}" for name, one in value.items()) or "none"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_plain, value))}]"
    return "default" if value is None else str(value) or "none"


def _cell(column: int, cell: Cell, text: int) -> str:
    words, more = cell if isinstance(cell, tuple) else (cell, "")
    words = html.escape(words)
    if more.startswith("#"):
        words, more = f"<a href='{more}'>{words}</a>", ""
    look = "text" if column < text else "number"
    return f"<td{_class(f'{look} {more}'.strip())}>{words}</td>"


def _class(look: str) -> str:
    return f" class='{look}'" if look else ""
