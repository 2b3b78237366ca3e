"""Functions as programs, compiled with the options of ``xla.py`` and kept by what they are called with."""

from __future__ import annotations

import contextlib
import functools
import gc
import logging
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer

from jaxftc.compile import program_cache, xla
from jaxftc.compile.xla import Kind

PATIENCE = 20.0  # s of compiling after which it is said
FULL = 0.8  # share of the memory maps that a process may have
MAPS, MOST_MAPS = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")  # a line a map; their number. On Linux
_log = logging.getLogger("jaxftc")


def ahead(fun: Callable[..., Any], *examples: Any) -> Any:
    """A program for one arm, compiled now for arguments like the examples: calls cost less than those of ``jit``."""
    return _program(fun, examples, kind="one arm")


def jit(
    fun: Callable[..., Any],
    *,
    kind: Kind = "batch",
    static_argnums: int | Sequence[int] = (),
    cached_as: str | None = None,
    like: Any = None,
    sharding: Any = None,
) -> Any:
    """``jax.jit`` with this library's options; arguments by position.

    Inside a caller's ``jit``, ``vmap`` or ``grad`` the function becomes part of the caller's program. With ``cached_as``, a
    text that tells all that ``fun`` closes over, and ``like``, a pytree with the structure of its results, a program that
    has run before is read from the cache and not traced again (``program_cache.py``), where there is a cache folder.

    Args:
        fun: A function of arrays, or of static values and arrays.
        kind: ``batch``, for scenarios side by side; ``one arm``, to be compiled as one function; ``mjx``, for programs with
            MJX inside.
        static_argnums: Positions of arguments that are fixed when tracing.
        cached_as: Name of the program across processes, see above.
        like: Structure of its results, see above.
        sharding: Of every argument and every result, where JAX is not to choose it.
    """
    static = (static_argnums,) if isinstance(static_argnums, int) else tuple(static_argnums)
    return _Jitted(fun, kind, static, cached_as, like, sharding)


class _Jitted:
    """What ``jit`` returns: programs by static values and by structure, shapes and types of the arrays."""

    def __init__(
        self,
        fun: Callable[..., Any],
        kind: Kind,
        static: tuple[int, ...],
        cached_as: str | None,
        like: Any,
        sharding: Any,
    ) -> None:
        functools.update_wrapper(self, fun)
        self._fun, self._static = fun, static
        self._kind: Kind = kind
        self._cached_as, self._like = cached_as, like
        self._shardings = {} if sharding is None else {"in_shardings": sharding, "out_shardings": sharding}
        self._inlined = jax.jit(fun, static_argnums=self._static)
        self._programs: dict[Any, Any] = {}
        self._lock = threading.Lock()
        _functions.add(self)

    def __call__(self, *args: Any) -> Any:
        """The function's results."""
        if is_tracing(args) or program_cache.setting("disable_jit"):
            return self._inlined(*args)
        static = tuple(args[k] for k in self._static)
        arrays = tuple(arg for k, arg in enumerate(args) if k not in self._static)
        leaves, tree = jax.tree.flatten(arrays)
        kind = (
            static,
            tree,
            program_cache.setting("enable_x64"),
            tuple((jax.typeof(leaf), _placement(leaf)) for leaf in leaves),
        )
        program = self._programs.get(kind)
        if program is None:
            with self._lock:  # threads that meet here need the same program
                program = self._programs.get(kind)
                if program is None:
                    program = self._programs[kind] = self._compile(static, arrays)
        return program(*arrays)

    def forget(self) -> None:
        """Drop all programs; they are compiled again when they are needed."""
        self._programs.clear()

    def _compile(self, static: tuple[Any, ...], arrays: tuple[Any, ...]) -> Callable[..., Any]:
        def fun(*arrays: Any) -> Any:
            fixed, rest = dict(zip(self._static, static, strict=True)), iter(arrays)
            count = len(static) + len(arrays)
            return self._fun(*(fixed[k] if k in fixed else next(rest) for k in range(count)))

        functools.update_wrapper(fun, self._fun)
        compiled = functools.partial(_program, kind=self._kind, **self._shardings)
        if self._cached_as is not None and program_cache.folder is not None:
            return program_cache.program(fun, arrays, f"{self._cached_as}{static}", self._like, compiled)
        return compiled(fun, arrays)


_functions: weakref.WeakSet[_Jitted] = weakref.WeakSet()


def _make_room() -> None:
    """Forget all programs where the process is about to run out of memory maps: then XLA would end it.

    A gradient of the closed loop takes two thousand maps, and Linux gives a process 65,530.
    """
    if not (MAPS.exists() and MOST_MAPS.exists()) or MAPS.read_bytes().count(b"\n") < FULL * int(MOST_MAPS.read_text()):
        return
    _log.info("forgetting compiled programs: the process has nearly all memory maps that it may have")
    for function in list(_functions):
        function.forget()
    jax.clear_caches()
    gc.collect()


def _program(fun: Callable[..., Any], examples: Sequence[Any], *, kind: Kind, **kwargs: Any) -> Any:
    """``fun`` compiled for arguments like the examples; plainly where XLA cannot do it with our options."""
    _make_room()
    with _said(getattr(fun, "__name__", "a program")):
        settings = xla.options(kind)
        if settings:
            marked = xla.as_one_function(fun) if kind == "one arm" else fun
            try:
                return jax.jit(marked, compiler_options=settings, **kwargs).lower(*examples).compile()
            except jax.errors.JaxRuntimeError as error:
                xla.warn(f"XLA could not compile {fun.__name__} with the library's options ({str(error).splitlines()[0]})")
        return jax.jit(fun, **kwargs).lower(*examples).compile()


@contextlib.contextmanager
def _said(name: str) -> Iterator[None]:
    """Say what is being compiled if that takes long."""
    message = f"compiling {name.strip('_')!r} for more than {PATIENCE:.0f} s; once for each arm, size and setting"
    timer = threading.Timer(PATIENCE, _log.warning, [message])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _placement(leaf: Any) -> Any:
    """Where an array lies, unless that is where JAX puts one by itself."""
    sharding = getattr(leaf, "sharding", None)
    return None if sharding is None or sharding.device_set == {jax.local_devices()[0]} else sharding


def is_tracing(*values: object) -> bool:
    """True inside a caller's ``jit`` (where even a constant is traced) or where a value is a tracer."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values)) or isinstance(jnp.zeros(()), Tracer)
