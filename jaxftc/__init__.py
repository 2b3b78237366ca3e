"""jaxftc: fault diagnosis and fault-tolerant control for robot arms, in JAX.

The map of rooms: ``arm`` (plant and engines), ``laguerre`` and ``arx`` (block 1 of the paper), ``observer`` (blocks 2 to 4),
``diagnosis`` (5 to 7), ``control`` (8, 9), ``fuzzy`` (inference), ``controller`` (one tick of all that), ``baselines`` (what
it is measured against), ``schemes`` (the door to either), ``faults`` (scenarios), ``closed_loop`` (plant, faults and tick),
``identify`` (the ARX read-out from data), ``metrics``, ``monte_carlo`` (campaigns and thresholds), ``logs`` and ``cli``.
Public names load on first use, so that importing the package is quick.
"""

from __future__ import annotations

import importlib
from typing import Any

from jaxftc.version import __version__ as __version__

_ROOMS = {
    "arm.plant": ("Plant", "forward_dynamics", "inverse_dynamics", "nominal_plant"),
    "arm.puma560": ("puma560",),
    "arm.robot": ("Robot", "load_robot"),
    "closed_loop": ("Trace", "simulate"),
    "compile": ("configure_xla",),
    "config": ("Config",),
    "controller": ("State",),
    "defaults": ("default_gains",),
    "faults.preset": ("Preset",),
    "faults.preset_file": ("load_preset",),
    "faults.sample": ("sample_scenarios",),
    "faults.scenario": ("Scenario", "paper_scenario", "trail"),
    "gains": ("Gains",),
    "gains_file": ("load_gains", "save_gains"),
    "monte_carlo.calibrate": ("calibrate",),
    "monte_carlo.run": ("campaign",),
    "schemes": ("init", "step"),
    "tick": ("Tick",),
    "types": ("VERDICTS", "Measurement", "Output", "Reference"),
}
_HOME = {name: room for room, names in _ROOMS.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'jaxftc' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"jaxftc.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return ["__version__", *sorted(_HOME)]
