"""A program as XLA will see it: one flat list of operations, calls inlined, the same operation done once."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Literal

UNROLLED = 64  # terms of a sum over leading axes that is written out, so that it can be fused

INLINED = {"pjit", "jit", "closed_call", "checkpoint", "remat", "remat2", "custom_jvp_call", "custom_vjp_call"}
PARTS, JOINS = {"slice", "split", "unstack"}, {"concatenate", "stack"}
FREE = {"broadcast_in_dim", "reshape", "squeeze", "expand_dims", "copy", "convert_element_type", "bitcast_convert_type"}
FREE |= {"stop_gradient"} | PARTS
COST = {"div": 4, "sqrt": 4, "rsqrt": 4, "rem": 6, "exp": 8, "exp2": 8, "expm1": 10, "log": 10, "log1p": 15, "tanh": 12}
COST |= {"logistic": 12, "erf": 15, "sin": 20, "cos": 20, "tan": 30, "erf_inv": 25, "pow": 30, "atan2": 30}
SUMS: dict[str, Callable[[Any, Any], Any]] = {
    "reduce_sum": lax.add,
    "reduce_prod": lax.mul,
    "reduce_max": lax.max,
    "reduce_min": lax.min,
    "reduce_or": lax.bitwise_or,
    "reduce_and": lax.bitwise_and,
}
FUSED = {"add", "add_any", "sub", "mul", "neg", "sign", "abs", "floor", "ceil", "round", "max", "min", "clamp", "square"}
FUSED |= {"integer_pow", "select_n", "eq", "ne", "lt", "le", "gt", "ge", "and", "or", "xor", "not", "is_finite"}
FUSED |= {"shift_left", "shift_right_logical", "shift_right_arithmetic", "reduce_precision", "nextafter"}
FUSED |= COST.keys() | FREE | SUMS.keys()
ELEMENTWISE = FUSED - FREE - SUMS.keys() | {"convert_element_type", "bitcast_convert_type", "copy", "stop_gradient"}
INNER = {"scan", "shard_map"}  # what has a program of its own inside


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


class Flat:
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
            if eqn.primitive.name in INLINED:
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
        stored, cost = name not in FUSED, COST.get(name, 0 if name in FREE else 1)
        if name in SUMS:
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


def _leading(axes: Sequence[int], shape: Sequence[int]) -> bool:
    """True for a short sum that leaves the last axis alone, over one axis at least."""
    return bool(axes) and len(shape) - 1 not in axes and 0 < math.prod(shape[axis] for axis in axes) <= UNROLLED
