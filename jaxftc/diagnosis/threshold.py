"""Torque threshold of a tick, Eq. (14), block 6: constant, or one that follows the motion.

What a model has wrong of an arm shows where the arm moves: friction with the speed and where it changes sign, motors'
inertia with the acceleration, masses with the torque that the links need, and a payload with the torque that it needs. So

    alpha(t) = alpha_tau (1 + f_v |qd| + f_a |qdd| + f_r (1 - tanh^2(qd / v_c)) + f_t |tau_links| + f_p |tau_payload|),

v_c the width of the robot's Coulomb friction, tau_links = M qdd + h of the nominal links, tau_payload that of 1 kg at the
tool. No share f is negative, so that no threshold is lower than ``alpha_tau``, and a scale on that is one on all of it.
Shares of zero are the paper's constant threshold, to the last bit.

The motion is the reference, where there is one: no fault moves that, so none raises its own threshold.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxftc.compile.box import box
from jaxftc.gains import DiagnosisGains, Gains
from jaxftc.numerics.barrier import store, unstack
from jaxftc.robot import lanes, rigid_body
from jaxftc.robot.model import Robot
from jaxftc.types import Array, Reference

FOLLOW = ("follow_speed", "follow_acceleration", "follow_reversal", "follow_torque", "follow_payload")  # as in ``Motion``
GAINS = tuple(f"diagnosis.{name}" for name in FOLLOW)


class Motion(NamedTuple):
    """What a torque threshold can follow; none of it is negative."""

    speed: Array  # [n, ...] rad/s
    acceleration: Array  # [n, ...] rad/s^2
    reversal: Array  # [n, ...] 1, slope of the friction's sign over its largest, 1 where the joint turns round
    torque: Array  # [n, ...] N m, that the nominal links need
    payload: Array  # [n, ...] N m, that 1 kg at the tool needs


@box("Block 6: the motion that thresholds follow")
def motion(robot: Robot, q: Array, qd: Array, qdd: Array) -> Motion:
    """The motion at q [n, ...] rad, qd rad/s and qdd rad/s^2, by its sizes."""
    turn = jnp.tanh(qd / robot.coulomb_speed)
    at, speeds, accelerations = rigid_body.pose(robot, q), unstack(qd), unstack(qdd)
    bodies = rigid_body.nominal_inertias(robot), rigid_body.payload_inertias(robot)
    torques = (lanes.stack(rigid_body.newton_euler(robot, body, at, speeds, accelerations), q) for body in bodies)
    return Motion(jnp.abs(qd), jnp.abs(qdd), 1 - turn * turn, *map(jnp.abs, torques))


def torque(gains: DiagnosisGains, at: Motion) -> Array:
    """Threshold [n, ...] N m of the torque channel."""
    share = sum(getattr(gains, name) * size for name, size in zip(FOLLOW, at, strict=True))
    return store(gains.alpha_tau * (1 + share))


def of_reference(robot: Robot, gains: DiagnosisGains, reference: Reference) -> Array:
    """Threshold [n, ...] N m for the wanted motion; where it is known to follow nothing, the motion is not looked at."""
    if follows(gains):
        return torque(gains, motion(robot, *reference))
    return jnp.broadcast_to(gains.alpha_tau, reference.q.shape)


def follows(gains: DiagnosisGains) -> bool:
    """Whether a threshold may follow the motion: a share is not zero, or not known when tracing."""
    shares = [getattr(gains, name) for name in FOLLOW]
    return any(isinstance(share, Tracer) or bool(np.asarray(share).any()) for share in shares)


def known_constant(gains: Gains) -> Gains:
    """The gains with shares that are known to be zero when tracing: for a program of constant thresholds."""
    zeros = {name: np.zeros(np.shape(getattr(gains.diagnosis, name)), np.float32) for name in FOLLOW}
    return dataclasses.replace(gains, diagnosis=dataclasses.replace(gains.diagnosis, **zeros))
