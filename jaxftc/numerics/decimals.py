"""Numbers of single precision as those that were meant."""

from __future__ import annotations

from typing import Any

import numpy as np


def decimals(leaf: Any) -> np.ndarray:
    """In double precision; of numbers in single precision the shortest decimals that give the same."""
    return np.asarray(leaf).astype(str).astype(float)
