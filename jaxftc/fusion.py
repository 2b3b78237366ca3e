"""What XLA's CPU compiler is told of a program before it compiles it: where not to fuse, or to make one function of it.

Large arrays: XLA turns a step of thousands of small operations into loops ("fusions") and draws the arithmetic of a value
into every loop that uses it. In rigid-body recursions, and more so in their reverse mode, that repeats whole recursions for
each of their results; and a loop that writes the parts of a concatenated array one after the other is not vectorised.
``planned`` counts what would be repeated, and puts a fence behind every value that is cheaper to store than to compute
again, on both sides of every array that is put together from parts, and behind every array that is computed and then taken
apart (a loop that computes what it takes parts of is not vectorised either). A fence is ``jax.lax.optimization_barrier``: it
changes numbers by rounding only. CPU compilers strip barriers before they fuse, unless told not to (``compile.py``). A plan
is made for each loop body and is good for one set of shapes. What is around a loop over time is taken to cost little beside
it, and gets few fences.

Small arrays: calling a loop takes longer than running it. ``whole`` marks the program as a small call, which XLA emits as
one function, loops over time included.

Nothing here knows robots.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import lax
from jax.core import Tracer
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend.core import ClosedJaxpr, Literal
from jax.sharding import PartitionSpec

STORE = 12_000.0  # element operations that storing a value and reading it back is worth, with the call of one more loop
ONCE = 1e5  # the same around a loop over time, where compiling one more loop takes longer than what it saves
LONGEST = 300.0  # operations in one loop: longer ones run out of registers and compile slowly
LARGEST = 5_000  # operations in one function: the time to compile it grows faster than its size
LARGE = 100_000  # elements of a loop's results that are worth to be kept from turn to turn of a loop around it
UNROLLED = 64  # terms of a sum over leading axes that is written out, so that it can be fused

_INLINED = {"pjit", "jit", "closed_call", "checkpoint", "remat", "remat2", "custom_jvp_call", "custom_vjp_call"}
_PARTS, _JOINS = {"slice", "split", "unstack"}, {"concatenate", "stack"}
_FREE = {"broadcast_in_dim", "reshape", "squeeze", "expand_dims", "copy", "convert_element_type", "bitcast_convert_type"}
_FREE |= {"stop_gradient"} | _PARTS
_COST = {"div": 4, "sqrt": 4, "rsqrt": 4, "rem": 6, "exp": 8, "exp2": 8, "expm1": 10, "log": 10, "log1p": 15, "tanh": 12}
_COST |= {"logistic": 12, "erf": 15, "sin": 20, "cos": 20, "tan": 30, "erf_inv": 25, "pow": 30, "atan2": 30}
_SUMS: dict[str, Callable[[Any, Any], Any]] = {
    "reduce_sum": lax.add,
    "reduce_prod": lax.mul,
    "reduce_max": lax.max,
    "reduce_min": lax.min,
    "reduce_or": lax.bitwise_or,
    "reduce_and": lax.bitwise_and,
}
_FUSED = {"add", "add_any", "sub", "mul", "neg", "sign", "abs", "floor", "ceil", "round", "max", "min", "clamp", "square"}
_FUSED |= {"integer_pow", "select_n", "eq", "ne", "lt", "le", "gt", "ge", "and", "or", "xor", "not", "is_finite"}
_FUSED |= {"shift_left", "shift_right_logical", "shift_right_arithmetic", "reduce_precision", "nextafter"}
_FUSED |= _COST.keys() | _FREE | _SUMS.keys()
# What one function can hold.
_PLAIN = {"scan", "pad", "iota", "transpose", "rev", "dynamic_slice", "dot_general"} | _JOINS | _FUSED
_PLAIN |= {"random_bits", "random_fold_in", "random_wrap", "random_unwrap"}


class Step(NamedTuple):
    """One operation of the flat program; values are numbered."""

    primitive: Any
    params: dict[str, Any]
    inputs: tuple[Any, ...]  # numbers of values, or constants
    outputs: tuple[int, ...]
    size: int  # elements of the largest output
    cost: float  # operations for each of them
    stored: bool  # computed on its own, whatever is planned


class Value(NamedTuple):
    """A constant among the inputs of a step."""

    value: Any

    @property
    def key(self) -> tuple[Any, ...]:
        """The same for the same number of the same type; arrays are the same only if they are one."""
        if np.ndim(self.value):
            return (id(self.value),)
        kind = self.value.dtype if hasattr(self.value, "dtype") else type(self.value)
        return kind, str(self.value)


class Program(NamedTuple):
    """A program without calls: what runs, in order, and behind which steps there is a fence."""

    inputs: tuple[int, ...]
    steps: tuple[Step, ...]
    outputs: tuple[Any, ...]
    loops: tuple[tuple[int, ...], ...]  # positions of the steps of each, in order: the last is kept, the rest is its own
    fenced: frozenset[int]
    cut: frozenset[int]  # values that parts are taken of
    bodies: dict[int, Program]  # of the loops among the steps


def planned(fun: Callable[..., Any]) -> Callable[..., Any]:
    """``fun`` with fences; same arguments, same results. To be traced by ``jax.jit``: what is no tracer there is static."""
    return _rewritten(fun, lambda traced, values: evaluate(plan(traced), values))


def whole(fun: Callable[..., Any]) -> Callable[..., Any]:
    """``fun`` as one function where that can be, and as it is where it cannot; used like ``planned``."""

    def run(traced: ClosedJaxpr, values: list[Any]) -> list[Any]:
        program = plan(traced, fences=False)
        if _extent(program) > LARGEST:
            return evaluate(program, values)
        with set_xla_metadata(xla_cpu_small_call="true"):
            return jax.jit(lambda *inner: evaluate(program, inner))(*values)

    return _rewritten(fun, run)


def _rewritten(fun: Callable[..., Any], run: Callable[[ClosedJaxpr, list[Any]], list[Any]]) -> Callable[..., Any]:
    @functools.wraps(fun)
    def call(*args: Any, **kwargs: Any) -> Any:
        leaves, tree = jax.tree.flatten((args, kwargs))
        traced = [k for k, leaf in enumerate(leaves) if isinstance(leaf, Tracer)]

        def inner(*values: Any) -> Any:
            filled = dict(enumerate(leaves)) | dict(zip(traced, values, strict=True))
            args, kwargs = jax.tree.unflatten(tree, filled.values())
            return fun(*args, **kwargs)

        values = [leaves[k] for k in traced]
        program, shape = jax.make_jaxpr(inner, return_shape=True)(*values)
        return jax.tree.unflatten(jax.tree.structure(shape), run(program, values))

    return call


def plan(traced: ClosedJaxpr, *, fences: bool = True, repeated: bool = False) -> Program:
    """Flatten the program, leave out what nothing uses, and choose the fences; ``repeated`` is what a loop runs."""
    flat = _Flat(len(traced.jaxpr.invars))
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
        if step.primitive.name in _BODIES:
            inner = step.params["jaxpr"]
            inner = inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ())
            bodies[k] = plan(inner, fences=fences, repeated=repeated or step.primitive.name == "scan")
    around = bool(bodies) and not repeated
    cut = _cut(kept) if fences and not around else frozenset()
    chosen = frozenset(_fences(kept, outputs, cut, around)) if fences else frozenset()
    loops = _loops(kept, outputs, chosen) if fences else ((k,) for k in range(len(kept)))
    return Program(inputs, tuple(kept), outputs, tuple(loops), chosen, cut, bodies)


def _extent(program: Program) -> float:
    """Operations of a program with its loops; infinite where one cannot be part of one function."""
    if any(step.primitive.name not in _PLAIN for step in program.steps):
        return math.inf
    return len(program.steps) + sum(map(_extent, program.bodies.values()))


class _Flat:
    """A program while it is flattened: calls inlined, the same operation on the same values done once."""

    def __init__(self, count: int) -> None:
        self.count, self.steps, self.seen = count, [], {}  # values so far; steps; outputs of what was done

    def follow(self, traced: ClosedJaxpr, args: Sequence[Any]) -> list[Any]:
        """Append the program's steps; its outputs."""
        jaxpr = traced.jaxpr
        values: dict[Any, Any] = dict(zip(jaxpr.constvars, map(Value, traced.consts), strict=True))
        values |= zip(jaxpr.invars, args, strict=True)

        def read(variable: Any) -> Any:
            return Value(variable.val) if isinstance(variable, Literal) else values[variable]

        for eqn in jaxpr.eqns:
            inputs = tuple(read(v) for v in eqn.invars)
            if eqn.primitive.name in _INLINED:
                inner = next(eqn.params[key] for key in ("jaxpr", "call_jaxpr", "fun_jaxpr") if key in eqn.params)
                outputs = self.follow(inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ()), inputs)
            elif eqn.primitive.name == "name":  # what a checkpoint's policy goes by: done with
                outputs = inputs
            else:
                outputs = self.append(eqn, inputs)
            values |= zip(eqn.outvars, outputs, strict=True)
        return [read(v) for v in jaxpr.outvars]

    def append(self, eqn: Any, inputs: tuple[Any, ...]) -> Sequence[int]:
        """Append an operation, unless it has been done; its outputs."""
        name, params = eqn.primitive.name, eqn.params
        stored, cost = name not in _FUSED, _COST.get(name, 0 if name in _FREE else 1)
        if name in _SUMS:
            shape = eqn.invars[0].aval.shape
            stored, cost = not _leading(params["axes"], shape), math.prod(shape[axis] for axis in params["axes"]) - 1
        key = None if stored else (name, str(params), tuple(x if isinstance(x, int) else x.key for x in inputs))
        if key is None or key not in self.seen:
            outputs = range(self.count, self.count + len(eqn.outvars))
            size = max((math.prod(getattr(v.aval, "shape", ())) for v in eqn.outvars), default=0)
            self.steps.append(Step(eqn.primitive, params, inputs, tuple(outputs), size, cost, stored))
            self.count += len(outputs)
            self.seen[key] = outputs
            return outputs
        return self.seen[key]


