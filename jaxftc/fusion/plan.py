"""Where the fences are: what is cheaper to store than to compute again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from jax.extend.core import ClosedJaxpr

from jaxftc.fusion.program import FREE, INNER, JOINS, PARTS, Flat, Step

STORE = 12_000.0  # element operations that storing a value and reading it back is worth, with the call of one more loop
ONCE = 1e5  # the same around a loop over time, where compiling one more loop takes longer than what it saves
LONGEST = 300.0  # operations in one loop: longer ones run out of registers and compile slowly


class Program(NamedTuple):
    """A program without calls: what runs, in order, and behind which steps there is a fence."""

    inputs: tuple[int, ...]
    steps: tuple[Step, ...]
    outputs: tuple[Any, ...]
    loops: tuple[tuple[int, ...], ...]  # positions of the steps of each, in order: the last is kept, the rest is its own
    fenced: frozenset[int]
    cut: frozenset[int]  # values that parts are taken of
    bodies: dict[int, Program]  # of the loops among the steps


def plan(traced: ClosedJaxpr, *, fences: bool = True, repeated: bool = False) -> Program:
    """Flatten the program, leave out what nothing uses, and choose the fences; ``repeated`` is what a loop runs."""
    flat = Flat(len(traced.jaxpr.invars))
    inputs = tuple(range(flat.count))
    outputs = tuple(flat.follow(traced, inputs))
    used, kept = {x for x in outputs if isinstance(x, int)}, []
    for step in reversed(flat.steps):
        if used.intersection(step.outputs) or step.stored:
            kept.append(step)
            used.update(x for x in step.inputs if isinstance(x, int))
    kept.reverse()
    bodies = {}
    for k, step in enumerate(kept):
        if step.primitive.name in INNER:
            inner = step.params["jaxpr"]
            inner = inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ())
            bodies[k] = plan(inner, fences=fences, repeated=repeated or step.primitive.name == "scan")
    around = bool(bodies) and not repeated
    cut = _cut(kept) if fences and not around else frozenset()
    chosen = frozenset(_fences(kept, outputs, cut, around)) if fences else frozenset()
    repeat = fences and not around  # what runs once costs more to compile twice than to store
    loops = _loops(kept, outputs, chosen) if repeat else ((k,) for k in range(len(kept)))
    return Program(inputs, tuple(kept), outputs, tuple(loops), chosen, cut, bodies)


def _cut(steps: Sequence[Step]) -> frozenset[int]:
    """Values that parts are taken of, views of them included."""
    cut: set[int] = set()
    for step in reversed(steps):
        name = step.primitive.name
        if name in PARTS or (name in FREE and cut.intersection(step.outputs)):
            cut.update(x for x in step.inputs if isinstance(x, int))
    return frozenset(cut)


def _fences(steps: Sequence[Step], outputs: Sequence[Any], cut: frozenset[int], around: bool) -> set[int]:
    """Positions of the steps with a fence behind them; a program with a loop over time is what is ``around`` it.

    ``loops`` are the loops that a value would be drawn into: the fenced steps that use it, directly or through others.
    """
    store = ONCE if around else STORE
    maker = {output: k for k, step in enumerate(steps) for output in step.outputs}
    makers = [{maker[x] for x in step.inputs if isinstance(x, int) and x in maker} for step in steps]
    users: list[set[int]] = [set() for _ in steps]
    for k, some in enumerate(makers):
        for j in some:
            users[j].add(k)
    returned = {maker[x] for x in outputs if isinstance(x, int) and x in maker}
    stored = [step.stored for step in steps]
    free = [step.primitive.name in FREE for step in steps]

    readers: list[set[int]] = [set() for _ in steps]  # users behind views of the value; itself if it is a result
    for k in reversed(range(len(steps))):
        readers[k] = {k} if k in returned else set()
        for user in users[k]:
            readers[k] |= readers[user] if free[user] else {user}

    cone = [0.0] * len(steps)  # operations that the value takes from what is stored
    fenced = set()
    for k, step in enumerate(steps):
        cone[k] = step.cost + sum(0.5 if j in fenced or stored[j] else cone[j] for j in makers[k])
        if stored[k] or free[k]:
            continue
        repeated = (len(readers[k]) - 1) * cone[k] * step.size
        joined = any(stored[reader] for reader in readers[k]) and (not around or cone[k] * step.size > store)
        if repeated > store or cone[k] > LONGEST or joined or not cut.isdisjoint(step.outputs):
            fenced.add(k)

    loops: list[set[int]] = [set() for _ in steps]
    for k in reversed(range(len(steps))):
        loops[k] = {k} if k in returned else set()
        for user in users[k]:
            loops[k] |= {user} if user in fenced or stored[user] or user in returned else loops[user]
        lone = len(loops[k]) == 1 and cut.isdisjoint(steps[k].outputs)
        if k in fenced and lone and cone[k] <= LONGEST and not any(stored[u] for u in loops[k]):
            fenced.discard(k)  # its readers all end in one loop, which computes it once
    return fenced if around else fenced | {k for k, step in enumerate(steps) if step.primitive.name in JOINS}


def _loops(steps: Sequence[Step], outputs: Sequence[Any], fenced: frozenset[int]) -> Iterator[tuple[int, ...]]:
    """Loops that end in what is fenced, returned or computed on its own; what is none of it is part of all that use it."""
    maker = {output: k for k, step in enumerate(steps) for output in step.outputs}
    ends = fenced | {maker[x] for x in outputs if isinstance(x, int) and x in maker}
    ends |= {k for k, step in enumerate(steps) if step.stored}
    for k in sorted(ends):
        loop, left = {k}, [k]
        while left:
            makers = {maker[x] for x in steps[left.pop()].inputs if isinstance(x, int) and x in maker}
            left += makers - ends - loop
            loop |= makers - ends
        yield tuple(sorted(loop))
