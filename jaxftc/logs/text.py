"""Logs as text: comma, semicolon, tab or blanks, decimal comma or point, comments, a byte-order mark."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from pathlib import Path

import numpy as np

from jaxftc.logs.formats import Table

COMMENT = ("#", "%", "//")
NUMBER = r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)"
_NUMBER = re.compile(NUMBER, re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")


def read(path: Path) -> Table:
    """The table of a text file; cells stay text where a column is not all numbers.

    Raises:
        ValueError: a file that is not text, or rows of another length than the head.
    """
    comments: list[str] = []
    lines: list[str] = []
    rows: list[int] = []  # line of the file, from 1
    for number, line in enumerate(_decoded(path).splitlines(), start=1):
        stripped = line.strip()
        if stripped.startswith(COMMENT):
            if not lines:
                comments.append(stripped.lstrip("#%/ "))
        elif stripped:
            lines.append(line)
            rows.append(number)
    if not lines:
        raise ValueError(f"{path}: the file has no rows; record a motion")
    cut = _separator(lines)
    head = _cells(lines[0], cut)
    comma = cut != "," and any(_DECIMAL_COMMA.fullmatch(c) for line in lines[1:3] for c in _cells(line, cut))
    notes = ["numbers have a decimal comma"] if comma else []
    named = not all(_NUMBER.fullmatch(cell) or not cell for cell in head)
    if named:
        lines, rows = lines[1:], rows[1:]
    elif comments and len(_cells(comments[-1], cut)) == len(head):
        head, named = _cells(comments[-1], cut), True
    else:
        head = [f"column {k + 1}" for k in range(len(head))]
    if not lines:
        raise ValueError(f"{path}: the file has a head and no rows; record a motion")
    double = [name for name, count in Counter(head).items() if count > 1 and name]
    if double:
        raise ValueError(f"{path}: two columns are named {double[0]!r}; rename one of them")
    return Table(_columns(path, head, lines, rows, cut, comma), tuple(notes), named)


def _decoded(path: Path) -> str:
    raw = path.read_bytes()
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16")
    if b"\x00" in raw[:4096]:
        raise ValueError(f"{path}: this is a binary file and not text; is its suffix right?")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _separator(lines: list[str]) -> str | None:
    """The separator that cuts the first lines into the same number of cells; None stands for blanks."""
    sample = lines[:20]
    for cut in (";", "\t", ","):
        counts = {line.count(cut) for line in sample}
        if min(counts) > 0 and (len(counts) == 1 or cut == ","):
            return cut
    return None


def _cells(line: str, cut: str | None) -> list[str]:
    cells = [cell.strip().strip('"').strip() for cell in line.split(cut)]
    return cells[:-1] if cut and len(cells) > 1 and not cells[-1] else cells  # a separator at the end of the line


def _columns(
    path: Path, head: list[str], lines: list[str], rows: list[int], cut: str | None, comma: bool
) -> dict[str, np.ndarray]:
    try:  # all numbers, the common case, at the speed of C
        text = (line.replace(",", ".") for line in lines) if comma else lines
        values = np.loadtxt(text, delimiter=cut, comments=None, ndmin=2)
        if values.shape[1] == len(head):
            return dict(zip(head, values.T, strict=True))
    except ValueError:
        pass
    table = [_cells(line, cut) for line in lines]
    for cells, number in zip(table, rows, strict=True):
        if len(cells) != len(head):
            if number == rows[-1] and len(cells) < len(head):  # the recorder was stopped while it wrote
                table.pop()
                break
            raise ValueError(
                f"{path}: line {number} has {len(cells)} columns, the head has {len(head)}; mend or remove that line"
            )
    return {name: _column(cells, comma) for name, cells in zip(head, itertools.zip_longest(*table), strict=True)}


def _column(cells: tuple[str, ...], comma: bool) -> np.ndarray:
    plain = [cell.replace(",", ".") for cell in cells] if comma else list(cells)
    numbers = ["nan" if cell.lower() in MISSING else cell for cell in plain]
    try:
        return np.array(numbers, float)
    except ValueError:
        return np.array(plain, object)


MISSING = ("", "na", "n/a", "null", "none", "-")
