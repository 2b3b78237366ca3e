"""Logs of different rates in one calibration."""

import types

import numpy as np

from jaxftc.cli.calibrate import one_rate
from jaxftc.cli.identify import log_config, read_logs
from jaxftc.robot.arm_table import Arm, Recording
from tests import small_logs


def test_a_log_of_another_rate_is_read_again_as_the_options_say(tmp_path):
    robot = small_logs.robot(tmp_path)
    paths = []
    for rate in (100, 125):
        table = small_logs.table(robot, rate=rate)
        odd = {"t": table["t"]} | {f"p{j}": np.rad2deg(table[f"q{j}"]) for j in (1, 2, 3)}
        odd |= {f"i{j} [A]": table[f"tau{j}"] / 9 for j in (1, 2, 3)}
        paths.append(small_logs.write(tmp_path / f"{rate}.csv", odd))
    given = tuple(f"q{j}=p{j}" for j in (1, 2, 3)) + tuple(f"tau{j}=i{j} [A]" for j in (1, 2, 3))
    options = types.SimpleNamespace(
        logs=paths, columns=given, degrees=True, torque_per_ampere=(9.0,), dt=None, check=True, json=True
    )
    arm = Arm(robot, Recording())
    first, other = one_rate(options, read_logs(options, paths, arm), arm, log_config(robot, 0.01))
    assert first.dt == other.dt == 0.01 and first.unit == other.unit == "N m"
    sizes = [(np.abs(log.q).max(0), np.abs(log.tau).max(0)) for log in (first, other)]
    for one, two in zip(*sizes, strict=True):
        np.testing.assert_allclose(one, two, rtol=0.1, atol=0.1)
