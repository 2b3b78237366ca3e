"""jaxftc: fault diagnosis and fault-tolerant control for robot arms, in JAX.

The map of rooms: ``arm`` (the plant and its engines), ``laguerre`` and ``arx`` (block 1 of the paper), ``observer``
(blocks 2 to 4), ``diagnosis`` (5 to 7), ``control`` (8, 9), ``fuzzy`` (inference), ``faults`` (scenarios), ``controller`` (one
tick), ``closed_loop`` (plant, faults and tick), ``identify`` (the ARX read-out from data), ``metrics`` and ``cli``.
Public names load on first use, so that importing the package is quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from jaxftc.version import __version__

if TYPE_CHECKING:
    from jaxftc.arm.plant import Plant, forward_dynamics, inverse_dynamics, nominal_plant
    from jaxftc.arm.puma560 import puma560
    from jaxftc.arm.robot import Robot, load_robot
    from jaxftc.compile import jit
    from jaxftc.config import Config
    from jaxftc.defaults import default_gains
    from jaxftc.faults.scenario import Scenario, sample_scenarios
    from jaxftc.gains import Gains
    from jaxftc.gains_file import load_gains, save_gains
    from jaxftc.closed_loop import Trace, simulate
    from jaxftc.controller import State, init, step
    from jaxftc.types import VERDICTS, Measurement, Output, Reference

_HOME = {
    "Plant": "arm.plant",
    "forward_dynamics": "arm.plant",
    "inverse_dynamics": "arm.plant",
    "nominal_plant": "arm.plant",
    "puma560": "arm.puma560",
    "Robot": "arm.robot",
    "load_robot": "arm.robot",
    "jit": "compile",
    "Config": "config",
    "default_gains": "defaults",
    "Scenario": "faults.scenario",
    "sample_scenarios": "faults.scenario",
    "Gains": "gains",
    "load_gains": "gains_file",
    "save_gains": "gains_file",
    "Trace": "closed_loop",
    "simulate": "closed_loop",
    "State": "controller",
    "init": "controller",
    "step": "controller",
    "VERDICTS": "types",
    "Measurement": "types",
    "Output": "types",
    "Reference": "types",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'jaxftc' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"jaxftc.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
