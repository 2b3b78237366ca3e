"""Signals that cross a door, and the one contract that every block keeps.

A block is a module with ``init(config, gains, q) -> State`` and ``step(config, gains, state, inputs) -> (State, Info)``, its
inputs one named tuple ``Inputs``.
``State`` is what the next tick needs, ``Info`` is what the next block or a plot needs. Every array is ``[n, ...]``: joints
first, any trailing axes are scenarios. Units are rad, N m, s and kg throughout.
"""

from __future__ import annotations

from enum import IntFlag
from typing import NamedTuple

import jax

Array = jax.Array


class Verdict(IntFlag):
    """What is said of a joint, Eq. (18); arrays hold its number.

    ``UNKNOWN`` stands alone: the state that came was lost (not finite, or beyond all that a tick makes), the arm starts anew
    from this tick's readings, and nothing is known of any of its joints.
    """

    NORMAL = 0
    ACTUATOR = 1
    SENSOR = 2
    BOTH = 3
    UNKNOWN = 4

    @property
    def label(self) -> str:
        """Its name in files: normal, actuator, sensor, both or unknown."""
        return LABELS[self] if self < Verdict.UNKNOWN else "unknown"


LABELS = ("normal", "actuator", "sensor", "both")  # of the verdicts 0 to 3


class Reference(NamedTuple):
    """Desired motion at one tick.

    A joint is to hold the angle it has where a value is not finite, or is one that no joint can follow: faster than 300
    rad/s or 1e5 rad/s^2, or more than a turn outside its range (100 turns where the robot's file gives none).
    """

    q: Array  # [n, ...] rad
    qd: Array  # [n, ...] rad/s
    qdd: Array  # [n, ...] rad/s^2


class Measurement(NamedTuple):
    """What the controller is told at one tick.

    A reading that is not finite, or where no joint can be, is absent: it is replaced by the model's prediction, and after a
    few ticks called a sensor fault. No joint can be more than a turn, and 30 rad/s since the last reading that was used,
    from where it is held to be. A torque beyond the limit is what the limit leaves; one that is not finite, or not given,
    counts as the controller's own command. Masked values count as not finite.
    """

    q: Array  # [n, ...] rad, encoder reading
    tau: Array = None  # [n, ...] N m, torque commanded in the last tick; None: not known  # pyright: ignore[reportAssignmentType]


class SensorStatus(NamedTuple):
    """What the sensor check holds of each reading; the observer hears of it one tick later."""

    suspect: Array  # [n, ...] 1 where the reading is held to be wrong, for any of the reasons below or a steep drift
    transient: Array  # [n, ...] 1 where a velocity transient was found
    frozen: Array  # [n, ...] 1 where it is held to be frozen
    noisy: Array  # [n, ...] 1 where it is held to be noisy


class Output(NamedTuple):
    """What one tick of the controller says."""

    tau: Array  # [n, ...] N m, torque command within the limits
    fault_tau_hat: Array  # [n, ...] N m, estimated actuator fault
    fault_q_hat: Array  # [n, ...] rad, estimated encoder fault
    residual_tau: Array  # [n, ...] N m, Eq. (13), torque channel
    residual_q: Array  # [n, ...] rad, Eq. (13), encoder channel
    statistic_tau: Array  # [n, ...] N m, S of Eq. (14); alarm when |S| reaches threshold_tau
    statistic_q: Array  # [n, ...] rad
    threshold_tau: Array  # [n, ...] N m
    threshold_q: Array  # [n, ...] rad
    verdict: Array  # [n, ...] int32, a Verdict's number, Eq. (18)
    detected: Array  # [...] bool, any joint not normal, Eq. (17)
    suspect: Array  # [n, ...] 1 where the sensor check holds the reading to be wrong, else 0
    q_hat: Array  # [n, ...] rad, encoder reading less its estimated fault
    qd_hat: Array  # [n, ...] rad/s
    s: Array  # [n, ...] rad/s, sliding surface, Eq. (19)
    alpha_online: Array  # [n, ...] 1, fuzzy factor on the switching gain, Eq. (33); 1 where it is not used
