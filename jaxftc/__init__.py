"""jaxftc: fault diagnosis and fault-tolerant control for robot arms, in JAX.

The rooms: ``robot`` (arms, their dynamics), ``observer`` (blocks 1 to 4 of the paper), ``diagnosis`` (5 to 7), ``control``
(8, 9), ``fuzzy`` (inference), ``schemes`` (one tick of all that, and what it is measured against), ``scenarios`` (faults and
motions), ``simulation`` (the closed loop), ``evaluation`` (figures of merit), ``campaigns``, ``logs``, ``identify``,
``report``, ``view``, ``paper`` and ``cli``. CONTRIBUTING.md draws who may import whom. Public names load on first use, so
that importing the package is quick.
"""

from __future__ import annotations

import importlib
from typing import Any

from jaxftc.version import __version__ as __version__

_ROOMS = {
    "robot.dynamics": ("Plant", "forward_dynamics", "inverse_dynamics", "nominal_plant"),
    "robot.puma560": ("puma560",),
    "robot.arm_table": ("Arm", "Recording"),
    "robot.arm_file": ("load_arm", "load_robot", "save_arm"),
    "robot.model": ("Robot",),
    "simulation.closed_loop": ("Trace", "simulate"),
    "compile.xla": ("configure_xla",),
    "config": ("Config",),
    "schemes.cascade": ("State",),
    "schemes.defaults": ("default_gains",),
    "schemes.diagnoser": ("Diagnoser",),
    "scenarios.preset": ("Preset",),
    "scenarios.preset_file": ("load_preset",),
    "scenarios.sample": ("sample_scenarios",),
    "scenarios.scenario": ("Scenario", "healthy_scenario", "paper_scenario"),
    "gains": ("Gains",),
    "gains_file": ("load_gains", "save_gains"),
    "campaigns.calibrate": ("calibrate",),
    "campaigns.run": ("campaign",),
    "schemes.registry": ("init", "step"),
    "realtime.tick": ("Tick",),
    "types": ("Measurement", "Output", "Reference", "Verdict"),
}
_HOME = {name: room for room, names in _ROOMS.items() for name in names}
_MODULES = {  # public modules, and where they are
    "export": "export",
    "faults": "faults",
    "identify": "identify",
    "logs": "logs",
    "metrics": "evaluation.metrics",
    "observer": "observer",
    "realtime": "realtime",
}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        module = importlib.import_module(f"jaxftc.{_MODULES[name]}")
        return globals().setdefault(name, module)  # importing has set the name of a room
    if name not in _HOME:
        raise AttributeError(f"module 'jaxftc' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"jaxftc.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return ["__version__", *sorted([*_HOME, *_MODULES])]
