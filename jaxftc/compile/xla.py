"""Options of XLA, which no other file knows; ``jit.py`` compiles with them.

With its default options XLA:CPU runs a step of many small operations several times slower than it can. Three things mend
that: the barriers of ``numerics/barrier.py``, which XLA strips unless told not to; loops with several results; and, for a
single arm, one function in place of a thousand loops. Every option is tried once, on a tiny program, before it is used. One
that this XLA refuses, or that no longer has its effect, is left out: programs then run slower, with the same results, and
one warning says so. Devices other than a CPU compile as they come.
"""

from __future__ import annotations

import functools
import os
import warnings
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.experimental.xla_metadata import set_xla_metadata


class Option(NamedTuple):
    """An option of XLA's CPU compiler, seen to work with the jaxlib named."""

    name: str
    value: str | int  # or bool
    seen: str
    without: str  # what goes without it


STORE = Option(
    "xla_disable_hlo_passes",
    # The first pass strips barriers before loops are fused; the second takes small loops a way that knows no barriers.
    "cse_barrier_expander,small-while-loop-hoisting",
    "0.9.2 to 0.12.0",
    "batches of scenarios run about four times slower",
)
ONE_FUNCTION = Option("xla_disable_hlo_passes", "call-inliner", "0.9.2 to 0.12.0", "single arms run about five times slower")
VECTORS = Option(
    "xla_cpu_prefer_vector_width",
    512,  # bits, where the processor has them; XLA stops at 256
    "0.9.2 to 0.12.0",
    "batches of scenarios run about a tenth slower",
)
SEVERAL_RESULTS = Option(  # of a loop; read from XLA_FLAGS only
    "xla_backend_extra_options",
    "xla_cpu_use_multi_output_fusion=true",
    "0.9.2 to 0.12.0",
    "batches of scenarios run about a sixth slower, gradients by half",
)


OLD_EMITTERS = Option(
    "xla_cpu_use_fusion_emitters",
    False,
    "0.9.2 to 0.10.1, gone in 0.11.2, where nothing is lost without it",
    "before jaxlib 0.11.2, MJX in a batch runs three hundred times slower",
)
Kind = Literal["batch", "one arm", "mjx"]

FLAGS = (STORE, SEVERAL_RESULTS)  # what can be said to all programs of a process
# Before this one XLA ends the process on some programs whose loops have several results; MJX in a batch is one of them.
SEVERAL_RESULTS_SAFE = (0, 12)


def configure_xla(*, several_results: bool | None = None) -> None:
    """Compile every program of this process as the library compiles its own: your ``jax.jit``, ``vmap`` and ``grad`` too.

    Adds to ``XLA_FLAGS``, which JAX reads once, when it is first used: call it before that, and choose devices
    (``jax.config.update("jax_num_cpu_devices", ...)``) before it. Calling it again changes nothing.

    Args:
        several_results: Let a loop have several results, which makes batches faster, gradients by half. By default from
            jaxlib 0.12 on: before, XLA ends the process on some programs, those of MJX among them. Programs of the chain
            are safe on all versions, but take longer to compile for a single arm (11 s for the PUMA 560, 3 s without).

    Raises:
        RuntimeError: JAX is already in use and has read its flags.
    """
    before = os.environ.get("XLA_FLAGS", "")
    if several_results is None:
        several_results = jax.__version_info__ >= SEVERAL_RESULTS_SAFE
    os.environ["XLA_FLAGS"] = functools.reduce(with_flag, FLAGS if several_results else (STORE,), before)
    if jax.default_backend() == "cpu" and not _keeps_barriers({}) and _keeps_barriers({STORE.name: STORE.value}):
        os.environ["XLA_FLAGS"] = before
        raise RuntimeError(
            "configure_xla() came after JAX was first used, when XLA_FLAGS had been read; call it before JAX runs anything"
        )


def with_flag(flags: str, option: Option) -> str:
    """``XLA_FLAGS`` with an option added to the list that it may already hold."""
    own = str(option.value).split(",")
    return _with_values(flags, option.name, lambda listed: [*listed, *(value for value in own if value not in listed)])


def without_flag(flags: str, option: Option) -> str:
    """``XLA_FLAGS`` without an option that was added, for a child process that is to go without."""
    own = str(option.value).split(",")
    return _with_values(flags, option.name, lambda listed: [value for value in listed if value not in own])


def _with_values(flags: str, name: str, change: Callable[[list[str]], list[str]]) -> str:
    start = f"--{name}="
    words = [word for word in flags.split() if not word.startswith(start)]
    listed = [value for word in flags.split() if word.startswith(start) for value in word.removeprefix(start).split(",")]
    values = change([value for value in listed if value])
    return " ".join([*words, *([start + ",".join(values)] if values else [])])


@functools.cache
def options(kind: Kind = "batch") -> dict[str, str | int]:
    """Compiler options for the default backend; empty where nothing is known."""
    if jax.default_backend() != "cpu":
        return {}
    found: dict[str, str | int] = {}
    for option, works in _TABLE[kind]:
        if works({option.name: option.value}):
            found[option.name] = option.value
        elif option is not OLD_EMITTERS:
            warn(f"XLA's option {option.name}={option.value} has no effect")
    return found


def warn(what: str) -> None:
    """Say that programs run slower, and why."""
    warnings.warn(
        f"{what} with JAX {jax.__version__} (seen to work with {STORE.seen}): programs give the same results and "
        f"run slower, {STORE.without}, {ONE_FUNCTION.without}",
        RuntimeWarning,
        stacklevel=2,
    )


def _compiles(settings: dict[str, str | int]) -> bool:
    return _text(lambda x: x + 1, settings) is not None


def _keeps_barriers(settings: dict[str, str | int]) -> bool:
    text = _text(lambda x: lax.optimization_barrier(x + 1) * 2, settings)
    return text is not None and "opt-barrier" in text


def _keeps_calls(settings: dict[str, str | int]) -> bool:
    text = _text(as_one_function(lambda x: jnp.tanh(x) + 1), settings)
    return text is not None and any(" call(" in line and "xla_cpu_small_call" in line for line in text.splitlines())


def _text(fun: Callable[[Any], Any], settings: dict[str, str | int]) -> str | None:
    """What XLA makes of a function of a few numbers; None if it refuses the settings."""
    try:
        return jax.jit(fun, compiler_options=settings).lower(jnp.zeros(6)).compile().as_text()
    except jax.errors.JaxRuntimeError:
        return None


_TABLE: dict[Kind, tuple[tuple[Option, Callable[[dict[str, str | int]], bool]], ...]] = {
    "batch": ((STORE, _keeps_barriers), (VECTORS, _compiles)),
    "one arm": ((ONE_FUNCTION, _keeps_calls),),
    "mjx": ((OLD_EMITTERS, _compiles),),
}


def as_one_function(fun: Callable[..., Any]) -> Callable[..., Any]:
    """``fun``, marked for XLA:CPU to become one function, the loop over time included.

    Right for a single arm: calling a loop over a few numbers costs more than it does. The function takes arrays by position.
    """

    @functools.wraps(fun)
    def call(*args: Any) -> Any:
        with set_xla_metadata(xla_cpu_small_call="true"):
            return jax.jit(fun)(*args)

    return call
