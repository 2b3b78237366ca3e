"""Named parts of the tick, by the paper's boxes, so that code that is written from the traced tick can show them.

What JAX knows of scopes is not public. So while ``marked`` is on, entering and leaving a box leaves a call of an empty
function of its name in the trace. Otherwise a box is the function that it names and nothing else.
"""

from __future__ import annotations

import contextlib
import contextvars
import functools
from collections.abc import Callable, Iterator
from typing import ParamSpec, TypeVar

import jax

ENTER, LEAVE = "box: ", "end of box"
P = ParamSpec("P")
T = TypeVar("T")
_marked = contextvars.ContextVar("marked", default=False)


@contextlib.contextmanager
def marked() -> Iterator[None]:
    """Boxes leave marks in what is traced meanwhile."""
    token = _marked.set(True)
    try:
        yield
    finally:
        _marked.reset(token)


def box(name: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """A function that is a box of the block diagram, or a part of one."""

    def named(fun: Callable[P, T]) -> Callable[P, T]:
        """``fun``, which leaves marks of its box where it is traced while ``marked`` is on."""

        @functools.wraps(fun)
        def call(*args: P.args, **kwargs: P.kwargs) -> T:
            if not _marked.get():
                return fun(*args, **kwargs)
            _leave_mark(ENTER + name)
            made = fun(*args, **kwargs)
            _leave_mark(LEAVE)
            return made

        return call

    return named


def _leave_mark(name: str) -> None:
    def empty() -> tuple[()]:
        return ()

    empty.__name__ = name
    jax.jit(empty)()
