"""Laws of a number, as a preset file says them: a plain number, uniform, normal or choice.

A law takes exactly one uniform number for each value that it draws, through the inverse of its distribution function. So
the numbers of a scenario are dealt from one array, and a changed law changes no other draw.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import numbers
from typing import Annotated, Any

import jax.numpy as jnp
from jax.scipy.special import ndtri
from pydantic import ConfigDict, Discriminator, Strict, Tag

from jaxftc.scenarios.preset_error import PresetError, all_finite, finite
from jaxftc.types import Array

Real = Annotated[float, Strict()]  # a number, neither a truth value nor a text


class Table:
    """A table of a preset file, which has no other keys than its fields."""

    __pydantic_config__ = ConfigDict(extra="forbid")


@dataclasses.dataclass(frozen=True)
class Uniform(Table):
    """U(low, high)."""

    uniform: tuple[Real, ...]  # low, high

    def __post_init__(self) -> None:
        _range("uniform", self.uniform)


@dataclasses.dataclass(frozen=True)
class Normal(Table):
    """N(mean, std^2); values beyond ``within`` are moved to its nearer end."""

    normal: tuple[Real, ...]  # mean, std
    within: tuple[Real, ...] | None = None  # low, high

    def __post_init__(self) -> None:
        all_finite("normal", self.normal)
        if len(self.normal) != 2 or self.normal[1] <= 0:
            raise PresetError("normal", f"must be [mean, std] with std above zero, got {list(self.normal)}")
        if self.within is not None:
            _range("within", self.within)


@dataclasses.dataclass(frozen=True)
class Choice(Table):
    """One of some numbers, each as likely."""

    choice: tuple[Real, ...]

    def __post_init__(self) -> None:
        all_finite("choice", self.choice)
        if not self.choice:
            raise PresetError("choice", "must hold at least one number, got []")


FORMS = {"uniform": Uniform, "normal": Normal, "choice": Choice}
WAYS = "a number, { uniform = [low, high] }, { normal = [mean, std] } (also with within = [low, high]) or { choice = [..] }"


def _form(value: Any) -> str | None:
    """Tag of the form that a file's value has, also where its key is misspelt; None if it has none."""
    if not isinstance(value, dict):
        return "<number>"
    near = [key for name in value for key in difflib.get_close_matches(name, FORMS, n=1)]
    key = next((key for key in FORMS if key in value), near[0] if near else None)
    return key and f"<{key}>"


Law = Annotated[
    Annotated[Real, Tag("<number>")]
    | Annotated[Uniform, Tag("<uniform>")]
    | Annotated[Normal, Tag("<normal>")]
    | Annotated[Choice, Tag("<choice>")],
    Discriminator(_form),
]


def extent(law: Law) -> tuple[float, float]:
    """The least and the largest number that the law can draw."""
    if isinstance(law, Uniform):
        return law.uniform[0], law.uniform[1]
    if isinstance(law, Normal):
        return (-math.inf, math.inf) if law.within is None else (law.within[0], law.within[1])
    if isinstance(law, Choice):
        return min(law.choice), max(law.choice)
    return law, law


def scaled(law: Law, factor: float) -> Law:
    """The law of ``factor`` times the number, for units."""
    if isinstance(law, Uniform | Normal | Choice):
        values = {name: value and tuple(factor * x for x in value) for name, value in vars(law).items()}
        return dataclasses.replace(law, **values)
    return factor * law


def quantile(law: Law, u: Array) -> Array:
    """The values [...] that belong to uniform numbers u [...] in [0, 1), by the inverse distribution function."""
    if isinstance(law, Uniform):
        low, high = law.uniform
        return low + _rounded((high - low) * u)
    if isinstance(law, Normal):
        mean, std = law.normal
        value = mean + _rounded(std * ndtri(jnp.maximum(u, jnp.finfo(u.dtype).eps / 2)))  # of 0, ndtri is infinite
        return value if law.within is None else jnp.clip(value, law.within[0], law.within[1])
    if isinstance(law, Choice):
        return jnp.asarray(law.choice, u.dtype)[(len(law.choice) * u).astype(jnp.int32)]
    return jnp.full(u.shape, law, u.dtype)


def _rounded(product: Array) -> Array:
    """The product, rounded before it is added to anything.

    XLA's CPU compiler multiplies and adds with one rounding or with two, as the place in the loop has it: a draw would then
    depend in its last digit on how many are drawn with it. A maximum in between leaves it no choice.
    """
    return jnp.maximum(product, jnp.finfo(product.dtype).min)


def require(place: str, law: Law, low: float = -math.inf, high: float = math.inf, *, above: bool = False) -> None:
    """Refuse a law that is none, or that can draw a number outside low..high, with ``above`` also low itself.

    Raises:
        PresetError: naming the place, what came and what is allowed.
    """
    if not isinstance(law, Uniform | Normal | Choice):
        if isinstance(law, bool) or not isinstance(law, numbers.Real):
            raise PresetError(place, f"must be {WAYS}, got {law!r}")
        finite(place, law)
    least, most = extent(law)
    if least < low or (above and least <= low) or most > high:
        if math.isfinite(high):
            rule = f"stay within {low:g} and {high:g}"
        else:
            rule = f"stay above {low:g}" if above else f"not fall below {low:g}"
        hint = "; give the normal law within = [low, high]" if isinstance(law, Normal) and law.within is None else ""
        drawn = " whatever is drawn" if isinstance(law, Uniform | Normal | Choice) else ""
        raise PresetError(place, f"must {rule}{drawn}, got {as_text(law)}{hint}")


def require_number(place: str, value: float, low: float = -math.inf, high: float = math.inf, *, above: bool = False) -> None:
    """The same for a number that is not drawn.

    Raises:
        PresetError: naming the place, what came and what is allowed.
    """
    finite(place, value)
    require(place, value, low, high, above=above)


def as_text(law: Law) -> str:
    """The law as a file says it."""
    if isinstance(law, Uniform | Normal | Choice):
        said = {name: list(value) for name, value in vars(law).items() if value is not None}
        return "{ " + ", ".join(f"{name} = {value}" for name, value in said.items()) + " }"
    return repr(law)


def _range(place: str, values: tuple[float, ...]) -> None:
    all_finite(place, values)
    if len(values) != 2:
        raise PresetError(place, f"must be [low, high], got {list(values)}")
    if values[0] >= values[1]:
        raise PresetError(place, f"low must be below high, got {list(values)}")