def _cut(steps: Sequence[Step]) -> frozenset[int]:
    """Values that parts are taken of, views of them included."""
    cut: set[int] = set()
    for step in reversed(steps):
        name = step.primitive.name
        if name in _PARTS or (name in _FREE and cut.intersection(step.outputs)):
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
    free = [step.primitive.name in _FREE for step in steps]

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
    return fenced if around else fenced | {k for k, step in enumerate(steps) if step.primitive.name in _JOINS}


def _loops(steps: Sequence[Step], outputs: Sequence[Any], fenced: frozenset[int]) -> Iterator[tuple[int, ...]]:
    """Loops that end in what is fenced, returned or computed on its own; what is none of it is part of all that use it."""
    maker = {output: k for k, step in enumerate(steps) for output in step.outputs}
    ends = fenced | {maker[x] for x in outputs if isinstance(x, int) and x in maker}
    loops: list[set[int]] = []
    for k, step in enumerate(steps):
        before = (loops[maker[x]] for x in step.inputs if isinstance(x, int) and x in maker)
        loop = {k}.union(*before)
        if k in ends or step.stored:
            yield tuple(sorted(loop))
            loop = set()
        loops.append(loop)


def evaluate(program: Program, args: Sequence[Any]) -> list[Any]:
    """The results of a program."""
    return _run(program, args, {})[0]


