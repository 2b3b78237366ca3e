"""Residual statistic, alarm and verdict, Eqs. (14), (17) and (18), corrected."""

import numpy as np

Array = np.ndarray

NORMAL, ACTUATOR, SENSOR, BOTH = 0, 1, 2, 3


def statistic(r: Array, z: Array, w: float, leak: float) -> tuple[Array, Array]:
    """Surface S and next sum z of Eq. (14) in the unit of r: S = w r + (1 - w) z, z(k+1) = (1 - leak) z + leak r.

    r, z [n]; w, leak in 0..1. The sum is normalised, so both terms have one unit and a constant r gives S = r.
    """
    s = w * r + (1 - w) * z
    z_next = (1 - leak) * z + leak * r
    return s, z_next


def alarm(s: Array, alpha: Array) -> Array:
    """Alarm |S| >= alpha of Eq. (17), bool [n]; alpha > 0 in the unit of S."""
    return np.abs(s) >= alpha


def latch(on: Array, s: Array, alpha: Array, release: float = 0.7) -> Array:
    """Alarm with hysteresis, bool [n]: set at |S| >= alpha, kept while |S| >= release * alpha."""
    return np.where(on, np.abs(s) >= release * alpha, np.abs(s) >= alpha)


def verdict(bit_tau: Array, bit_q: Array) -> Array:
    """Fault kind of Eq. (18) per joint, int [n]: 0 normal, 1 actuator, 2 sensor, 3 both."""
    kinds = {(False, False): NORMAL, (True, False): ACTUATOR, (False, True): SENSOR, (True, True): BOTH}
    return np.array([kinds[bool(t), bool(q)] for t, q in zip(bit_tau, bit_q, strict=True)])
