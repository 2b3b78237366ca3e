"""Two things that Sphinx does not do by itself: formulas as MathML, and the comments of a class's fields as a list.

MathML is drawn by browsers without a script, so the pages open offline. Fields of a ``NamedTuple`` or a dataclass say shape
and unit in the comment behind them; the list is read from the source, by ``tokenize``.
"""

from __future__ import annotations

import inspect
import io
import re
import tokenize
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", inline_renderers=(inline, None), block_renderers=(block, None))
    app.connect("autodoc-process-docstring", list_fields)
    return {"parallel_read_safe": True}


def inline(writer: Any, node: nodes.Element) -> None:
    """A formula in a line of text."""
    writer.body.append(convert(node.astext()))
    raise nodes.SkipNode


def block(writer: Any, node: nodes.Element) -> None:
    """A formula of its own, which scrolls where it is wider than the page."""
    writer.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>\n')
    raise nodes.SkipNode


def list_fields(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Append ``name: comment`` for every field of a class that has a comment behind it."""
    comments = field_comments(obj) if what == "class" else {}
    if comments:
        lines += ["", "**Fields**", ""]
        for field, comment in comments.items():
            lines.append(f"- ``{field}``: " + re.sub(r"([*|`\\])", r"\\\1", comment))
        lines.append("")


def field_comments(cls: type) -> dict[str, str]:
    """The comment behind each field of a class, from its source."""
    try:
        source = inspect.cleandoc("\n" + inspect.getsource(cls))
    except (OSError, TypeError):
        return {}
    found: dict[str, str] = {}
    field = ""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        fresh = token.line[:4] == "    " and token.line[4:5].isidentifier()
        if token.type == tokenize.NAME and fresh and token.start[1] == 4:
            field = token.string
        if token.type == tokenize.COMMENT and field in cls.__annotations__:
            found[field] = token.string.lstrip("# ")
    return found
