"""Which stages of the cascade run, as data.

The paper's observers and controllers differ by factors of 0 and 1, so that one compiled program runs all of them, on the
scenario axis side by side if need be. Known when tracing (Python's bools), a factor costs nothing.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from jaxftc import variants
from jaxftc.config import Config
from jaxftc.types import Array

T = TypeVar("T")
Flag = bool | Array  # [...] bool, one a scenario or one for all


class Stages(NamedTuple):
    """What runs beside blocks 1, 2 and 5 to 8."""

    sliding: Flag  # block 3, the super-twisting stage
    printed: Flag  # in the form that Eq. (7) prints
    fuzzy: Flag  # block 4, the Takagi-Sugeno stage
    raw: Flag  # the controller sees the reading as it comes and no fault estimate: SMC
    online: Flag  # block 9, the fuzzy factor on the switching gain: AFESMC


def of(config: Config) -> Stages:
    """The stages of a config's observer and controller."""
    return Stages(
        sliding=config.observer != "pi",
        printed=config.observer == "eso_printed",
        fuzzy=config.observer == "ts",
        raw=config.control == "smc",
        online=config.control == "afesmc",
    )


def staged(config: Config) -> bool:
    """Whether the config's scheme has these stages."""
    return getattr(variants.load(config.scheme), "STAGED", False)


def as_data(config: Config) -> Stages | None:
    """The same as arrays, for a program that serves every observer and controller; None for a scheme without stages."""
    return Stages(*map(jnp.asarray, of(config))) if staged(config) else None


def general(config: Config) -> Config:
    """The config that such a program is compiled for: the same whatever the observer and the controller."""
    return dataclasses.replace(config, observer="ts", control="afesmc") if staged(config) else config


def either(flag: Flag, yes: T, no: T) -> T:
    """One of two pytrees, by a flag that is known now or by one that is data."""
    if isinstance(flag, bool):
        return yes if flag else no
    return jax.tree.map(lambda a, b: jnp.where(flag, a, b), yes, no)
