"""Logs as text: comma, semicolon, tab or blanks, decimal comma or point, comments, a byte-order mark."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from pathlib import Path

import numpy as np

from jaxftc.logs.formats import UNITS, Table

COMMENT = ("#", "%", "//")
NUMBER = r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)"
_NUMBER = re.compile(NUMBER, re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
PREAMBLE = 50  # lines that a table may have before its head


def read(path: Path) -> Table:
    """The table of a text file; cells stay text where a column is not all numbers.

    Lines before the head, a head that stands again and a row of units are no rows of the table.

    Raises:
        ValueError: a file that is not text, or rows of another length than the head.
    """
    comments, lines = _lines(path)
    if not lines:
        raise ValueError(f"{path}: the file has no rows; record a motion")
    cut = _separator([text for _, text in lines])
    lines, notes = _from_head(lines, cut)
    head, first = _cells(lines[0][1], cut), lines[0][1]
    named = not all(_NUMBER.fullmatch(cell) or not cell for cell in head)
    if named:
        again = [number for number, text in lines[1:] if text == first]
        notes += [f"the head stands again in line {again[0]}, left out ({len(again)} times in all)"] if again else []
        lines = [(number, text) for number, text in lines[1:] if text != first]
    elif comments and len(_cells(comments[-1], cut)) == len(head):
        head, named = _cells(comments[-1], cut), True
    else:
        head = [f"column {k + 1}" for k in range(len(head))]
    units = _units(head, lines, cut) if named else {}
    if units:
        notes.append(f"line {lines[0][0]} holds units")
        lines = lines[1:]
    if not lines:
        raise ValueError(f"{path}: the file has a head and no rows; record a motion")
    double = [name for name, count in Counter(head).items() if count > 1 and name]
    if double:
        raise ValueError(f"{path}: two columns are named {double[0]!r}; rename one of them")
    if named and len(_cells(lines[0][1], cut)) == len(head) + 1:
        head = ["", *head]  # the first column counts the rows and has no name, as R writes it
    comma = cut != "," and _decimal_comma(lines, cut)
    notes += ["numbers have a decimal comma"] if comma else []
    return Table(_columns(path, head, lines, cut, comma), tuple(notes), named, units)


def _lines(path: Path) -> tuple[list[str], list[tuple[int, str]]]:
    """Comments before the table, and the other lines with their numbers, from 1."""
    comments: list[str] = []
    lines: list[tuple[int, str]] = []
    for number, line in enumerate(_decoded(path).splitlines(), start=1):
        stripped = line.strip()
        if stripped.startswith(COMMENT):
            if not lines:
                comments.append(stripped.lstrip("#%/ "))
        elif stripped:
            lines.append((number, line))
    return comments, lines


def _from_head(lines: list[tuple[int, str]], cut: str | None) -> tuple[list[tuple[int, str]], list[str]]:
    """The lines from the table's head on: titles before it have other numbers of cells."""
    width = Counter(len(_cells(text, cut)) for _, text in _middle(lines)).most_common(1)[0][0]
    for k, (_, text) in enumerate(lines[:PREAMBLE]):
        cells = _cells(text, cut)
        if len(cells) in (width, width - 1) and (k == 0 or width > 2):
            if k and all(_NUMBER.fullmatch(cell) for cell in cells):
                break  # the table has no head: what is wrong is said of its rows
            return lines[k:], [f"{k} lines before the table left out"] if k else []
    return lines, []


def _middle(lines: list) -> list:
    """Lines that are surely of the table, if there are many."""
    return lines[max(0, len(lines) // 2 - 10) : len(lines) // 2 + 10]


def _units(head: list[str], lines: list[tuple[int, str]], cut: str | None) -> dict[str, str]:
    """Units by column of a line below the head that holds nothing else; none if it is a row of numbers."""
    cells = [cell.strip("[]()") for cell in _cells(lines[0][1], cut)] if lines else []
    if len(cells) != len(head) or not any(cells) or any(_NUMBER.fullmatch(cell) for cell in cells):
        return {}
    return dict(zip(head, cells, strict=True)) if any(cell.lower() in UNITS for cell in cells) else {}


def _decimal_comma(lines: list[tuple[int, str]], cut: str | None) -> bool:
    texts = itertools.islice((text for _, text in lines if "," in text), 20)
    return any(_DECIMAL_COMMA.fullmatch(cell) for text in texts for cell in _cells(text, cut))


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
    sample = _middle(lines)
    for cut in (";", "\t", ","):
        counts = {line.count(cut) for line in sample}
        if min(counts) > 0 and (len(counts) == 1 or cut == ","):
            return cut
    return None


def _cells(line: str, cut: str | None) -> list[str]:
    cells = [cell.strip().strip('"').strip() for cell in line.split(cut)]
    return cells[:-1] if cut and len(cells) > 1 and not cells[-1] else cells  # a separator at the end of the line


def _columns(
    path: Path, head: list[str], lines: list[tuple[int, str]], cut: str | None, comma: bool
) -> dict[str, np.ndarray]:
    try:  # all numbers, the common case, at the speed of C
        text = (line.replace(",", ".") if comma else line for _, line in lines)
        values = np.loadtxt(text, delimiter=cut, comments=None, ndmin=2)
        if values.shape[1] == len(head):
            return dict(zip(head, values.T, strict=True))
    except ValueError:
        pass
    table = [_cells(line, cut) for _, line in lines]
    for cells, (number, _) in zip(table, lines, strict=True):
        if len(cells) == len(head):
            continue
        if number == lines[-1][0] and len(cells) < len(head):  # the recorder was stopped while it wrote
            table.pop()
            break
        why = "; are these decimal commas? Separate the cells by semicolons" if cut == "," and len(cells) > len(head) else ""
        raise ValueError(
            f"{path}: line {number} has {len(cells)} columns, the head has {len(head)}; mend or remove that line{why}"
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
