"""The weights of the learned decision (``diagnosis/learned_decision.py``): gains of a block of their own.

They are there where ``config.decision`` is ``learned``. A gains file may hold its own. One that does not gets those that
come with the library, which ``python -m tuning.decision`` makes: ``decision.toml``, or ``slower_decision.toml`` for loops
that are much slower than 1 kHz, where a fault shows otherwise from tick to tick.
"""

from __future__ import annotations

import functools
import tomllib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxftc.gain_spec import block, gain
from jaxftc.types import Array

SLOWER = 1.5e-3  # s, sample times from which on the weights for slower loops are taken


@block
class DecisionGains:
    """Weights of the learned decision, the same for every joint: layers of 64 and 32 units, and two outputs."""

    centre: Array = gain("44", "1", None, doc="subtracted from what is shown")
    width: Array = gain("44", "1", None, above=0.0, doc="what that is divided by")
    low: Array = gain("44", "1", None, doc="least that was shown in training; below it the rule's verdict stays")
    high: Array = gain("44", "1", None, doc="most that was shown in training")
    first: Array = gain("44 64", "1", None, doc="first layer")
    first_bias: Array = gain("64", "1", None, doc="its bias")
    second: Array = gain("64 32", "1", None, doc="second layer")
    second_bias: Array = gain("32", "1", None, doc="its bias")
    last: Array = gain("32 2", "1", None, doc="outputs, log odds of an actuator and of an encoder fault")
    last_bias: Array = gain("2", "1", None, doc="their bias")
    doubt: Array = gain(
        "1", "1", None, low=0.0, doc="log odds within which the rule's verdict stays, unless the alarm has come back"
    )


@functools.cache
def shipped(dt: float) -> Mapping[str, np.ndarray]:
    """The weights that come with the library for a sample time in s, by name."""
    file = Path(__file__).parent / "diagnosis" / ("decision.toml" if dt < SLOWER else "slower_decision.toml")
    table = tomllib.loads(file.read_text(encoding="utf-8"))["decision"]
    return {name: np.asarray(entry["value"], float) for name, entry in table.items()}
