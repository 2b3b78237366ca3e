"""Functions on their way to XLA: planned, or made one function."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
from jax.core import Tracer
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend.core import ClosedJaxpr

from jaxftc.fusion.evaluate import evaluate
from jaxftc.fusion.plan import Program, plan
from jaxftc.fusion.program import FUSED, JOINS

LARGEST = 5_000  # operations in one function: the time to compile it grows faster than its size
# What one function can hold.
_PLAIN = {"scan", "pad", "iota", "transpose", "rev", "dynamic_slice", "dot_general"} | JOINS | FUSED
_PLAIN |= {"random_bits", "random_fold_in", "random_wrap", "random_unwrap"}


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


def _extent(program: Program) -> float:
    """Operations of a program with its loops; infinite where one cannot be part of one function."""
    if any(step.primitive.name not in _PLAIN for step in program.steps):
        return math.inf
    return len(program.steps) + sum(map(_extent, program.bodies.values()))
