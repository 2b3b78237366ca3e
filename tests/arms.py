"""An arm for what holds for every arm: its programs compile several times as fast as those of six joints."""

import functools
import tempfile
from pathlib import Path

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
def two_hinges_file() -> Path:
    """The arm of two hinges as a robot file, which lasts as long as the process."""
    _FOLDERS.append(tempfile.TemporaryDirectory())
    path = Path(_FOLDERS[-1].name) / "two.xml"
    path.write_text(_text(2))
    return path


_FOLDERS: list[tempfile.TemporaryDirectory] = []


def _text(joints: int) -> str:
    text = arms.serial(joints).replace("<worldbody>", '<size nuser_jnt="2"/><worldbody>')
    return text.replace("<joint ", '<joint user="0.6 0.4" ')


@functools.cache
def _arm(name: str, joints: int) -> Robot:
    robot = compile_robot(name, _text(joints))
    assert (robot.coulomb_positive > robot.coulomb_negative).all() and (robot.coulomb_negative > 0).all()
    return robot
