"""Operations on single numbers as C99: one line each, nothing but math.h called, no loop, no memory asked for."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxftc.compile.operations import HELPERS, TYPES, row
from jaxftc.compile.scalars import Program


def body(program: Program, inputs: Sequence[Sequence[str]], results: Sequence[Sequence[str]]) -> list[str]:
    """Statements that read ``inputs`` and then write ``results``: an expression in C for every number of every leaf.

    All is read before anything is written, so that a result may lie where an input was.
    """
    names: dict[int, str] = {}
    lines, box = [], ""

    def name(place: int) -> str:
        """What stands for a number; an input is read just before it is first used."""
        if place not in names:
            operation = program.operations[place]
            leaf, number = operation.args
            names[place] = _word(inputs[leaf][number])
            lines.append(f"const {TYPES[operation.dtype.name]} {names[place]} = {inputs[leaf][number]};")
        return names[place]

    for place, operation in enumerate(program.operations):
        if operation.name == "input":
            continue
        if operation.name == "constant":
            names[place] = literal(operation.value)
            continue
        if operation.box != box:
            box = operation.box
            lines += ["", f"/* {box} */"]
        expression = _expression(operation.name, operation.of, [name(arg) for arg in operation.args])
        names[place] = f"t{place}"
        lines.append(f"const {TYPES[operation.dtype.name]} t{place} = {expression};")
    written = [
        (place, where)
        for array, places in zip(results, program.results, strict=True)
        for place, where in zip(map(int, places.ravel()), array, strict=True)
    ]
    wanted = [name(place) for place, _ in written]
    return [*lines, "", "/* Results */", *(f"{where} = {value};" for (_, where), value in zip(written, wanted, strict=True))]


def _word(expression: str) -> str:
    """A name for what an expression reads: state->observer_e[2] is observer_e_2."""
    return re.sub(r"\W+", "_", re.sub(r"^(state|in)->", "", expression)).strip("_")


def _expression(name: str, of: np.dtype, operands: list[str]) -> str:
    own = TYPES[of.name]
    kind = "int64_t" if own == "int64_t" else "int32_t"
    return row(name, of).c.format(*operands, f="f" if own == "float" else "", of=own, int=kind)


def helpers(*programs: Program) -> list[str]:
    """The small functions that the programs' lines call."""
    used = {(op.name, TYPES[op.of.name]) for program in programs for op in program.operations if op.name in HELPERS}
    return sorted({HELPERS[name].format(t=kind) for name, kind in used if not (kind == "bool" or "int" in kind)})


def literal(value: Any) -> str:
    """A number as C reads it back to the last bit."""
    if value.dtype.kind == "b":
        return "true" if value else "false"
    if value.dtype.kind in "iu":
        return f"{value}" if value >= 0 else f"({value})"
    if np.isnan(value):
        return f"({TYPES[value.dtype.name]})NAN"
    if np.isinf(value):
        return f"({'-' if value < 0 else ''}({TYPES[value.dtype.name]})INFINITY)"
    text = repr(float(str(value))) + ("f" if value.dtype == np.float32 else "")  # the shortest that is the same number
    return f"({text})" if text.startswith("-") else text
