"""Tuning of every gain by gradient descent through the closed loop, over vmapped fault scenarios.

The map of rooms: ``terms`` (what is good), ``transform`` (theta and gains), ``problem`` (the loss and its gradient),
``descent`` and ``search`` (methods), ``loop`` (``fit``), ``held_out`` (what it is worth), ``report`` and ``cli``. Public
names load on first use, as in ``jaxftc``.
"""

from __future__ import annotations

import importlib
from typing import Any

_ROOMS = {
    "held_out": ("Comparison", "compare"),
    "loop": ("Progress", "Result", "fit"),
    "problem": ("Problem",),
    "settings": ("Settings",),
    "terms": ("OBJECTIVE", "Run", "Term", "alarms"),
    "transform": ("tunable",),
}
_HOME = {name: room for room, names in _ROOMS.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'tuning' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"tuning.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(_HOME)
