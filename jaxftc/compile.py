"""The one place where functions are compiled by this library.

XLA's CPU fusion emitters make a step of many small operations 20 to 140 times slower than the older code path; they are
switched off per compilation, only on the CPU and only where the installed XLA knows the option.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer

_CPU_OPTIONS = {"xla_cpu_use_fusion_emitters": False}


@functools.cache
def compiler_options() -> dict[str, Any]:
    """Options for the default backend: empty where they are unknown, so that nothing breaks."""
    if jax.default_backend() != "cpu":
        return {}
    try:
        jax.jit(lambda x: x + 1, compiler_options=_CPU_OPTIONS).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return {}
    return _CPU_OPTIONS


def jit(fun: Callable[..., Any], **kwargs: Any) -> Any:
    """``jax.jit`` with the options above, looked up at the first call so that importing starts no backend.

    Options belong to the outermost ``jit``: under a trace of the caller's, ``fun`` becomes part of it. That holds for
    ``jax.grad`` and ``jax.vmap`` called from Python too, where it compiles without the options: wrap those in this ``jit``.
    """
    plain = jax.jit(fun, **kwargs)

    @functools.cache
    def compiled() -> Any:
        return jax.jit(fun, compiler_options=compiler_options(), **kwargs)

    @functools.wraps(fun)
    def call(*args: Any, **call_kwargs: Any) -> Any:
        target = plain if is_tracing(args, call_kwargs) else compiled()
        return target(*args, **call_kwargs)

    return call


def apart(*values: Any) -> Any:
    """The values as they are, but computed once and stored before they are used.

    XLA's CPU compiler draws the arithmetic of a producer into each of its users. In the reverse mode of the unrolled
    dynamics that repeats whole recursions for every entry of an array: a barrier at their inputs halves the time of a
    gradient through the closed loop. Compilers strip plain barriers before they fuse; they leave a branch alone whose
    condition they do not know and whose two sides differ in form. Other backends, and single arms, do without.
    """
    leaves, tree = jax.tree.flatten(values)
    if jax.default_backend() != "cpu" or leaves[0].ndim < 2:
        return values
    unknown = jax.lax.stop_gradient(leaves[0]).ravel()[0] < jnp.inf
    return jax.tree.unflatten(tree, jax.lax.cond(unknown, lambda *x: x, lambda *x: jax.lax.optimization_barrier(x), *leaves))


def is_tracing(*values: object) -> bool:
    """True inside a caller's ``jit`` (where even a constant is traced) or where a value is a tracer."""
    return isinstance(jnp.zeros(()), Tracer) or any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))
