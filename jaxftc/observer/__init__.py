"""The observer cascade, blocks 1 to 4: ARX-Laguerre model, PI, super-twisting and Takagi-Sugeno stages on one innovation.

``adaptation``, ``stability`` and ``frequency`` are for users and load on first use, as the names of ``jaxftc`` do.
"""

from __future__ import annotations

import importlib
from typing import Any


def __getattr__(name: str) -> Any:
    if name not in ("adaptation", "stability", "frequency"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return importlib.import_module(f"{__name__}.{name}")