def _run(program: Program, args: Sequence[Any], stacks: dict[int, list[Any]]) -> tuple[list[Any], dict[int, list[Any]]]:
    """The results of a program, and what its loops left in their ``stacks`` (see ``_stacks``)."""
    values: dict[int, Any] = dict(zip(program.inputs, args, strict=True))
    left = {}
    for loop in program.loops:
        own: dict[int, Any] = {}
        for k in loop:
            step = program.steps[k]
            given = [x.value if isinstance(x, Value) else own[x] if x in own else values[x] for x in step.inputs]
            if k in program.bodies:
                results, filled = _BODIES[step.primitive.name](step.params, program.bodies[k], given, stacks.get(k, []))
                left |= {k: filled} if filled else {}
            else:
                results = _apply(step, given)
            own |= zip(step.outputs, map(lax.optimization_barrier, results) if k in program.fenced else results, strict=True)
        values |= {x: own[x] for x in program.steps[loop[-1]].outputs}
    return [x.value if isinstance(x, Value) else values[x] for x in program.outputs], left


def _apply(step: Step, inputs: list[Any]) -> list[Any]:
    name, params = step.primitive.name, step.params
    if name in _SUMS and not step.stored:
        return [functools.reduce(_SUMS[name], _rows(inputs[0], params["axes"]))]
    results = step.primitive.bind(*inputs, **params)
    return list(results) if step.primitive.multiple_results else [results]


def _scan(params: dict[str, Any], inner: Program, inputs: list[Any], stacks: list[Any]) -> tuple[list[Any], list[Any]]:
    consts, carried = params["num_consts"], params["num_carry"]
    cut = [value in inner.cut for value in inner.inputs[consts + carried :]]
    shapes = _stacks(inner)

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
    shapes, mesh = _stacks(inner), params["mesh"]
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


def _stacks(program: Program) -> dict[int, list[tuple[tuple[int, ...], Any]]]:
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
            each = [((shards, *shape), dtype) for some in _stacks(inner).values() for shape, dtype in some]
        plain = all(isinstance(dtype, np.dtype) for _, dtype in each)  # no random keys
        if plain and sum(math.prod(shape) for shape, _ in each) >= LARGE:
            found[k] = each
    return found


def _leading(axes: Sequence[int], shape: Sequence[int]) -> bool:
    """True for a short sum that leaves the last axis alone."""
    return len(shape) - 1 not in axes and 0 < math.prod(shape[axis] for axis in axes) <= UNROLLED


def _rows(x: Any, axes: Sequence[int]) -> list[Any]:
    rows = [x]
    for axis in sorted(axes, reverse=True):
        rows = [lax.squeeze(part, [axis]) for row in rows for part in lax.split(row, [1] * row.shape[axis], axis)]
    return rows
