"""The machine that figures come from."""

from __future__ import annotations

import os
import platform
from typing import Any

import jax
import mujoco

from jaxftc.version import __version__


def describe() -> dict[str, Any]:
    """Processor, cores, devices and versions."""
    name = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            name = next(line.split(":")[1].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return {
        "processor": name,
        "cores": cores(),
        "devices": [str(device) for device in jax.local_devices()],
        "python": platform.python_version(),
        "jax": jax.__version__,
        "mujoco": mujoco.__version__,
        "jaxftc": __version__,
    }


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
