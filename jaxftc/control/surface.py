"""Sliding surface, Eq. (19), and the speed it needs.

The speed is predicted from the commanded acceleration and corrected by the reading's difference quotient. The prediction
takes away the lag of a plain filter, so that the correction can be weak and the encoder's noise stays out of the torque.
"""

from __future__ import annotations

from typing import NamedTuple

from jaxftc.gains import ControlGains
from jaxftc.types import Array, Reference


class Surface(NamedTuple):
    """Tracking error and sliding surface; r of Eq. (19) is the tracking error, not the residual (its S-dot shows it)."""

    error: Array  # [n, ...] rad, q_hat - q_ref
    errord: Array  # [n, ...] rad/s
    s: Array  # [n, ...] rad/s


def speed(weight: Array, qd: Array, acceleration: Array, q_before: Array, q: Array, dt: float) -> Array:
    """Speed [n, ...] rad/s of this tick from that of the last, its acceleration [n, ...] rad/s^2 and two angles.

    A difference quotient is the speed half a tick ago; the acceleration brings it up to now. Without that, a motion with
    steady acceleration is tracked with a steady error, 0.05 deg on the paper's fastest joint.
    """
    predicted = qd + dt * acceleration
    measured = (q - q_before) / dt + 0.5 * dt * acceleration
    return predicted + weight * (measured - predicted)


def surface(gains: ControlGains, q: Array, qd: Array, reference: Reference) -> Surface:
    """S = lam error + d(error)/dt [n, ...] rad/s, Eq. (19), at q and qd [n, ...]."""
    error, errord = q - reference.q, qd - reference.qd
    return Surface(error, errord, gains.lam * error + errord)
