"""An arm for what holds for every arm: its programs compile several times as fast as those of six joints."""

import functools

from benchmarks import arms
from jaxftc import Robot
from jaxftc.robot.model_file import compile_robot


def two_hinges() -> Robot:
    """The same with a joint less, for programs that are large."""
    return _arm("two hinges", 2)


def three_hinges() -> Robot:
    """Motors with limits, viscous friction, Coulomb friction that depends on the direction, gravity."""
    return _arm("three hinges", 3)


@functools.cache
def _arm(name: str, joints: int) -> Robot:
    text = arms.serial(joints).replace("<worldbody>", '<size nuser_jnt="2"/><worldbody>')
    robot = compile_robot(name, text.replace("<joint ", '<joint user="0.6 0.4" '))
    assert (robot.coulomb_positive > robot.coulomb_negative).all() and (robot.coulomb_negative > 0).all()
    return robot
