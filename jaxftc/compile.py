"""dev version"""
from __future__ import annotations
import functools, os
from typing import Any
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jax.experimental.xla_metadata import set_xla_metadata

_LARGE = {
    "xla_disable_hlo_passes": os.environ.get("DEV_OFF","cse_barrier_expander,small-while-loop-hoisting"),
    "xla_cpu_prefer_vector_width": 512,
}
_SMALL = {"xla_disable_hlo_passes": "call-inliner"}
_ALONE = "cpu-parallel-task-assigner"
SMALL=128

@functools.cache
def compiler_options(*, small=False, alone=False):
    options = dict(_SMALL if small else _LARGE)
    if alone and not small: options["xla_disable_hlo_passes"] += f",{_ALONE}"
    for kv in os.environ.get("DEV_OPTS","").split():
        k,v=kv.split("="); options[k]=int(v) if v.isdigit() else (v=="true" if v in("true","false") else v)
    return options

def as_one_function(fun):
    @functools.wraps(fun)
    def call(*args, **kwargs):
        with set_xla_metadata(xla_cpu_small_call="true"):
            return jax.jit(lambda args: fun(*args, **kwargs))(args)
    return call

def jit(fun, *, origin=None, alone=False, one=False, **kwargs):
    plain = jax.jit(fun, **kwargs)
    static = kwargs.get("static_argnums", ())
    static = (static,) if isinstance(static,int) else static
    @functools.cache
    def by_size(small):
        if not small:
            return jax.jit(fun, compiler_options=compiler_options(alone=alone), **kwargs)
        def whole(*args):
            dyn=[a for k,a in enumerate(args) if k not in static]
            def inner(*dyn):
                it=iter(dyn)
                return fun(*[a if k in static else next(it) for k,a in enumerate(args)])
            with set_xla_metadata(xla_cpu_small_call="true"):
                return jax.jit(inner)(*dyn)
        return jax.jit(whole, compiler_options=compiler_options(small=True), **kwargs)
    @functools.wraps(fun)
    def call(*args, **kw):
        if is_tracing(args, kw):
            return plain(*args, **kw)
        return by_size(one)(*args, **kw)
    return call

def ahead(fun, *examples):
    def whole(*args):
        with set_xla_metadata(xla_cpu_small_call="true"):
            return jax.jit(fun)(*args)
    return jax.jit(whole, compiler_options=compiler_options(small=True)).lower(*examples).compile()

def _small(*values):
    return all(leaf.size <= SMALL for leaf in jax.tree.leaves(values) if getattr(leaf, "ndim", 0) > 1)

def is_tracing(*values):
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values)) or isinstance(jnp.zeros(()), Tracer)
