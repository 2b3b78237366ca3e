"""A planned program, run or traced again."""

from __future__ import annotations

import collections
import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jax import lax
from jax.sharding import PartitionSpec

from jaxftc.fusion.plan import Program
from jaxftc.fusion.program import ELEMENTWISE, SUMS, Step, Value

LARGE = 100_000  # elements of a loop's results that are worth to be kept from turn to turn of a loop around it


def evaluate(program: Program, args: Sequence[Any]) -> list[Any]:
    """The results of a program."""
    return _run(program, args, {})[0]


def _run(program: Program, args: Sequence[Any], stacks: dict[int, list[Any]]) -> tuple[list[Any], dict[int, list[Any]]]:
    """The results of a program, and what its loops left in their ``stacks`` (see ``stack_shapes``)."""
    values: dict[int, Any] = dict(zip(program.inputs, args, strict=True))
    left = {}
    for loop in program.loops:
        own: dict[int, Any] = {}
        inside = {x: program.steps[k] for k in loop if k not in program.fenced for x in program.steps[k].outputs}
        known = collections.ChainMap(own, values)
        parts = _Parts(inside, known)
        for k in loop:
            step = program.steps[k]
            given = [_value(x, known) for x in step.inputs]
            if k in program.bodies:
                results, filled = _BODIES[step.primitive.name](step.params, program.bodies[k], given, stacks.get(k, []))
                left |= {k: filled} if filled else {}
            elif step.primitive.name in SUMS and not step.stored:
                results = [functools.reduce(SUMS[step.primitive.name], parts.terms(step))]
            else:
                results = step.primitive.bind(*given, **step.params)
                results = list(results) if step.primitive.multiple_results else [results]
            own |= zip(step.outputs, map(lax.optimization_barrier, results) if k in program.fenced else results, strict=True)
        values |= {x: own[x] for x in program.steps[loop[-1]].outputs}
    return [_value(x, values) for x in program.outputs], left


def _scan(params: dict[str, Any], inner: Program, inputs: list[Any], stacks: list[Any]) -> tuple[list[Any], list[Any]]:
    consts, carried = params["num_consts"], params["num_carry"]
    cut = [value in inner.cut for value in inner.inputs[consts + carried :]]
    shapes = stack_shapes(inner)

    def body(state: tuple[list[Any], Any, list[Any]], given: tuple[Any, list[Any]]) -> tuple[Any, list[Any]]:
        (carry, own, stacks), (k, x) = state, given
        x = [lax.optimization_barrier(part) if parts else part for part, parts in zip(x, cut, strict=True)]
        results, own = _run(inner, [*inputs[:consts], *carry, *x], own)
        carry, y = results[:carried], results[carried:]
        if stacks:
            y, stacks = [], [lax.dynamic_update_index_in_dim(*pair, k, 0) for pair in zip(stacks, y, strict=True)]
        return (carry, own, stacks), y

    own = {k: [lax.full(shape, 0, dtype) for shape, dtype in each] for k, each in shapes.items()}
    state = inputs[consts : consts + carried], own, stacks
    named = {key: params[key] for key in ("length", "reverse", "unroll")}
    (carry, _, stacks), ys = lax.scan(body, state, (np.arange(params["length"]), inputs[consts + carried :]), **named)
    return [*carry, *(stacks or ys)], stacks


def _shard_map(params: dict[str, Any], inner: Program, inputs: list[Any], stacks: list[Any]) -> tuple[list[Any], list[Any]]:
    shapes, mesh = stack_shapes(inner), params["mesh"]
    spread = PartitionSpec(mesh.axis_names)

    def block(args: list[Any], stacks: list[Any]) -> tuple[Any, list[Any]]:
        rest = iter(stacks)
        own = {k: [next(rest)[0] for _ in each] for k, each in shapes.items()} if stacks else {}
        results, own = _run(inner, args, own)
        return tuple(results), [stack[None] for each in own.values() for stack in each]

    specs = {"in_specs": (list(params["in_specs"]), spread), "out_specs": (tuple(params["out_specs"]), spread)}
    results, stacks = jax.shard_map(block, mesh=mesh, check_vma=params["check_vma"], **specs)(inputs, stacks)
    return list(results), stacks


_BODIES = {"scan": _scan, "shard_map": _shard_map}  # what is planned inside, too


def stack_shapes(program: Program) -> dict[int, list[tuple[tuple[int, ...], Any]]]:
    """Shapes and types of what loops among the steps stack up, a row a turn: where it is worth it, by step.

    A loop starts from stacks of zeros. Within another loop (one level) it is handed those of the last turn, of which it
    overwrites all: zeros would be written anew in every turn.
    """
    found = {}
    for k, inner in program.bodies.items():
        params = program.steps[k].params
        if program.steps[k].primitive.name == "scan":
            rows = params["jaxpr"].out_avals[params["num_carry"] :]
            each = [((params["length"], *row.shape), row.dtype) for row in rows]
        else:
            shards = params["mesh"].size
            each = [((shards, *shape), dtype) for some in stack_shapes(inner).values() for shape, dtype in some]
        plain = all(isinstance(dtype, np.dtype) for _, dtype in each)  # no random keys
        if plain and sum(math.prod(shape) for shape, _ in each) >= LARGE:
            found[k] = each
    return found


class _Parts:
    """Parts of values along some axes: of what is computed in the same loop (``inside``), each computed on its own, once.

    XLA makes a function of a value that is computed and then taken apart, and where a loop has several results, such
    functions keep it from being vectorised.
    """

    def __init__(self, inside: Mapping[int, Step], values: Mapping[int, Any]) -> None:
        self._inside, self._values, self._found = inside, values, {}

    def terms(self, step: Step) -> list[Any]:
        """What a sum over leading axes adds up."""
        (x,), axes = step.inputs, sorted(step.params["axes"], reverse=True)
        shape = _value(x, self._values).shape
        every = itertools.product(*(range(shape[axis]) for axis in axes))
        return [self.part(x, dict(zip(axes, index, strict=True))) for index in every]

    def part(self, x: Any, at: dict[int, int]) -> Any:
        """A value at an index of each of some axes, without those; an axis of length 1 stands for one of any length."""
        if isinstance(x, Value):
            return self._part(x, at, None)
        key = x, *sorted(at.items())
        if key not in self._found:
            self._found[key] = self._part(x, at, self._inside.get(x))
        return self._found[key]

    def _part(self, x: Any, at: dict[int, int], step: Step | None) -> Any:
        value = _value(x, self._values)
        if np.ndim(value) == 0 or not at:
            return value
        if step is not None and step.primitive.name in ELEMENTWISE:
            return step.primitive.bind(*(self.part(y, at) for y in step.inputs), **step.params)
        shape = [length for axis, length in enumerate(value.shape) if axis not in at]
        if step is not None and step.primitive.name == "broadcast_in_dim" and len(step.inputs) == 1:
            axes = step.params["broadcast_dimensions"]
            inner = self.part(step.inputs[0], {axes.index(axis): k for axis, k in at.items() if axis in axes})
            left = [axis - sum(gone < axis for gone in at) for axis in axes if axis not in at]
            return lax.broadcast_in_dim(inner, shape, left)
        start = [min(at.get(axis, 0), length - 1) for axis, length in enumerate(value.shape)]
        stop = [k + 1 if axis in at else length for axis, (k, length) in enumerate(zip(start, value.shape, strict=True))]
        return lax.reshape(lax.slice(value, start, stop), shape)


def _value(x: Any, values: Mapping[int, Any]) -> Any:
    return x.value if isinstance(x, Value) else values[x]
