"""Tables as text."""

from __future__ import annotations

from collections.abc import Sequence


def aligned(head: Sequence[str], units: Sequence[str], rows: Sequence[Sequence[str]], *, text: int = 1) -> list[str]:
    """Lines of a table with a rule under its head: the first ``text`` columns to the left, the others to the right."""
    lines = [head, units, *rows]
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    found = [
        "  ".join(c.rjust(w) if k >= text else c.ljust(w) for k, (c, w) in enumerate(zip(line, widths, strict=True)))
        for line in lines
    ]
    return [*found[:2], "-" * len(found[0]), *found[2:]]
