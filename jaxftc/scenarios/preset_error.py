"""What is wrong in a preset: the place of it and the reason, which together are one line."""

from __future__ import annotations

import difflib
import math
import numbers


class PresetError(ValueError):
    """What is wrong with a value, and the dotted place of it below the table that was checked."""

    def __init__(self, place: str, reason: str) -> None:
        super().__init__(f"{place}: {reason}" if place else reason)
        self.place, self.reason = place, reason


def one_of_text(value: object, allowed: tuple[str, ...]) -> str:
    """What a text must be, what came and which was probably meant."""
    near = difflib.get_close_matches(str(value), allowed, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"must be one of {', '.join(map(repr, allowed))}, got {value!r}{hint}"


def one_of(place: str, value: object, allowed: tuple[str, ...]) -> None:
    """Refuse a text that is not on the list."""
    if value not in allowed:
        raise PresetError(place, one_of_text(value, allowed))


def finite(place: str, value: object) -> None:
    """Refuse anything but a finite number."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise PresetError(place, f"must be a finite number, got {value!r}")


def all_finite(place: str, values: object) -> None:
    """Refuse anything but a tuple of finite numbers."""
    if not isinstance(values, tuple):
        raise PresetError(place, f"must be a tuple of numbers, got {values!r}")
    for value in values:
        finite(place, value)


def is_integer(value: object) -> bool:
    """Whether it is an integer, which a truth value is not."""
    return isinstance(value, int) and not isinstance(value, bool)
