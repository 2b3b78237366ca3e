"""What a compiled program does in each turn of its loops, by XLA's own text: kernels, operations, numbers read and written.

A kernel is what the device is called for once: a fused loop, a copy, a join. On a CPU a call costs about 0.1 us, on a GPU
some microseconds; what they read and write goes through the caches, or through the GPU's memory.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

FEW = 8  # kernels of a loop that is not worth a row
COST = {"divide": 4, "sqrt": 4, "rsqrt": 4, "remainder": 6, "exponential": 8, "exponential-minus-one": 10, "log": 10}
COST |= {"log-plus-one": 15, "tanh": 12, "logistic": 12, "erf": 15, "sine": 20, "cosine": 20, "power": 30, "atan2": 30}
FREE = {"parameter", "constant", "broadcast", "bitcast", "reshape", "tuple", "get-tuple-element", "slice", "iota", "copy"}
FREE |= {"concatenate", "pad", "transpose", "dynamic-slice", "dynamic-update-slice", "bitcast-convert", "reverse"}
NOTHING = {"parameter", "constant", "tuple", "get-tuple-element", "bitcast", "opt-barrier", "after-all", "while", "call"}
NOTHING |= {"conditional"}

_COMPUTATION = re.compile(r"^(?:ENTRY )?%?([\w.\-]+) \(.*\{$")
_INSTRUCTION = re.compile(r"^\s+(ROOT )?%?([\w.\-]+) = (\(.*?\)|\S+) ([\w\-]+)\((.*)$")
_ARRAY = re.compile(r"\b[a-z]+\d*\[([\d,]*)\]")


class Instruction(NamedTuple):
    """A line of XLA's text."""

    root: bool
    name: str
    sizes: tuple[int, ...]  # numbers in each of its results
    opcode: str
    rest: str  # operands and attributes

    @property
    def operands(self) -> list[str]:
        """Names of the instructions that it uses."""
        return re.findall(r"%([\w.\-]+)", self.rest.split("), ")[0])


class Turn(NamedTuple):
    """One turn of a loop; numbers and operations are of one scenario.

    What XLA's text has twice in a kernel counts twice, though LLVM does it once; sums and products of matrices count as
    many operations as they have results.
    """

    loop: str
    kernels: int
    operations: float
    read: float
    written: float


def count(text: str, scenarios: int) -> list[Turn]:
    """Loops of a program with more than a few kernels, the largest first; the rest of the program as one called around."""
    computations = _computations(text)
    bodies = set(re.findall(r"body=%?([\w.\-]+)", text)) & computations.keys()
    fused = set(re.findall(r"(?:calls|to_apply|condition)=%?([\w.\-]+)", text))
    around = [x for name, lines in computations.items() if name not in bodies | fused for x in lines]
    turns = [_turn("", lines, computations, scenarios) for name, lines in computations.items() if name in bodies]
    turns = sorted((turn for turn in turns if turn.kernels > FEW), key=lambda turn: -turn.operations)
    named = [turn._replace(loop=f"loop {k}") for k, turn in enumerate(turns, 1)]
    return [*named, _turn("around", around, computations, scenarios)]


def _computations(text: str) -> dict[str, list[Instruction]]:
    found: dict[str, list[Instruction]] = {}
    lines: list[Instruction] = []
    for line in text.splitlines():
        if head := _COMPUTATION.match(line):
            lines = found.setdefault(head[1], [])
        elif match := _INSTRUCTION.match(line):
            root, name, shape, opcode, rest = match.groups()
            lines.append(Instruction(bool(root), name, _sizes(shape), opcode, rest))
    return found


def _sizes(shape: str) -> tuple[int, ...]:
    return tuple(math.prod(int(length) for length in lengths.split(",") if length) for lengths in _ARRAY.findall(shape))


def _turn(loop: str, lines: Sequence[Instruction], computations: dict[str, list[Instruction]], scenarios: int) -> Turn:
    kernels, totals = 0, [0, 0, 0]
    sizes = {x.name: sum(x.sizes) for x in lines}
    for line in lines:
        if line.opcode in NOTHING:
            continue
        kernels += 1
        called = re.search(r"calls=%?([\w.\-]+)", line.rest)
        if called:
            found = _fusion(computations[called[1]])
        else:
            part = line.opcode in ("dynamic-slice", "slice", "dynamic-update-slice")
            moved = sum(line.sizes) if line.opcode != "dynamic-update-slice" else sizes.get(line.operands[1], 0)
            work = 0 if line.opcode in FREE else sum(line.sizes)
            found = work, moved if part else sum(sizes.get(x, 0) for x in line.operands), moved
        totals = [total + number for total, number in zip(totals, found, strict=True)]
    return Turn(loop, kernels, *(total / scenarios for total in totals))


def _fusion(lines: list[Instruction]) -> tuple[int, int, int]:
    """Operations, numbers read and numbers written of a fused loop: of what it takes parts of, the parts."""
    by_name = {x.name: x for x in lines}
    users: dict[str, list[Instruction]] = {x.name: [] for x in lines}
    for line in lines:
        for name in line.operands:
            users.get(name, []).append(line)
    operations = sum(COST.get(x.opcode, 1) * sum(x.sizes) for x in lines if x.opcode not in FREE)
    read = 0
    for line in lines:
        if line.opcode == "parameter":
            parts = [_read(line.name, user) for user in users[line.name]]
            read += sum(line.sizes) if None in parts else min(sum(line.sizes), sum(filter(None, parts)))
    root = next(x for x in lines if x.root)
    ends = [by_name[name] for name in root.operands] if root.opcode == "tuple" else [root]
    written = sum(sum(by_name[x.operands[1]].sizes) if x.opcode == "dynamic-update-slice" else sum(x.sizes) for x in ends)
    return operations, read, written


def _read(name: str, user: Instruction) -> int | None:
    """Numbers that a user of an array reads of it; None if that is all of it."""
    if user.opcode in ("slice", "dynamic-slice"):
        return sum(user.sizes)
    return 0 if user.opcode == "dynamic-update-slice" and user.operands[0] == name else None
