"""The PUMA 560: its numbers, and the MJCF made of them.

Standard Denavit-Hartenberg parameters, masses, inertias, motors and friction after Corke and Armstrong-Helouvry,
"A search for consensus among model parameters reported for the PUMA 560 robot" (1994). Link 1 has no mass of its own, so its
inertia about the joint goes into that joint's armature. Link 3 breaks the triangle inequality of principal inertias, as
published; ``model`` carries it as it is.
"""

from __future__ import annotations

import functools

import numpy as np

from jaxftc.robot.model import Robot
from jaxftc.robot.model_file import compile_robot

D = (0.67183, 0.0, 0.15005, 0.4318, 0.0, 0.0)  # m, link offset
A = (0.0, 0.4318, 0.0203, 0.0, 0.0, 0.0)  # m, link length
ALPHA = (np.pi / 2, 0.0, -np.pi / 2, np.pi / 2, -np.pi / 2, 0.0)  # rad, link twist
MASS = (0.0, 17.4, 4.8, 0.82, 0.34, 0.09)  # kg
COM = (  # m, in the link frame
    (0.0, 0.0, 0.0),
    (-0.3638, 0.006, 0.2275),
    (-0.0203, -0.0141, 0.070),
    (0.0, 0.019, 0.0),
    (0.0, 0.0, 0.0),
    (0.0, 0.0, 0.032),
)
INERTIA = (  # kg m^2, principal, at the centre of mass, in the link frame
    (0.0, 0.35, 0.0),
    (0.13, 0.524, 0.539),
    (0.066, 0.086, 0.0125),
    (1.8e-3, 1.3e-3, 1.8e-3),
    (0.3e-3, 0.4e-3, 0.3e-3),
    (0.15e-3, 0.15e-3, 0.04e-3),
)
MOTOR_INERTIA = (200e-6, 200e-6, 200e-6, 33e-6, 33e-6, 33e-6)  # kg m^2
GEAR = (62.6111, 107.815, 53.7063, 76.0364, 71.923, 76.686)
MOTOR_DAMPING = (1.48e-3, 0.817e-3, 1.38e-3, 71.2e-6, 82.6e-6, 36.7e-6)  # N m s/rad
COULOMB_POSITIVE = (0.395, 0.126, 0.132, 11.2e-3, 9.26e-3, 3.96e-3)  # N m at the motor, speed > 0
COULOMB_NEGATIVE = (0.435, 0.071, 0.105, 16.9e-3, 14.5e-3, 10.5e-3)  # N m at the motor, speed < 0
TORQUE_LIMIT = (97.6, 186.4, 89.4, 24.2, 20.1, 21.3)  # N m at the joint
TOOL = (0.0, 0.0, 0.05625)  # m, flange in the frame of link 6

_HEAD = """<!-- PUMA 560. Bodies are the links in standard DH order; every hinge turns about its body's z axis.
     armature = G^2 Jm, damping = G^2 B; user = Coulomb torque for positive and for negative speed, N m at the joint. -->
<mujoco model="puma560">
  <compiler angle="radian"/>
  <size nuser_jnt="2"/>
  <option gravity="0 0 -9.81"/>
  <worldbody>
"""


def _rotation_x(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def _numbers(values: object) -> str:
    return " ".join(f"{v:.12g}" for v in np.ravel(np.round(np.asarray(values, float), 15)))


def _link_inertia(link: int, principal: tuple[float, ...]) -> np.ndarray:
    """Inertia [3, 3] at the centre of mass in the MJCF body frame, which is turned by alpha against the DH link frame."""
    turn = _rotation_x(ALPHA[link])
    return turn @ np.diag(principal) @ turn.T


def mjcf(*, coulomb: bool = True) -> str:
    """The arm as MJCF text; the body frame of a link sits at its joint, where the DH frame sits at its far end."""
    links, motors, position, twist = [], [], np.zeros(3), 0.0
    for i in range(6):
        turn, offset = _rotation_x(ALPHA[i]), np.array([A[i], 0.0, D[i]])
        mass, com, armature = MASS[i], offset + turn @ np.array(COM[i]), GEAR[i] ** 2 * MOTOR_INERTIA[i]
        inertia = _link_inertia(i, INERTIA[i])
        if i == 0:  # only the inertia about the joint acts; it moves into the armature
            mass, com, armature, inertia = 1e-6, np.zeros(3), armature + INERTIA[0][1], 1e-6 * np.eye(3)
        friction = np.array([COULOMB_POSITIVE[i], COULOMB_NEGATIVE[i]]) * GEAR[i] * coulomb
        half = (np.cos(twist / 2), np.sin(twist / 2), 0.0, 0.0)
        indent = "    " + "  " * i
        full = (inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2])
        links.append(
            f'{indent}<body name="link{i + 1}" pos="{_numbers(position)}" quat="{_numbers(half)}">\n'
            f'{indent}  <joint name="joint{i + 1}" axis="0 0 1" armature="{armature:.12g}"'
            f' damping="{GEAR[i] ** 2 * MOTOR_DAMPING[i]:.12g}" user="{_numbers(friction)}"/>\n'
            f'{indent}  <inertial pos="{_numbers(com)}" mass="{mass:.12g}" fullinertia="{_numbers(full)}"/>\n'
        )
        limit = f"{TORQUE_LIMIT[i]:g}"
        motors.append(f'    <motor joint="joint{i + 1}" ctrllimited="true" ctrlrange="-{limit} {limit}"/>\n')
        position, twist = offset, ALPHA[i]
    indent = "    " + "  " * 6
    links.append(f'{indent}<site name="tool" pos="{_numbers(TOOL)}"/>\n')
    closing = "".join("    " + "  " * i + "</body>\n" for i in reversed(range(6)))
    tail = "  </worldbody>\n  <actuator>\n" + "".join(motors) + "  </actuator>\n</mujoco>\n"
    return _HEAD + "".join(links) + closing + tail


@functools.cache
def puma560(*, coulomb: bool = True) -> Robot:
    """The PUMA 560. ``coulomb=False`` is the arm of the paper's conditions: viscous friction only, in plant and model."""
    name = "puma560" if coulomb else "puma560 without Coulomb friction"
    return compile_robot(name, mjcf(coulomb=coulomb))
