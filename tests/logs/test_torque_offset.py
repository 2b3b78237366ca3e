"""The torque offset of an arm's file is taken off once: thresholds and residuals do not have it in them."""

import json

import numpy as np
import pytest

import jaxftc
from jaxftc.cli.main import main
from tests import small_logs

OFFSET = (9.0, -6.0, 3.0)  # N m, of the torques as recorded


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("offset")
    robot = small_logs.robot(folder)
    table = small_logs.table(robot, seconds=16.0)
    for j, (own, more) in enumerate(zip(small_logs.OFFSET, OFFSET, strict=True)):
        table[f"tau{j + 1}"] += more - own
    small_logs.write(folder / "log.csv", table)
    both = {f"{name}_{side}": value for side in ("positive", "negative")
            for name, value in (("coulomb", small_logs.COULOMB), ("damping", small_logs.VISCOUS))}  # fmt: skip
    recording = jaxftc.Recording(torque_offset=tuple(-np.array(OFFSET)))
    jaxftc.save_arm(folder / "arm.toml", jaxftc.Arm(robot.replace(armature=small_logs.MOTOR, **both), recording))
    return folder


def test_neither_thresholds_nor_residuals_have_the_offset(folder, capsys):
    import duckdb

    log, thresholds, out = (str(folder / name) for name in ("log.csv", "thresholds", "out"))
    main(["calibrate", "--robot", str(folder), "--logs", log, "--false-alarms", "0.2", "--out", thresholds, "--json"])
    level = list(json.loads(capsys.readouterr().out)["alpha_tau_nm"].values())
    assert (np.array(level) < 0.3 * np.abs(OFFSET)).all()
    main(["diagnose", log, "--robot", str(folder), "--gains", f"{thresholds}/gains.toml", "--out", out, "--json"])
    assert json.loads(capsys.readouterr().out)["alarm_share"] == 0
    names = [f'avg("statistic_tau_{name}")' for name in ("pan", "shoulder_joint", "elbow_joint")]
    mean = duckdb.sql(f"select {', '.join(names)} from '{out}/samples.parquet'").fetchall()[0]
    assert np.abs(mean).max() < 0.2
