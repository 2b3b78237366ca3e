"""What the loop asks of a robot, and what it takes from it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from jaxftc.types import Measurement, Output

Stop = Callable[[float, Output], tuple[Any, bool]]


class Robot(Protocol):
    """What a loop asks of a robot. What ``read`` raises is a missing reading, what ``write`` raises a missed deadline."""

    def read(self) -> Any:
        """Angles [n] rad, nan where there is none; or a ``Measurement`` with the torque [n] N m that the drives made."""
        ...

    def write(self, tau: np.ndarray) -> Any:
        """Take a torque [n] N m and hold it until the next."""
        ...


def angles(reading: Any, n: int) -> tuple[Any, Any]:
    """Angles [n] rad of what a robot gave, and the torque [n] N m if it gave one."""
    q, tau = reading if isinstance(reading, Measurement) else (reading, None)
    found = []
    for name, value in (("angles", q), ("torques", tau)):
        array = None if value is None else np.array(value, float)
        if array is not None and array.shape != (n,):
            raise ValueError(f"read must give {name} [{n}], got shape {list(array.shape)}")
        found.append(array)
    return (np.full(n, np.nan) if found[0] is None else found[0]), found[1]
