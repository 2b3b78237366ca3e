"""What no arm does: bounds beyond which a signal says nothing of the arm.

Wide on purpose. A fault of the encoder is the observer's to find and stays far inside them; what
lies outside is a unit mixed up, a wire or a memory, and no estimate may be made of it.
"""

from __future__ import annotations

import math

import numpy as np

from jaxftc.robot.model import Robot

TURN = 2 * math.pi  # rad, all that an encoder of one turn can be off by
SPEED = 30.0  # rad/s, of a joint; quick arms reach 10
REFERENCE_SPEED = 300.0  # rad/s; a planner may ask for somewhat more than the arm can do, and means it
REFERENCE_ACCELERATION = 1e5  # rad/s^2
TURNS = 100  # of a joint without a range; from there on float32 resolves an encoder's noise no more


def angles(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Middle and half width [n] rad of the angles that a reading or a reference can have: the range, and a turn beyond."""
    model = robot.mj_model
    low, high = np.where(model.jnt_limited[:, None] > 0, model.jnt_range, TURNS * TURN * np.array([-1.0, 1.0])).T
    return 0.5 * (low + high), 0.5 * (high - low) + TURN


def limited(robot: Robot) -> bool:
    """Whether any joint has a range."""
    return bool(np.any(robot.mj_model.jnt_limited))
