"""A traced function as a list of operations on single numbers: what a writer of code needs, and no more.

Arrays are unrolled and nested functions inlined; constants are folded, repeated operations done once, unused ones left out.
What is simplified is exact, but for the sign of a zero. Loops and tables that are indexed by data have no place here and are
refused by name. Only public attributes of JAX's programs are read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxftc.compile import box
from jaxftc.compile.operations import row

Places = np.ndarray  # of operations in the list, in the shape of the array that they stand for


class Operation(NamedTuple):
    """One number: how it is made, and where in the tick."""

    name: str  # a row of the table, "input" or "constant"
    args: tuple[int, ...]  # places of its operands; of an input which leaf and which number of it
    dtype: np.dtype
    of: np.dtype  # of its first operand
    value: Any = None  # of a constant
    box: str = ""


class Program(NamedTuple):
    """Operations in the order of the trace, and where each number of each result stands among them."""

    operations: list[Operation]
    results: list[Places]


def scalars(fun: Callable[..., Any], *examples: Any) -> Program:
    """``fun`` traced for arguments like the examples, pytrees of arrays; leaves in JAX's order.

    Raises:
        ValueError: it does what single numbers cannot: the message names the operation.
    """
    with box.marked():
        closed = jax.make_jaxpr(fun)(*examples)
    unrolled = _Unrolled()
    inputs = [unrolled.input(k, var.aval) for k, var in enumerate(closed.jaxpr.invars)]
    results = unrolled.run(closed.jaxpr, closed.consts, inputs)
    return _without_unused(unrolled.operations, results)


class _Unrolled:
    """The list while it grows."""

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self._known: dict[Any, int] = {}
        self._box: list[str] = [""]

    def input(self, leaf: int, aval: Any) -> Places:
        numbers = [self._place(Operation("input", (leaf, k), aval.dtype, aval.dtype)) for k in range(aval.size)]
        return np.array(numbers, int).reshape(aval.shape)

    def constants(self, value: Any) -> Places:
        array = np.asarray(value)
        return np.array([self.constant(number) for number in array.ravel()], int).reshape(array.shape)

    def constant(self, number: Any) -> int:
        return self._place(Operation("constant", (), number.dtype, number.dtype, number), number.tobytes())

    def run(self, jaxpr: Any, consts: Sequence[Any], inputs: Sequence[Places]) -> list[Places]:
        """Results of a program from those that go into it."""
        known: dict[Any, Places] = dict(zip(jaxpr.invars, inputs, strict=True))
        known |= zip(jaxpr.constvars, [self.constants(const) for const in consts], strict=True)

        def read(var: Any) -> Places:
            return self.constants(np.asarray(var.val, var.aval.dtype)) if hasattr(var, "val") else known[var]

        for eqn in jaxpr.eqns:
            made = self._apply(eqn, [read(var) for var in eqn.invars])
            known |= zip(eqn.outvars, made, strict=True)
        return [read(var) for var in jaxpr.outvars]

    def _apply(self, eqn: Any, args: list[Places]) -> Sequence[Places]:
        name, params = str(eqn.primitive.name), eqn.params
        if name in CALLS:
            return self._call(params, args)
        if name == "cond":
            return self._both(params["branches"], *args)
        if name in IDENTITIES:
            return args
        if name in SHAPES:
            made = SHAPES[name](params, *args)
            return made if isinstance(made, list) else [made]
        out, *others = eqn.outvars
        if others:  # a loop, most likely
            row(name, out.aval.dtype)
        shape, dtype = out.aval.shape, out.aval.dtype
        if name == "iota":
            line = np.arange(params["shape"][params["dimension"]], dtype=dtype)
            at = [-1 if axis == params["dimension"] else 1 for axis in range(len(params["shape"]))]
            return [self.constants(np.broadcast_to(line.reshape(at), params["shape"]))]
        if name == "dot_general":
            return [self._products(params["dimension_numbers"], *args)]
        if name in REDUCTIONS:
            return [self._reduce(REDUCTIONS[name], sorted(params["axes"], reverse=True), args[0])]
        plain = PLAIN.get(name, name)
        scalar = {
            "integer_pow": lambda x: self._power(x, params["y"]),
            "convert_element_type": lambda x: self._convert(x, dtype),
            "clamp": lambda low, x, high: self.make("min", self.make("max", x, low), high),
            "round": lambda x: self.make(("round_away", "round_even")[int(params["rounding_method"])], x),
            "select_n": self._select,
        }.get(name) or (lambda *numbers: self.make(plain, *numbers))
        spread = [np.broadcast_to(arg, shape) for arg in args]
        places = [scalar(*(int(arg[at]) for arg in spread)) for at in np.ndindex(shape)]
        return [np.array(places, int).reshape(shape)]

    def _call(self, params: dict[str, Any], args: list[Places]) -> Sequence[Places]:
        """A function within the function; one without results may be the mark of a box."""
        inner = next(params[key] for key in ("jaxpr", "call_jaxpr", "fun_jaxpr") if key in params)
        mark = str(params.get("name", ""))
        if mark.startswith(box.ENTER):
            self._box.append(mark.removeprefix(box.ENTER))
        elif mark == box.LEAVE:
            self._box.pop()
        return self.run(getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), args)

    def _both(self, branches: Sequence[Any], which: Places, *args: Places) -> list[Places]:
        """Two branches, both computed, and the results of one of them taken: code without a jump."""
        if len(branches) != 2:
            raise ValueError(f"cond of {len(branches)} branches has no row in the table of operations: branch by a bool")
        index = int(np.ravel(which)[0])
        operation = self.operations[index]
        converted = operation.name.startswith("to_") and self.operations[operation.args[0]].dtype == bool
        flag = operation.args[0] if converted else self.make("ne", index, self.constant(operation.dtype.type(0)))
        no, yes = (self.run(branch.jaxpr, branch.consts, list(args)) for branch in branches)
        shapes = [np.shape(a) for a in no]
        taken = [[self._select(flag, int(a), int(b)) for a, b in zip(np.ravel(x), np.ravel(y), strict=True)]
                 for x, y in zip(no, yes, strict=True)]  # fmt: skip
        return [np.array(places, int).reshape(shape) for places, shape in zip(taken, shapes, strict=True)]

    def _reduce(self, name: str, axes: Sequence[int], array: Places) -> Places:
        for axis in axes:
            first, *others = np.moveaxis(array, axis, 0)
            for other in others:
                pairs = [self.make(name, int(a), int(b)) for a, b in zip(np.ravel(first), np.ravel(other), strict=True)]
                first = np.array(pairs, int).reshape(np.shape(other))
            array = np.asarray(first)
        return array

    def _products(self, axes: Any, one: Places, other: Places) -> Places:
        """Sums of products over the axes that are contracted, in their order; axes that both keep come first."""
        (sums, other_sums), (both, other_both) = axes
        own, others = ([k for k in range(x.ndim) if k not in (*s, *b)] for x, s, b in (
            (one, sums, both), (other, other_sums, other_both)))  # fmt: skip
        a, b = one.transpose(*both, *own, *sums), other.transpose(*other_both, *others, *other_sums)
        a = a.reshape(*a.shape[: len(both) + len(own)], -1)
        b = b.reshape(*b.shape[: len(other_both) + len(others)], -1)
        a = np.expand_dims(a, tuple(len(both) + len(own) + k for k in range(len(others))))
        b = np.expand_dims(b, tuple(len(both) + k for k in range(len(own))))
        pairs = np.broadcast_arrays(a, b)
        made = np.vectorize(lambda x, y: self.make("mul", int(x), int(y)), otypes=[int])(*pairs)
        return self._reduce("add", [made.ndim - 1], made)

    def _power(self, x: int, exponent: int) -> int:
        if exponent < 0:
            one = self.constant(self.operations[x].dtype.type(1))
            return self.make("div", one, self._power(x, -exponent))
        if exponent == 0:
            return self.constant(self.operations[x].dtype.type(1))
        half = x if exponent < 2 else self._power(x, exponent // 2)
        squared = half if exponent < 2 else self.make("mul", half, half)
        return self.make("mul", squared, x) if exponent > 2 and exponent % 2 else squared

    def _convert(self, x: int, dtype: np.dtype) -> int:
        had = self.operations[x].dtype
        if had == dtype:
            return x
        return self.make(f"{'saturate' if had.kind == 'f' and dtype.kind == 'i' else 'to'}_{dtype.name}", x)

    def _select(self, which: int, *cases: int) -> int:
        if len(cases) != 2 or self.operations[which].dtype != bool:
            raise ValueError(f"select_n of {len(cases)} cases has no row in the table of operations: select by a bool")
        no, yes = cases
        return self.make("select", which, yes, no)

    def make(self, name: str, *args: int) -> int:
        """Where an operation's result stands: a new one only if it has to be."""
        operands = [self.operations[place] for place in args]
        simple = self._simplified(name, args, operands)
        if simple is not None:
            return simple
        of = operands[1 if name == "select" else 0].dtype
        entry = row(name, of)
        dtype = np.dtype(bool) if name in TO_BOOL else np.dtype(name.split("_")[1]) if name in CONVERSIONS else of
        if all(operand.name == "constant" for operand in operands):
            with np.errstate(all="ignore"):
                return self.constant(np.asarray(entry.fold(*(operand.value for operand in operands)), dtype)[()])
        key = tuple(sorted(args)) if entry.swaps else args
        return self._place(Operation(name, args, dtype, of), key)

    def _simplified(self, name: str, args: tuple[int, ...], operands: list[Operation]) -> int | None:
        """An operand that is the result itself, whatever it is, NaN and infinities included."""
        value = [operand.value for operand in operands]
        floats = operands[0].dtype.kind == "f"
        for a, b in ((0, 1), (1, 0)) if len(operands) == 2 else ():
            neutral = NEUTRAL.get(name)
            if neutral is not None and value[b] is not None and value[b] == neutral and (b == 1 or name not in ONE_SIDED):
                return args[a]
            if name == "mul" and floats and value[b] is not None and value[b] == -1:
                return self.make("neg", args[a])
        if name == "sub" and floats and value[0] is not None and value[0] == 0:
            return self.make("neg", args[1])
        if name in ("max", "min", "and", "or") and args[0] == args[1]:
            return args[0]
        if name in ("and", "or") and operands[0].dtype == bool:
            for a, b in ((0, 1), (1, 0)):
                if value[b] is not None:
                    return args[a] if bool(value[b]) == (name == "and") else args[b]
        if name == "select":
            if value[0] is not None:
                return args[1] if value[0] else args[2]
            return args[1] if args[1] == args[2] else None
        if name in ("neg", "not") and operands[0].name == name:
            return operands[0].args[0]
        return None

    def _place(self, operation: Operation, key: Any = None) -> int:
        key = (operation.name, operation.args if key is None else key, operation.dtype)
        if key not in self._known:
            self._known[key] = len(self.operations)
            self.operations.append(operation._replace(box=self._box[-1]))
        return self._known[key]


