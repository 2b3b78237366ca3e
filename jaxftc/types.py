"""Signals that cross an interface, and the one contract that every block keeps.

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
    from this tick's readings, and nothing is known of any of its joints. ``CONTACT`` is said of joints 1 to l where
    something pushes on link l: they all bear the force.
    """

    NORMAL = 0
    ACTUATOR = 1
    SENSOR = 2
    BOTH = 3
    UNKNOWN = 4
    CONTACT = 8

    @property
    def label(self) -> str:
        """Its name in files: normal, actuator, sensor, both, contact or unknown."""
        if self & Verdict.UNKNOWN:
            return "unknown"
        return "contact" if self & Verdict.CONTACT else LABELS[self]


LABELS = ("normal", "actuator", "sensor", "both")  # of the verdicts 0 to 3
KINDS = (*LABELS, "contact")  # of what can be wrong in a run


class Reference(NamedTuple):
    """Desired motion at one tick.

    A joint is to hold the angle it has where a value is not finite, or is one that no joint can follow: faster than 300
    rad/s or 1e5 rad/s^2, or more than a turn outside its range (100 turns where the robot's file gives none).


    Attributes:
        q: [n, ...] rad.
        qd: [n, ...] rad/s.
        qdd: [n, ...] rad/s^2.
    """

    q: Array
    qd: Array
    qdd: Array


class Measurement(NamedTuple):
    """What the controller is told at one tick.

    A reading that is not finite, or where no joint can be, is absent: it is replaced by the model's prediction, and after a
    few ticks called a sensor fault. No joint can be more than a turn, and 30 rad/s since the last reading that was used,
    from where it is held to be. A torque beyond the limit is what the limit leaves; one that is not finite, or not given,
    counts as the controller's own command. Masked values count as not finite.

    Attributes:
        q: [n, ...] rad, encoder reading.
        tau: [n, ...] N m, torque commanded in the last tick; NaN (in Python also None) if it is not known.
    """

    q: Array
    tau: Array = None  # pyright: ignore[reportAssignmentType]


class SensorStatus(NamedTuple):
    """What the sensor check holds of each reading; the observer hears of it one tick later."""

    suspect: Array  # [n, ...] 1 where the reading is held to be wrong, for any of the reasons below or a steep drift
    transient: Array  # [n, ...] 1 where a velocity transient was found
    frozen: Array  # [n, ...] 1 where it is held to be frozen
    noisy: Array  # [n, ...] 1 where it is held to be noisy
    resolution: Array  # [n, ...] rad, size of the counts in which it comes where they are coarse, else 0


class Output(NamedTuple):
    """What one tick of the controller says.

    Attributes:
        tau: [n, ...] N m, torque command within the limits.
        fault_tau_hat: [n, ...] N m, estimated actuator fault.
        fault_q_hat: [n, ...] rad, estimated encoder fault.
        residual_tau: [n, ...] N m, Eq. (13), torque channel.
        residual_q: [n, ...] rad, Eq. (13), encoder channel.
        statistic_tau: [n, ...] N m, S of Eq. (14); alarm when its size reaches threshold_tau.
        statistic_q: [n, ...] rad.
        threshold_tau: [n, ...] N m.
        threshold_q: [n, ...] rad.
        verdict: [n, ...] int32, a Verdict's number, Eq. (18).
        detected: [...] bool, any joint not normal, Eq. (17).
        suspect: [n, ...] 1 where the sensor check holds the reading to be wrong, else 0.
        q_hat: [n, ...] rad, encoder reading less its estimated fault.
        qd_hat: [n, ...] rad/s.
        s: [n, ...] rad/s, sliding surface, Eq. (19).
        alpha_online: [n, ...] 1, fuzzy factor on the switching gain, Eq. (33); 1 where it is not
            used.
        force: [n, ...] N, size of a force on the link that the joint moves, where the verdict is a
            contact and the link is the last that it names; else 0.
        unsure: [n, ...] 1 where what is said of the joint is a guess: fault, kind unknown; else 0.
            The learned decision says it, and ``step`` where a state was lost. A joint that is called
            normal beside an alarm may have it too.
    """

    tau: Array
    fault_tau_hat: Array
    fault_q_hat: Array
    residual_tau: Array
    residual_q: Array
    statistic_tau: Array
    statistic_q: Array
    threshold_tau: Array
    threshold_q: Array
    verdict: Array
    detected: Array
    suspect: Array
    q_hat: Array
    qd_hat: Array
    s: Array
    alpha_online: Array
    force: Array
    unsure: Array
