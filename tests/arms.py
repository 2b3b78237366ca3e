"""An arm for what holds for every arm: its programs compile several times as fast as those of six joints."""

import functools

from benchmarks import arms
from jaxftc import Robot
from jaxftc.arm.robot import compile_robot


@functools.cache
def three_hinges() -> Robot:
    """Motors with limits, viscous and Coulomb friction, gravity: all that the PUMA 560 has."""
    return compile_robot("arm3", arms.serial(3).replace('damping="1"', 'damping="1" frictionloss="0.5"'))