CALLS = ("jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "checkpoint", "remat")
IDENTITIES = ("optimization_barrier", "stop_gradient", "copy", "copy_p")
PLAIN = {"add_any": "add"}
REDUCTIONS = {
    "reduce_sum": "add",
    "reduce_prod": "mul",
    "reduce_max": "max",
    "reduce_min": "min",
    "reduce_or": "or",
    "reduce_and": "and",
}
TO_BOOL = ("eq", "ne", "lt", "le", "gt", "ge", "is_finite", "to_bool")
CONVERSIONS = ("to_float32", "to_float64", "to_int32", "to_int64", "saturate_int32", "saturate_int64")
NEUTRAL = {"add": 0, "sub": 0, "mul": 1, "div": 1}
ONE_SIDED = ("sub", "div")


def _spread(params: dict[str, Any], array: Places, *_: Any) -> Places:
    shape = [1] * len(params["shape"])
    for axis, size in zip(params["broadcast_dimensions"], array.shape, strict=True):
        shape[axis] = size
    return np.broadcast_to(array.reshape(shape), params["shape"])


def _cut(params: dict[str, Any], array: Places) -> Places:
    bounds = zip(params["start_indices"], params["limit_indices"], params["strides"] or [1] * array.ndim, strict=True)
    return array[tuple(slice(*bound) for bound in bounds)]


def _split(params: dict[str, Any], array: Places) -> list[Places]:
    return np.split(array, np.cumsum(params["sizes"])[:-1], params["axis"])


SHAPES: dict[str, Callable[..., Places | list[Places]]] = {  # what only moves numbers
    "broadcast_in_dim": _spread,
    "reshape": lambda params, array: array.reshape(params["new_sizes"]),
    "squeeze": lambda params, array: array.squeeze(tuple(params["dimensions"])),
    "transpose": lambda params, array: array.transpose(params["permutation"]),
    "concatenate": lambda params, *arrays: np.concatenate(arrays, params["dimension"]),
    "stack": lambda params, *arrays: np.stack(arrays, params["axis"]),
    "unstack": lambda params, array: list(np.moveaxis(array, params["axis"], 0)),
    "slice": _cut,
    "split": _split,
    "rev": lambda params, array: np.flip(array, params["dimensions"]),
}


def _without_unused(operations: list[Operation], results: list[Places]) -> Program:
    used = {int(place) for array in results for place in np.ravel(array)}
    for place in reversed(range(len(operations))):
        if place in used and operations[place].name != "input":
            used |= set(operations[place].args)
    order = {place: k for k, place in enumerate(sorted(used))}
    kept = []
    for place in sorted(used):
        operation = operations[place]
        own = operation.args if operation.name == "input" else tuple(order[arg] for arg in operation.args)
        kept.append(operation._replace(args=own))
    renamed = [np.array([order[int(p)] for p in np.ravel(array)], int).reshape(np.shape(array)) for array in results]
    return Program(kept, renamed)
