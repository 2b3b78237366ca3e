"""One gain: its axes, unit, default and limits, as the metadata of a field; and classes of such fields."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import jax
import numpy as np

INCREASING = ("tau_centres", "jump_centres", "q_centres", "s_centres")  # from set to set


class Spec(NamedTuple):
    """What a gain is: axes (n joints, a and b Laguerre functions, u inputs, or a number), unit, default, limits."""

    axes: tuple[str, ...]
    unit: str
    default: Any
    low: float
    high: float
    open_low: bool
    doc: str


def gain(
    axes: str,
    unit: str,
    default: Any,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    above: float | None = None,
    doc: str,
) -> Any:
    """A field of a block of gains.

    Args:
        axes: Its own axes with blanks between: ``n`` is one value a joint, a number so many for all joints.
        unit: Its unit, 1 if it has none.
        default: A number, or one for each of so many.
        low: Least value that is allowed.
        high: Largest value that is allowed.
        above: In place of ``low``, the value that it must lie above.
        doc: What it is, in a few words.
    """
    spec = Spec(tuple(axes.split()), unit, default, low if above is None else above, high, above is not None, doc)
    return dataclasses.field(metadata={"spec": spec})


def block(cls: type) -> type:
    """Make a class of ``gain`` fields a block of gains: a pytree, its fields explained in ``help()``."""
    cls = jax.tree_util.register_dataclass(dataclasses.dataclass(frozen=True)(cls))
    specs = [(field.name, field.metadata["spec"]) for field in dataclasses.fields(cls)]
    lines = [f"    {name}: [{', '.join(spec.axes)}] {spec.unit}, {spec.doc}." for name, spec in specs]
    cls.__doc__ = "\n".join([cls.__doc__ or "", "", "Attributes:", *lines])
    return cls


def check_values(path: str, value: np.ndarray, spec: Spec) -> None:
    """Refuse values [own axes, ...] of the gain at ``path`` that are not finite, beyond its limits or not in order."""
    if not np.isfinite(value).all():
        raise ValueError(f"{path} must be finite, got {value.tolist()}")
    both_open = spec.open_low and spec.high == 1.0 and spec.low == -1.0
    below = value <= spec.low if spec.open_low else value < spec.low
    over = value >= spec.high if both_open else value > spec.high
    if (below | over).any():
        closing = ")" if both_open or math.isinf(spec.high) else "]"
        interval = f"{'(' if spec.open_low else '['}{spec.low:g}, {spec.high:g}{closing}"
        unit = "" if spec.unit == "1" else f" {spec.unit}"
        raise ValueError(f"{path} must lie in {interval}{unit}, got {value.tolist()}")
    if path.split(".")[1] in INCREASING and (np.diff(value, axis=0) <= 0).any():
        raise ValueError(f"{path} must increase from set to set, got {value.tolist()}")
