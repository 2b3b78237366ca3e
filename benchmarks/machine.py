"""The machine that figures come from."""

from __future__ import annotations

import platform
import re
import resource
import sys
from pathlib import Path
from typing import Any

import jax
import mujoco

from jaxftc.compile.devices import cores
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


def peak(usage: resource.struct_rusage) -> int:
    """Largest resident memory of a process, bytes; systems differ in the unit."""
    return usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def own_peak() -> int:
    """The same of this process; on Linux as it tells itself, since what the system counts begins with its parent's."""
    status = Path("/proc/self/status")
    told = re.search(r"VmHWM:\s+(\d+) kB", status.read_text() if status.exists() else "")
    return int(told[1]) * 1024 if told else peak(resource.getrusage(resource.RUSAGE_SELF))
