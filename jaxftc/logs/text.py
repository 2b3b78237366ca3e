"""Logs as text: comma, semicolon, tab or blanks, decimal comma or point, comments, a byte-order mark."""

from __future__ import annotations

import codecs
import itertools
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxftc.logs.formats import Table, unit_named

COMMENT = ("#", "%", "//")
NUMBER = r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)"
_NUMBER = re.compile(NUMBER, re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
SAMPLE = 500  # lines that say how a long table is written
PREAMBLE = 50  # lines that a table may have before its head


def read(path: Path) -> Table:
    """The table of a text file; cells stay text where a column is not all numbers.

    Lines before the head, a head that stands again and a row of units are no rows of the table.

    Raises:
        ValueError: a file that is not text, or rows of another length than the head.
    """
    comments, lines = _lines(_decoded(path).splitlines())
    if not lines:
        raise ValueError(f"{path}: the file has no rows; record a motion")
    top = _top(comments, lines)
    if not top.rows:
        raise ValueError(f"{path}: the file has a head and no rows; record a motion")
    head, notes = top.head, top.notes
    double = [name for name, count in Counter(head).items() if count > 1 and name]
    if double:
        raise ValueError(f"{path}: two columns are named {double[0]!r}; rename one of them")
    if top.named and len(_cells(top.rows[0][1], top.cut)) == len(head) + 1:
        head = ["", *head]  # the first column counts the rows and has no name, as R writes it
    comma = top.cut != "," and _decimal_comma(top.rows, top.cut)
    notes += ["numbers have a decimal comma"] if comma else []
    return Table(_columns(path, head, top.rows, top.cut, comma), tuple(notes), top.named, top.units)


def count(path: Path) -> int:
    """Lines of the file, which are its rows but for a few.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        return sum(block.count(b"\n") for block in iter(lambda: file.read(1 << 20), b""))


def cut(path: Path, rows: int, folder: Path) -> Iterator[Path]:
    """The file in parts of ``rows`` lines, in order, each with the first line of the next; one part is there at a time.

    What stands before the first row stands before each of them.
    """
    part = folder / path.name
    with path.open(encoding=_encoding(path), errors="replace", newline="") as file:
        begin = list(itertools.islice(file, SAMPLE))
        comments, lines = _lines(begin)
        table = _top(comments, lines).rows if lines else []
        above = begin[: table[0][0] - 1] if table else begin
        rest = itertools.chain(begin[len(above) :], file)
        piece = list(itertools.islice(rest, rows + 1))
        while piece:
            part.write_text("".join([*above, *piece]), encoding="utf-8", newline="")
            yield part
            last = piece[rows:]
            piece = last + list(itertools.islice(rest, rows))
            if len(piece) == len(last):
                return


class _Top(NamedTuple):
    """How the table is written, and its rows with their line numbers."""

    head: list[str]
    named: bool
    units: dict[str, str]
    cut: str | None
    notes: list[str]
    rows: list[tuple[int, str]]


def _top(comments: list[str], lines: list[tuple[int, str]]) -> _Top:
    cut = _separator([text for _, text in lines])
    lines, notes = _from_head(lines, cut)
    head, first = _cells(lines[0][1], cut), lines[0][1]
    numbers = [bool(_NUMBER.fullmatch(cell)) for cell in head]
    named = not all(number or not cell for number, cell in zip(numbers, head, strict=True))
    above = _cells(comments[-1], cut) if comments else []
    if len(above) == len(head) and any(numbers):  # a row that begins with numbers is no head, whatever text it has
        head, named = above, True
    elif named:
        again = [number for number, text in lines[1:] if text == first]
        notes += [f"the head stands again in line {again[0]}, left out ({len(again)} times in all)"] if again else []
        lines = [(number, text) for number, text in lines[1:] if text != first]
    else:
        head = [f"column {k + 1}" for k in range(len(head))]
    units = _units(head, lines, cut) if named else {}
    if units:
        notes.append(f"line {lines[0][0]} holds units")
        lines = lines[1:]
    return _Top(head, named, units, cut, notes, lines)


def _lines(text: list[str]) -> tuple[list[str], list[tuple[int, str]]]:
    """Comments before the table, and the other lines with their numbers, from 1."""
    comments: list[str] = []
    lines: list[tuple[int, str]] = []
    for number, line in enumerate(text, start=1):
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
    return dict(zip(head, cells, strict=True)) if any(unit_named(cell) is not None for cell in cells) else {}


def _decimal_comma(lines: list[tuple[int, str]], cut: str | None) -> bool:
    texts = itertools.islice((text for _, text in lines if "," in text), 20)
    return any(_DECIMAL_COMMA.fullmatch(cell) for text in texts for cell in _cells(text, cut))


def _decoded(path: Path) -> str:
    raw = path.read_bytes()
    try:
        return raw.decode(_encoding(path))
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _encoding(path: Path) -> str:
    """How the file is encoded, by its first bytes."""
    with path.open("rb") as file:
        raw = file.read(4096)
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    if b"\x00" in raw:
        raise ValueError(f"{path}: this is a binary file and not text; is its suffix right?")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(raw)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


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
    for cells, (number, line) in zip(table, lines, strict=True):
        if len(cells) == len(head) - 1 and cut and line.rstrip().endswith(cut) and number != lines[-1][0]:
            cells.append("")  # the last one is empty: no separator at the end of the line
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
