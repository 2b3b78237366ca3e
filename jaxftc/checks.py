"""Errors where a value comes in: what came, what is allowed, what to do. Nothing here runs under a trace.

Commands check their options before they set JAX up, so NumPy and JAX are imported where they are needed.
"""

from __future__ import annotations

import difflib
import math
import numbers
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import jax

MOST_TICKS = 10_000_000  # of a simulation, nearly three hours at 1 kHz: times still tell ticks apart, memory may hold it


def one_of(name: str, value: object, allowed: Sequence[str]) -> None:
    """Refuse a word that is not on the list, and say which one was probably meant."""
    if value in allowed:
        return
    near = [word for word in allowed if word.rpartition(".")[2] == value]  # of block.name the bare name
    near = near or difflib.get_close_matches(str(value), allowed, n=1)
    hint = f"; did you mean {' or '.join(map(repr, near))}?" if near else ""
    raise ValueError(f"{name} must be one of {', '.join(map(repr, allowed))}, got {value!r}{hint}")


def integer(name: str, value: object, low: int, why: str, high: int = 2**31 - 1) -> None:
    """Refuse anything but an integer of at least ``low`` and at most ``high``: arrays count in 32 bits."""
    if not isinstance(value, numbers.Integral) or isinstance(value, bool) or value < low:
        raise ValueError(f"{name} must be an integer of at least {low}, got {value!r}; {why}")
    if int(value) > high:
        raise ValueError(f"{name} must be an integer of at most {high}, got {value!r}; {why}")


def seed(name: str, value: int) -> None:
    """Refuse a number that no random key can be made of."""
    if not 0 <= value < 2**63:
        raise ValueError(f"{name} must lie in 0 to 2^63 - 1, got {value}")


def instance(name: str, value: object, kind: type) -> None:
    """Refuse what is of another kind: arguments swapped, most of the time."""
    if not isinstance(value, kind):
        raise ValueError(f"{name} must be a {kind.__name__}, got a {type(value).__name__}; arguments in another order?")


def filled(value: Any) -> Any:
    """The value; of a masked array, NaN where it is masked, which JAX and NumPy would otherwise read through the mask."""
    import numpy as np

    return np.ma.filled(value.astype(float), np.nan) if isinstance(value, np.ma.MaskedArray) else value


def random_key(name: str, value: object) -> None:
    """Refuse what is no random key of JAX, old or new."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    array = isinstance(value, jax.Array | np.ndarray)
    new = array and jnp.issubdtype(value.dtype, jax.dtypes.prng_key) and value.shape == ()
    if not new and not (array and value.dtype == np.uint32 and value.shape in ((2,), (4,))):
        raise ValueError(f"{name} must be one random key, such as jax.random.key(0), got {value!r}")


def positive(name: str, value: float, unit: str) -> None:
    """Refuse a number that is not finite and above zero."""
    if not (isinstance(value, numbers.Real) and math.isfinite(value) and value > 0):
        raise ValueError(f"{name} must be a positive, finite number of {unit}, got {value!r}")


def span(name: str, value: float, *, finite: bool = False) -> None:
    """Refuse a time that is negative, no number or, where it must not be, infinite."""
    if not (isinstance(value, numbers.Real) and value >= 0 and (math.isfinite(value) or not finite)):
        allowed = "at least 0 and finite" if finite else "at least 0; math.inf is never"
        raise ValueError(f"{name} must be a number of seconds, {allowed}, got {value!r}")


def multiple(name: str, value: float, dt: float) -> int:
    """Return value / dt as an integer, or refuse: times are never rounded silently."""
    ticks = round(min(value / dt, MOST_TICKS + 1))
    if ticks > MOST_TICKS:
        raise ValueError(f"{name} must be at most {MOST_TICKS * dt:g} s, {MOST_TICKS} ticks of {dt:g} s, got {value!r} s")
    if ticks < 1 or abs(ticks * dt - value) > 1e-9 * max(1.0, abs(value)):
        raise ValueError(
            f"{name} must be a multiple of dt = {dt:g} s, got {value!r} s; the nearest is {max(ticks, 1) * dt:g} s"
        )
    return ticks


def joints_first(name: str, value: object, n: int) -> None:
    """Refuse an array whose first axis is not the n joints."""
    import numpy as np

    shape = tuple(np.shape(value))  # pyright: ignore[reportArgumentType, reportCallIssue]
    if not shape or shape[0] != n:
        raise ValueError(f"{name} must have the {n} joints on its first axis ([{n}] or [{n}, scenarios]), got shape {shape}")


def one_arm(name: str, value: object, n: int) -> None:
    """Refuse an array that is not one number for each of the n joints."""
    import numpy as np

    shape = tuple(np.shape(value))  # pyright: ignore[reportArgumentType, reportCallIssue]
    if shape != (n,):
        raise ValueError(f"{name} must have shape [{n}], one arm's joints, got {list(shape)}")


def finite(name: str, value: object, what_to_do: str) -> None:
    """Refuse numbers that are not finite; values under a trace are not looked at."""
    import numpy as np
    from jax.core import Tracer

    if isinstance(value, Tracer):
        return
    array = np.asarray(value)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {array.tolist()}; {what_to_do}")


def same_shape(names: Sequence[str], values: Sequence[jax.Array]) -> None:
    """Refuse arrays whose scenario axes differ: joints must not be broadcast onto scenarios."""
    first = values[0].shape
    for name, value in zip(names, values, strict=True):
        if value.shape != first:
            raise ValueError(
                f"{name} must have the shape of {names[0]}, {list(first)}, got {list(value.shape)}; "
                "give every signal the same scenario axes"
            )
