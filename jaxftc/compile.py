"""The one place where functions are compiled by this library.

On the CPU, XLA's own way makes a step of many small operations 20 to 140 times slower than need be. There are two ways out
(``fusion``), by the size of what a program is given. Programs on large arrays are fenced; the pass that strips fences
before XLA fuses is switched off, and so is XLA's own way with small loops, which knows no fences. Programs on small arrays,
single arms first of all, have little to gain from vector units: they become one function, which only XLA's older code path
can emit. Options are set per compilation, and only where the installed XLA knows them; other backends compile as they do.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import os
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer

from jaxftc.fusion.rewrite import planned, whole
from jaxftc.kept import across_processes

SMALL = 128  # elements of an array with more than one axis; vectors of parameters do not count
_WHOLE = {"xla_cpu_use_fusion_emitters": False, "xla_disable_hlo_passes": "call-inliner"}
_PLANNED = {
    # The first would make one of what is written out for several loops; the others: see above.
    "xla_disable_hlo_passes": "cse,cse_barrier_expander,small-while-loop-hoisting",
    "xla_cpu_prefer_vector_width": 512,  # bits, where the processor has them; XLA stops at 256
}
# The pass that hands parts of large loops to other cores, and then waits for them.
_ALONE = "cpu-parallel-task-assigner"


@functools.cache
def compiler_options(*, small: bool = False, alone: bool = False) -> dict[str, Any]:
    """Options for the default backend: empty where they are unknown, so that nothing breaks.

    A program that runs ``alone`` on its core, others like it beside it, is not spread over cores.
    """
    options = dict(_WHOLE if small else _PLANNED)
    if alone:
        options["xla_disable_hlo_passes"] += f",{_ALONE}"
    if jax.default_backend() != "cpu":
        return {}
    try:
        jax.jit(lambda x: x + 1, compiler_options=options).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return {}
    return options


def jit(fun: Callable[..., Any], *, origin: str | None = None, alone: bool = False, **kwargs: Any) -> Any:
    """``jax.jit`` as said above; what is needed is made at the first call, so that importing starts no backend.

    With an ``origin``, a text that tells what ``fun`` closes over, its programs outlive the process (``kept.py``); all
    arguments are arrays then, given by position, and there are no ``kwargs``. ``alone`` is for programs that run one a core.

    Plan and options belong to the outermost ``jit``: under a trace of the caller's, ``fun`` becomes part of it. That holds
    for ``jax.grad`` and ``jax.vmap`` called from Python too, where it compiles without them: wrap those in this ``jit``.
    """
    plain = jax.jit(fun, **kwargs)

    @functools.cache
    def by_size(small: bool) -> Any:
        jitted = _jitted(fun, small, alone, **kwargs)
        name = repr((fun.__module__, fun.__qualname__, small, alone, origin))
        return jitted if origin is None else across_processes(jitted, name)

    @functools.wraps(fun)
    def call(*args: Any, **call_kwargs: Any) -> Any:
        if is_tracing(args, call_kwargs):
            return plain(*args, **call_kwargs)
        with _no_collecting():
            return by_size(_small(args, call_kwargs))(*args, **call_kwargs)

    return call


def ahead(fun: Callable[..., Any], *examples: Any) -> Any:
    """A program for one arm, compiled now for arguments like the examples: calls cost less than those of ``jit``."""
    with _no_collecting():
        return _jitted(fun, small=True).lower(*examples).compile()


def _jitted(fun: Callable[..., Any], small: bool, alone: bool = False, **kwargs: Any) -> Any:
    options = compiler_options(small=small, alone=alone)
    way = (whole if small else planned) if options else lambda fun: fun
    return jax.jit(way(fun), compiler_options=options, **kwargs)


def _small(*values: object) -> bool:
    """True for arguments of a small program.

    None is one where loops may have several results: one function of a few scenarios then compiles for many minutes.
    """
    if "xla_cpu_use_multi_output_fusion=true" in os.environ.get("XLA_FLAGS", ""):
        return False
    return all(leaf.size <= SMALL for leaf in jax.tree.leaves(values) if getattr(leaf, "ndim", 0) > 1)


def is_tracing(*values: object) -> bool:
    """True inside a caller's ``jit`` (where even a constant is traced) or where a value is a tracer."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values)) or isinstance(jnp.zeros(()), Tracer)


@contextlib.contextmanager
def _no_collecting() -> Iterator[None]:
    """Python's garbage collector off, for a call that may compile: looking through young objects is half of tracing."""
    if not gc.isenabled():  # by the caller, or by another thread that traces and will switch it on again
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
