"""Logs of every kind, and what a user reads of a bad one."""

import re
import sqlite3
import struct

import numpy as np
import pytest
import small_logs

from jaxftc import Config, logs
from jaxftc.io.tables import write_parquet
from jaxftc.logs.clock import uneven
from jaxftc.robot.arm_table import Arm, Recording


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return small_logs.robot(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def good(arm):
    return small_logs.table(arm)


def renamed(table, **pairs):
    """Columns under other names; the rest goes."""
    return {new: table[old] for old, new in pairs.items()}


def our(table, q="q{}", tau="tau{}", t="t", first=1, order=(0, 1, 2)):
    """Columns under names with a number or a joint's name in them."""
    label = [q.format(k + first) for k in range(3)], [tau.format(k + first) for k in range(3)]
    out = {t: table["t"]}
    for names, word in zip(label, ("q", "tau"), strict=True):
        out |= {names[k]: table[f"{word}{k + 1}"] for k in order}
    return out


def by_name(table, text, words, order=(0, 1, 2)):
    joints = ("pan", "shoulder_joint", "elbow_joint")
    return {
        text.format(joint=joints[k], word=word): table[f"{ours}{k + 1}"]
        for k in order
        for ours, word in zip(("q", "tau"), words, strict=True)
    }


def same(log, good):
    np.testing.assert_allclose(log.q, np.stack([good[f"q{j}"] for j in (1, 2, 3)], 1), atol=1e-6)
    np.testing.assert_allclose(log.tau, np.stack([good[f"tau{j}"] for j in (1, 2, 3)], 1), atol=1e-5)
    assert log.dt == 0.01 and log.stretches == ((0, 600),) and log.t[0] == 0 and abs(log.t[-1] - 5.99) < 1e-6


WRITTEN = {
    "comma": lambda path, table: small_logs.write(path, table),
    "semicolon, decimal comma": lambda path, table: small_logs.write(path, table, ";", comma=True),
    "tab": lambda path, table: small_logs.write(path, table, "\t"),
    "blanks": lambda path, table: small_logs.write(path, table, "  "),
    "comma and blank": lambda path, table: small_logs.write(path, table, ", "),
    "byte-order mark": lambda path, table: path.write_bytes(b"\xef\xbb\xbf" + small_logs.write(path, table).read_bytes()),
    "Windows": lambda path, table: path.write_bytes(small_logs.write(path, table).read_bytes().replace(b"\n", b"\r\n")),
    "UTF-16": lambda path, table: path.write_bytes(small_logs.write(path, table).read_text().encode("utf-16")),
    "comments": lambda path, table: path.write_text(
        "# made by hand\n% a remark\n" + small_logs.write(path, table).read_text()
    ),
    "head in a comment": lambda path, table: path.write_text("# " + small_logs.write(path, table).read_text()),
    "ur_rtde": lambda path, table: small_logs.write(
        path, our(table, "actual_q_{}", "actual_joint_torques_{}", "timestamp", first=0), " "
    ),
    "libfranka": lambda path, table: small_logs.write(
        path,
        our(table | {"t": (1000 * table["t"]).round().astype(int)}, "state.q[{}]", "state.tau_J[{}]", "time", first=0)
        | {"state.q_d[0]": table["q1"], "control.tau_J_d[0]": table["tau1"], "success_rate": table["q1"]},
        ", ",
    ),
    "PlotJuggler": lambda path, table: small_logs.write(
        path,
        {"__time": 1.7e9 + table["t"]} | by_name(table, "/joint_states/{joint}/{word}", ("position", "effort"), (2, 0, 1)),
    ),
    "joint names without _joint": lambda path, table: small_logs.write(
        path,
        {"t": table["t"]} | {k.replace("_joint", ""): v for k, v in by_name(table, "{word}_{joint}", ("q", "tau")).items()},
    ),
    "simulate": lambda path, table: small_logs.write(
        path, {"t": table["t"]} | by_name(table, "{word}_{joint}", ("y", "tau"))
    ),
    "joint1_position": lambda path, table: small_logs.write(path, our(table, "joint{}_position", "joint{}_torque", "time")),
    "milliseconds": lambda path, table: small_logs.write(path, table | {"t": 1000 * table["t"]}),
    "microseconds": lambda path, table: small_logs.write(path, table | {"t": 1e6 * table["t"]}),
    "whole nanoseconds": lambda path, table: small_logs.write(
        path, table | {"t": [1_700_000_000_000_000_000 + round(1e9 * t) for t in table["t"]]}
    ),
    "ISO dates": lambda path, table: small_logs.write(
        path,
        table | {"t": [str(s) + "Z" for s in np.datetime64("2026-01-02T03:04:05") + (1e6 * table["t"]).astype("m8[us]")]},
    ),
    "seconds and nanoseconds": lambda path, table: small_logs.write(
        path,
        {"header.stamp.sec": table["t"].astype(int) + 5, "header.stamp.nanosec": (1e9 * (table["t"] % 1)).round()}
        | {k: v for k, v in table.items() if k != "t"},
    ),
    "degrees in the name": lambda path, table: small_logs.write(
        path, our({k: np.rad2deg(v) if k[0] == "q" else v for k, v in table.items()}, q="q{}_deg")
    ),
    "degrees": lambda path, table: small_logs.write(
        path, {k: np.rad2deg(v) if k[0] == "q" else v for k, v in table.items()}
    ),
    "wrapped": lambda path, table: small_logs.write(path, table | {"q3": (table["q3"] + np.pi) % (2 * np.pi) - np.pi}),
    "an unneeded text column": lambda path, table: small_logs.write(path, table | {"mode": ["run"] * len(table["t"])}),
    "the last line cut short": lambda path, table: path.write_text(small_logs.write(path, table).read_text() + "6.0,0.1,0."),
    "a stamp twice": lambda path, table: small_logs.write(path, {k: np.insert(v, 100, v[100]) for k, v in table.items()}),
    "a row again": lambda path, table: small_logs.write(path, {k: np.insert(v, 100, v[90]) for k, v in table.items()}),
    "each row twice": lambda path, table: small_logs.write(path, {k: np.repeat(v, 2) for k, v in table.items()}),
    "rows backwards": lambda path, table: small_logs.write(path, {k: v[::-1] for k, v in table.items()}),
    "ten million seconds on": lambda path, table: small_logs.write(path, table | {"t": 1e7 + table["t"]}),
    "single precision, a day on": lambda path, table: small_logs.write(
        path, table | {"t": np.float32(1e5 + table["t"]).astype(float)}
    ),
    "single precision, ten million seconds on": lambda path, table: small_logs.write(
        path, table | {"t": np.float32(1e7 + table["t"]).astype(float)}
    ),
    "whole seconds": lambda path, table: small_logs.write(path, table | {"t": np.floor(table["t"] + 1e-9)}),
    "stamps of two rows each": lambda path, table: small_logs.write(
        path, table | {"t": np.floor(50 * table["t"] + 0.1) / 50}
    ),
    "times of the day, over midnight": lambda path, table: small_logs.write(
        path, table | {"t": [f"{h:02d}:{m:02d}:{s:09.6f}" for h, m, s in map(clock, 86398 + table["t"])]}
    ),
    "dates of another form, decimal comma": lambda path, table: small_logs.write(
        path, table | {"t": [f"31/01/2026 00:00:{t:09.6f}".replace(".", ",") for t in table["t"]]}, ";"
    ),
    "dates with a zone": lambda path, table: small_logs.write(
        path, table | {"t": [f"2026-01-31T00:00:{t:09.6f}+01:00" for t in table["t"]]}
    ),
    "minutes in the name": lambda path, table: small_logs.write(
        path, {"t [min]": table["t"] / 60} | {k: v for k, v in table.items() if k != "t"}
    ),
    "milliradians in the name": lambda path, table: small_logs.write(
        path, our({k: 1e3 * v if k[0] == "q" else v for k, v in table.items()}, q="q{} [mrad]")
    ),
    "turns in the name": lambda path, table: small_logs.write(
        path, our({k: v / (2 * np.pi) if k[0] == "q" else v for k, v in table.items()}, q="position_{} (rev)")
    ),
    "units joint by joint in the names": lambda path, table: small_logs.write(
        path,
        {
            "t [s]": table["t"],
            "q1 [rad]": table["q1"],
            "q2 [deg]": np.rad2deg(table["q2"]),
            "q3 [mrad]": 1e3 * table["q3"],
            "tau1 [N·m]": table["tau1"],
            "tau2 [Nm]": table["tau2"],
            "tau3 [N cm]": 1e2 * table["tau3"],
        },
        ";",
    ),
    "measuredJointPosition": lambda path, table: small_logs.write(
        path,
        our(table, "measuredJointPosition[{}]", "measuredTorque[{}]", "timestamp", first=0)
        | {f"externalTorque[{k}]": table["t"] for k in range(3)}
        | {f"commandedJointPosition[{k}]": table["t"] for k in range(3)},
    ),
    "actuators[0].position": lambda path, table: small_logs.write(
        path, our(table, "base.actuators[{}].position", "base.actuators[{}].torque", "time_us", first=0) | us(table)
    ),
    "q1_measured": lambda path, table: small_logs.write(path, our(table, "q{}_measured", "tau{}_measured", "elapsed_time")),
    "a unit says what no word does": lambda path, table: small_logs.write(
        path, our(table, "J{} [rad]", "M{} (N m)", "Time [s]") | {f"Mext{k} [Nm]": table["t"] for k in (1, 2, 3)}, ";"
    ),
    "rostopic echo -p": lambda path, table: small_logs.write(
        path,
        {"%time": [1_700_000_000_000_000_000 + round(1e9 * t) for t in table["t"]]}
        | {f"field.name{k}": ["joint"] * len(table["t"]) for k in range(3)}
        | our(table, "field.position{}", "field.effort{}", "field.header.stamp", first=0)
        | {"field.header.stamp": [1_700_000_000_000_000_000 + round(1e9 * t) for t in table["t"]]},
    ),
    "the least and the mean of each joint beside it": lambda path, table: small_logs.write(
        path, table | {f"{word}{k}_{of}": table["t"] for word in ("q", "tau") for k in (1, 2, 3) for of in ("min", "mean")}
    ),
    "current_a beside torque": lambda path, table: small_logs.write(
        path, our(table) | {f"motor{k}_current_a": table["t"] for k in (1, 2, 3)}
    ),
    "axes alone are angles": lambda path, table: small_logs.write(path, our(table, "A{}", "torque_A{}", "Time")),
    "joint names alone are angles": lambda path, table: small_logs.write(
        path, {"t": table["t"]} | {k.strip("_"): v for k, v in by_name(table, "{word}_{joint}", ("", "effort")).items()}
    ),
    "a row of units": lambda path, table: path.write_text(
        below_head(
            small_logs.write(path, {k: np.rad2deg(v) if k[0] == "q" else v for k, v in table.items()}),
            "[s],[deg],[deg],[deg],[Nm],[Nm],[Nm]",
        )
    ),
    "a title before the table": lambda path, table: path.write_text(
        "Recording 7, arm of the lab\nmade by hand\n\n" + small_logs.write(path, table).read_text()
    ),
    "the head again": lambda path, table: path.write_text(below_head(small_logs.write(path, table), ",".join(table))),
    "rows counted in a column without a name": lambda path, table: path.write_text(
        counted(small_logs.write(path, table, " ").read_text())
    ),
    "what was wanted beside what was measured": lambda path, table: small_logs.write(
        path,
        {"t": table["t"]}
        | by_name({k: v + 1 for k, v in table.items()}, "/joint_command/{joint}/{word}", ("position", "effort"))
        | by_name(table, "/joint_states/{joint}/{word}", ("position", "effort")),
    ),
}


def us(table):
    """The time in whole microseconds of a clock."""
    return {"time_us": [1_700_000_000_000_000 + round(1e6 * t) for t in table["t"]]}


def clock(t):
    """Hours, minutes and seconds of the day."""
    return int(t // 3600) % 24, int(t // 60) % 60, t % 60


def below_head(path, line):
    head, rest = path.read_text().split("\n", 1)
    return f"{head}\n{line}\n{rest}"


def counted(text):
    head, *lines = text.splitlines()
    return "\n".join([head, *(f"{k} {line}" for k, line in enumerate(lines, start=1))])


@pytest.mark.parametrize("way", WRITTEN)
def test_a_log_is_read_however_it_was_written(way, arm, good, tmp_path):
    path = tmp_path / "log.csv"
    WRITTEN[way](path, good)
    same(logs.read(path, arm), good)


def joint_state(stamp, names, *signals):
    """One message in CDR, as ROS 2 writes it."""
    out = bytearray(b"\x00\x01\x00\x00")

    def put(form, *values):
        size = struct.calcsize(form[-1])
        out.extend(b"\0" * (-(len(out) - 4) % size))
        out.extend(struct.pack("<" + form, *values))

    def text(value):
        put("I", len(value) + 1)
        out.extend(value.encode() + b"\0")

    put("I", stamp // 10**9)
    put("I", stamp % 10**9)
    text("base")
    put("I", len(names))
    for name in names:
        text(name)
    for signal in signals:
        put("I", len(signal))
        if len(signal):
            put(f"{len(signal)}d", *signal)
    return bytes(out)


def bag(path, good, topic="/joint_states", kind="sensor_msgs/msg/JointState", effort=True, names=None):
    names = names or ["elbow_joint", "pan", "shoulder_joint"]
    with sqlite3.connect(path) as base:
        base.execute("create table topics(id integer primary key, name text, type text, serialization_format text)")
        base.execute("create table messages(id integer primary key, topic_id integer, timestamp integer, data blob)")
        base.execute("insert into topics values (1, ?, ?, 'cdr')", (topic, kind))
        for k, t in enumerate(good["t"]):
            q, tau = ([good[f"{word}{j}"][k] for j in (3, 1, 2)] for word in ("q", "tau"))
            stamp = 10**18 + round(1e9 * t)
            message = joint_state(stamp, names, q, [], tau if effort else [])
            base.execute("insert into messages values (?, 1, ?, ?)", (k, stamp + 5 * 10**6, message))
    base.close()
    return path


def test_a_bag_is_read_without_metadata_beside_it(arm, good, tmp_path):
    same(logs.read(bag(tmp_path / "log.db3", good), arm), good)


def test_a_gripper_on_the_same_topic_is_left_out(arm, good, tmp_path):
    path = bag(tmp_path / "log.db3", good)
    with sqlite3.connect(path) as base:
        for k in range(900):  # more often than the arm, and before it
            stamp = 10**18 + k * 7 * 10**6
            base.execute(
                "insert into messages values (?, 1, ?, ?)",
                (1000 + k, stamp, joint_state(stamp, ["finger"], [0.01], [], [0.0])),
            )
    base.close()
    log = logs.read(path, arm)
    same(log, good)
    assert any("900 messages on /joint_states name other joints than elbow_joint, pan" in note for note in log.notes)


def test_mcap_is_read(arm, good, tmp_path):
    pytest.importorskip("rosbags", reason="the extra `logs`")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        at = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        for k, t in enumerate(good["t"]):
            q, tau = ([good[f"{word}{j}"][k] for j in (3, 1, 2)] for word in ("q", "tau"))
            stamp = 10**18 + round(1e9 * t)
            writer.write(at, stamp, joint_state(stamp, ["elbow_joint", "pan", "shoulder_joint"], q, [], tau))
    same(logs.read(tmp_path / "bag", arm), good)
    same(logs.read(next((tmp_path / "bag").glob("*.mcap")), arm), good)


def test_states_as_lists_are_read(arm, good, tmp_path):
    import duckdb

    state = [[float(good[f"q{j}"][k]) for j in (1, 2, 3)] + [0.5] for k in range(600)]
    effort = [[float(good[f"tau{j}"][k]) for j in (1, 2, 3)] for k in range(600)]
    path = tmp_path / "episode[1].parquet"  # DuckDB reads a path as a pattern; LeRobot stamps in single precision
    rows = list(zip(good["t"].tolist(), state, effort, strict=True))
    with duckdb.connect() as base:
        base.execute('create table rows("timestamp" float, "observation.state" double[], "observation.effort" double[])')
        base.executemany("insert into rows values (?, ?, ?)", rows)
        base.execute(f"copy rows to '{path}' (format parquet)")
    log = logs.read(path, arm)
    assert any("beyond the arm's 3 joints" in note for note in log.notes)
    np.testing.assert_allclose(log.q[:, 2], good["q3"], atol=1e-4)
    np.testing.assert_allclose(log.tau[:, 2], good["tau3"], atol=0.01)


def moved(table, **change):
    return table | {k: v(table[k]) if callable(v) else v for k, v in change.items()}


def without(table, *names):
    return {k: v for k, v in table.items() if k not in names}


def cells(values, **at):
    out = [f"{v:.9g}" for v in values]
    for row, cell in at.items():
        out[int(row[1:]) - 1] = cell
    return out


def rows(table, keep):
    return {k: np.asarray(v)[keep] for k, v in table.items()}


def gap(table, start, stop):
    return rows(table, np.r_[0:start, stop : len(table["t"])])


def half_rate(table):
    return rows(table, slice(None, None, 2))


def scrambled(table):
    return {k: np.r_[v[:99], 253.0, v[100:]] if k[0] == "q" else v for k, v in table.items()}


def times(table, factor, *names):
    """Columns of those words, or of those names, times a factor."""
    return {k: factor * v if k in names or k.rstrip("123") in names else v for k, v in table.items()}


K = np.arange(600)
REFUSED = {  # what is wrong: (the log, the line that a user reads, options)
    "no time": (lambda t: without(t, "t"), "no column of time (t, time, timestamp, ...) among q1, q2, q3"),
    "no angles": (lambda t: without(t, "q1", "q2", "q3"), "the log must have columns q1 to q3 in rad, or q_pan and so on"),
    "an angle missing": (lambda t: without(t, "q2"), "the log must have columns q1 to q3 for the arm's 3 joints"),
    "a torque missing": (lambda t: without(t, "tau3"), "columns tau1 to tau3 for the arm's 3 joints (pan, shoulder_joint"),
    "text in a cell": (
        lambda t: t | {"q2": cells(t["q2"], r7="oops")},
        "row 7, column 'q2': must be a number in rad, got 'oops'",
    ),
    "text as torque": (lambda t: t | {"tau1": ["on"] * 600}, "row 1, column 'tau1': must be a number in N m, got 'on'"),
    "text as time": (
        lambda t: t | {"t": ["noon"] * 600},
        "column 't' must hold the time as numbers or ISO dates, got 'noon'",
    ),
    "a column without numbers": (lambda t: t | {"tau2": [""] * 600}, "column 'tau2' holds no number in any row"),
    "most rows hollow": (
        lambda t: t | {"q1": np.where(K % 3 == 0, t["q1"], np.nan)},
        "400 of 600 rows miss a value, the first is row 2",
    ),
    "time that stands": (
        lambda t: t | {"t": np.zeros(600)},
        "column 't' must increase from row to row, it is 0.0 throughout",
    ),
    "empty times": (lambda t: t | {"t": [""] * 600}, "column 't' must hold times, it is empty in every row"),
    "rows in no order": (lambda t: rows(t, np.random.default_rng(0).permutation(600)), "rows, the first is row"),
    "time backwards": (lambda t: t | {"t": t["t"][::-1]}, "found before: the rows run backwards in time; turned round"),
    "only gaps": (
        lambda t: t | {"t": t["t"] + 10.0 * (K // 10)},
        "no stretch of 20 rows is without a gap of more than 0.05 s",
    ),
    "too short": (lambda t: rows(t, slice(0, 60)), "the log has 60 rows at 10 ms, at least 100 are needed"),
    "rows of another message": (scrambled, "row 100, column of joint 2: 253 rad after"),
    "a number of rows of another message": (
        lambda t: {k: np.where((K > 10) & (K < 16), 40.0 * K, v) if k[0] == "q" else v for k, v in t.items()},
        "such rows, the last is row 17: they are no readings of this arm, so cut them out of the file",
    ),
    "torques of another message": (
        lambda t: {k: np.where(K == 40, 1e4, v) if k[:3] == "tau" else v for k, v in t.items()},
        "row 41, column of torque 1: 10000 N m, the limit is 80 N m, and other joints exceed theirs with it; 1 such rows",
    ),
    "torque turned round": (
        lambda t: t | {"tau2": -t["tau2"]},
        "column of torque 2 (shoulder_joint) goes against gravity and friction at slow motion: its sign is turned round",
    ),
    "torque turned round, no gravity on it": (
        lambda t: t | {"tau1": -t["tau1"]},
        "column of torque 1 (pan) goes against gravity and friction at slow motion",
    ),
    "torques swapped": (
        lambda t: t | {"tau2": t["tau3"], "tau3": t["tau2"]},
        "columns of torque 2 and 3 (shoulder_joint, elbow_joint) fit each other's joint at slow motion: they are swapped",
    ),
    "angle turned round": (
        lambda t: t | {"q2": -t["q2"]},
        "column of angle 2 (shoulder_joint) makes the torques fit when its sign",
    ),
    "angles swapped": (
        lambda t: t | {"q2": t["q3"], "q3": t["q2"]},
        "columns of angle 2 and 3 (shoulder_joint, elbow_joint) make the torques fit when they are swapped",
    ),
    "a dead torque": (
        lambda t: t | {"tau2": np.zeros(600)},
        "column of torque 2 (shoulder_joint) is 0 in every row while the joint moves",
    ),
    "faster than recorded": (half_rate, "the log has a row every 20 ms (50 Hz) and 1 ms are wanted", {"dt": 0.001}),
    "a column that is not there": (lambda t: t, "column q1 must be one of 't', 'q1'", {"columns": {"q1": "nope"}}),
    "some columns only": (
        lambda t: t,
        "--columns names some of q1 to q3, but not q2",
        {"columns": {"q1": "q2", "q3": "q1"}},
    ),
    "a name that is not ours": (lambda t: t, "--columns must be one of 't', 'q1'", {"columns": {"angle": "q1"}}),
    "a torque constant of 0": (lambda t: t, "torque_per_ampere must be one number or 3", {"torque_per_ampere": 0.0}),
    "too many torque constants": (
        lambda t: t,
        "torque_per_ampere must be one number or 3",
        {"torque_per_ampere": [1.0, 2.0]},
    ),
    "a sample time of 0": (lambda t: t, "dt must be a positive, finite number of seconds", {"dt": 0.0}),
    "the same name twice": (lambda t: {**t, " q1": t["q1"]}, "two columns are named 'q1'"),
    "two names for one thing": (lambda t: {**t, "Q_2": t["q1"]}, "columns 'q2' and 'Q_2' name one thing"),
    "two arms": (
        lambda t: (
            {"t": t["t"]}
            | by_name(t, "left_{joint}/{word}", ("position", "effort"))
            | by_name(t, "right_{joint}/{word}", ("position", "effort"))
        ),
        "columns of 2 arms or topics fit, as 'left_pan/position' and 'right_pan/position' say",
    ),
    "counts": (
        lambda t: {k: np.round((v + np.pi) * 4096 / 6.2832) if k[0] == "q" else v for k, v in t.items()},
        "in half of the rows, its range ends at 3.1 rad: counts, milliradians, or the motor's side of the gear?",
    ),
    "milliradians": (lambda t: {k: 1e3 * v if k[0] == "q" else v for k, v in t.items()}, "angles of joint 1 (pan) are"),
    "one angle in degrees": (
        lambda t: times(t, 180 / np.pi, "q2"),
        "column of angle 2 (shoulder_joint) makes the torques fit in degrees while the others are in rad; name the unit",
    ),
    "one angle in degrees, no gravity on it": (
        lambda t: times(t, 180 / np.pi, "q1"),
        "column of angle 1 (pan) makes the torques fit in degrees while the others are in rad; name the unit of every angle",
    ),
    "one angle in rad": (
        lambda t: times(t, 180 / np.pi, "q1", "q3"),
        "column of angle 2 (shoulder_joint) makes the torques fit in rad while the others are in degrees; name the unit",
    ),
    "one angle in turns": (
        lambda t: times(t, 0.5 / np.pi, "q2"),
        "column of angle 2 (shoulder_joint) makes the torques fit in turns while the others are in rad; name the unit",
    ),
    "angles in turns": (
        lambda t: times(t, 0.5 / np.pi, "q"),
        "the angles of all joints make the torques fit in turns; name the unit in the head, such as q1 [rev]",
    ),
    "one angle without a unit": (
        lambda t: renamed(t, t="t", q1="q1 [deg]", q2="q2", q3="q3 [deg]"),
        "column 'q2' has no unit and others have; name the unit of each angle in the head, such as q1 [rad]",
    ),
    "torques of two units": (
        lambda t: renamed(t, t="t", q1="q1", q2="q2", q3="q3", tau1="i1 [A]", tau2="i2 [mA]", tau3="i3 [A]"),
        "the torque columns are in A, mA, A by joint; give all in one unit, or --torque-per-ampere",
    ),
    "torques on the motors' side": (
        lambda t: times(t, 0.01, "tau"),
        "the torque columns look like another unit, torques on the motor's side of the gear or shares of a rated torque",
    ),
    "millinewtonmetres": (
        lambda t: {k: 1e3 * v if k[:3] == "tau" else v for k, v in t.items()},
        "in half of the rows, its limit is 80 N m: another unit?",
    ),
    "days": (lambda t: t | {"t": 45000 + t["t"] / 86400}, "rad/s; name the unit of time in the head, such as t [min]"),
    "a time that stands, as text": (
        lambda t: t | {"t": ["12:00:00"] * 600},
        "it is 43200.0 throughout; without it, --dt gives",
    ),
    "all torques turned round": (
        lambda t: {k: -v if k[:3] == "tau" else v for k, v in t.items()},
        "the torques of all joints go against gravity and friction at slow motion",
    ),
    "all angles turned round": (
        lambda t: {k: -v if k[0] == "q" else v for k, v in t.items()},
        "the angles of all joints make the torques fit when their sign is turned round",
    ),
    "two joints swapped": (
        lambda t: t | {"q2": t["q3"], "q3": t["q2"], "tau2": t["tau3"], "tau3": t["tau2"]},
        "when the joints are taken with 2 and 3 (shoulder_joint, elbow_joint) swapped",
    ),
    "joints shifted": (
        lambda t: t | {f"{w}{j % 3 + 1}": t[f"{w}{(j + 1) % 3 + 1}"] for w in ("q", "tau") for j in range(3)},
        "when the joints are taken shifted by 2: joint 1 is number 3 of the file",
    ),
}


@pytest.mark.parametrize("defect", REFUSED)
def test_what_cannot_be_read_is_refused_in_one_line(defect, arm, good, tmp_path):
    spoil, words, *options = REFUSED[defect]
    path = small_logs.write(tmp_path / "log.csv", spoil(good))
    with pytest.raises(ValueError, match=re.escape(words)) as refusal:
        logs.read(path, arm, **(options[0] if options else {}))
    assert "\n" not in str(refusal.value) and (str(path) in str(refusal.value) or options)


FILES = {
    "no file": ("log.csv", None, "there is no such file"),
    "another suffix": ("log.xlsx", b"", "a log is one of .csv, .tsv"),
    "bytes": ("log.csv", b"\x00\x01\x02", "this is a binary file and not text"),
    "nothing": ("log.csv", b"", "the file has no rows"),
    "comments only": ("log.csv", b"# t,q1\n", "the file has no rows"),
    "a head only": ("log.csv", b"t,q1,q2\n", "the file has a head and no rows"),
    "no head": ("log.csv", b"0,1,2\n1,2,3\n", "it has column 1, column 2, column 3"),
    "decimal commas between commas": (
        "log.csv",
        b"t,q1,q2\n0,0,1,5,2,5\n0,1,1,6,2,5\n",
        "line 2 has 6 columns, the head has 3; mend or remove that line; are these decimal commas?",
    ),
    "a row of another length": ("log.csv", b"t,q1,q2\n0,1,2\n1,2\n3,4,5\n", "line 3 has 2 columns, the head has 3"),
    "text as Parquet": ("log.parquet", b"t,q1\n0,1\n", "cannot read"),
    "text as a bag": ("log.db3", b"t,q1\n0,1\n", "is it a rosbag2 file?"),
}


@pytest.mark.parametrize("defect", FILES)
def test_what_is_no_log_is_refused(defect, arm, tmp_path):
    name, content, words = FILES[defect]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=re.escape(words)) as refusal:
        logs.read(tmp_path / name, arm)
    assert str(tmp_path / name) in str(refusal.value)


def test_bags_without_joint_states_are_refused(arm, good, tmp_path):
    with pytest.raises(ValueError, match="no topic of sensor_msgs/JointState in the bag"):
        logs.read(bag(tmp_path / "a.db3", good, kind="sensor_msgs/msg/Imu"), arm)
    damaged = bag(tmp_path / "b.db3", good)
    with sqlite3.connect(damaged) as base:
        base.execute("update messages set data = substr(data, 1, 40) where id = 7")
    base.close()
    with pytest.raises(ValueError, match="message 8 on /joint_states is damaged"):
        logs.read(damaged, arm)


NOTED = {  # what is odd: (the log, the line that a user reads, options)
    "equal stamps": (
        lambda t: t | {"t": np.where(K == 50, t["t"][49], t["t"])},
        "1 rows with the same time as the one before left out, the first is row 51",
    ),
    "a stamp that goes back": (
        lambda t: t | {"t": np.where(K == 50, t["t"][40], t["t"])},
        "1 rows with a time before that of an earlier one left out, the first is row 51",
    ),
    "a short gap": (lambda t: gap(t, 100, 103), "1 gaps of up to 40 ms bridged by straight lines"),
    "a long gap": (lambda t: gap(t, 100, 150), "cut into 2 segments at gaps of more than 50 ms, after t = 0.99 s"),
    "two recordings in one file": (
        lambda t: {k: np.r_[v, v] for k, v in t.items()},
        "the clock starts anew at row 601; taken as 2 recordings",
    ),
    "jitter": (lambda t: t | {"t": t["t"] + 0.002 * np.sin(7.0 * K)}, "resampled to 10 ms"),
    "hollow cells": (
        lambda t: t | {"q2": np.where(K == 9, np.nan, t["q2"])},
        "1 rows with a missing value left out, the first is row 10",
    ),
    "a block of hollow cells": (
        lambda t: t | {"tau2": np.where((K > 200) & (K < 300), np.nan, t["tau2"])},
        "cut into 2 segments at gaps of more than 50 ms, after t = 2 s",
    ),
    "a number for what was lost": (
        lambda t: t | {"q2": np.where(K == 9, -999.0, t["q2"])},
        "1 numbers are no angle and taken as missing, the first is -999 in row 10",
    ),
    "rows backwards": (lambda t: {k: v[::-1] for k, v in t.items()}, "the rows run backwards in time; turned round"),
    "coarse stamps": (
        lambda t: t | {"t": np.floor(t["t"] + 1e-9)},
        "stamps are 1 s coarse; rows are taken 10 ms apart, as they are on average",
    ),
    "a time that stands but a sample time": (
        lambda t: t | {"t": np.zeros(600)},
        "it is 0.0 throughout; rows are 10 ms apart, as given",
        {"dt": 0.01},
    ),
    "empty cells": (
        lambda t: t | {"q2": cells(t["q2"], r5="", r6="NA")},
        "2 rows with a missing value left out, the first is row 5",
    ),
    "an empty last cell": (
        lambda t: t | {"tau3": cells(t["tau3"], r5="", r6="")},
        "2 rows with a missing value left out, the first is row 5",
    ),
    "degrees": (lambda t: {k: np.rad2deg(v) if k[0] == "q" else v for k, v in t.items()}, "angles are in degrees (joint"),
    "a wrap": (
        lambda t: t | {"q3": (t["q3"] + 2.2 + np.pi) % (2 * np.pi) - np.pi},
        "steps of a whole turn undone:",
        {"check": False},
    ),
    "no torques": (lambda t: without(t, "tau1", "tau2", "tau3"), "the file has no torques: readings alone are judged"),
    "torques that a driver does not know": (
        lambda t: times(t, 0.0, "tau"),
        "torques are 0 or empty in every row of every joint: taken as not recorded, readings alone are judged",
    ),
    "currents by name": (
        lambda t: our({k: v / 9 if k[:3] == "tau" else v for k, v in t.items()}, tau="actual_current_{}"),
        "torques are currents in A, and the N m for one are not known",
    ),
    "currents without a word": (
        lambda t: {k: v / 9 if k[:3] == "tau" else v for k, v in t.items()},
        "the torque columns look like another unit",
    ),
    "shares of a rated torque by name": (
        lambda t: our(times(t, 2.0, "tau"), tau="torque_{} [%]"),
        "torques are in %, and the N m for one are not known: identify finds them, or give torque_per_ampere",
    ),
    "loads of servos": (
        lambda t: our(times(t, 9.0, "tau"), tau="present_load_{}"),
        "torques are loads as the servos count them, and the N m for one are not known",
    ),
    "currents with their constant": (
        lambda t: our({k: v / 9 if k[:3] == "tau" else v for k, v in t.items()}, tau="i_{} [A]"),
        "torques are the columns times 9. N m",
        {"torque_per_ampere": 9.0},
    ),
    "no time but a sample time": (
        lambda t: without(t, "t"),
        "no column of time: rows are 10 ms apart, as given",
        {"dt": 0.01},
    ),
    "milliseconds": (lambda t: t | {"t": 1000 * t["t"]}, "time is in ms"),
    "other names": (lambda t: our(t, q="actual_q_{}"), "angle taken from actual_q_1 to actual_q_3"),
    "a decimal comma": (lambda t: t, "numbers have a decimal comma"),
    "a dead angle": (lambda t: t | {"q3": np.full(600, 0.4)}, "reads 0.4 rad in every row: it stood still, or its column"),
}


@pytest.mark.parametrize("oddity", NOTED)
def test_what_is_repaired_is_said_in_one_line(oddity, arm, good, tmp_path):
    spoil, words, *options = NOTED[oddity]
    path = tmp_path / "log.csv"
    comma = oddity == "a decimal comma"
    small_logs.write(path, spoil(good), ";" if comma else ",", comma=comma)
    log = logs.read(path, arm, **(options[0] if options else {}))
    assert any(words in note for note in log.notes), log.notes
    assert all("\n" not in note for note in log.notes)
    assert np.isfinite(log.q).all() and np.abs(np.diff(log.q[slice(*log.stretches[0])], axis=0)).max() < 0.1


@pytest.mark.parametrize("seed", [2, 3, 4])
@pytest.mark.parametrize("degrees", [False, True])
def test_units_of_good_logs_are_not_doubted(arm, tmp_path, seed, degrees):
    """Heavier links than the file's, and a joint that stands."""
    table = small_logs.table(arm, seed=seed)
    table |= {f"tau{j}": factor * table[f"tau{j}"] for j, factor in ((1, 0.8), (2, 1.4), (3, 1.8))}
    log = logs.read(small_logs.write(tmp_path / "a.csv", times(table, 180 / np.pi if degrees else 1.0, "q")), arm)
    assert log.degrees == degrees and len(log.notes) == degrees
    t, q, qd, qdd = small_logs.motion(8.0, 100.0, seed)
    q[:, 1], qd[:, 1], qdd[:, 1] = 0.1, 0.0, 0.0
    tau = small_logs.torque(arm, q, qd, qdd)
    table = {"t": t} | {f"q{j + 1}": q[:, j] for j in range(3)} | {f"tau{j + 1}": tau[:, j] for j in range(3)}
    log = logs.read(small_logs.write(tmp_path / "b.csv", times(table, 180 / np.pi if degrees else 1.0, "q")), arm)
    assert log.degrees == degrees and np.abs(log.q[:, 1] - 0.1).max() < 1e-9


def test_a_good_log_says_nothing(arm, good, tmp_path):
    log = logs.read(small_logs.write(tmp_path / "log.csv", good), arm)
    assert log.notes == () and log.unit == "N m" and log.has_torque
    write_parquet(tmp_path / "log.parquet", good)
    same(logs.read(tmp_path / "log.parquet", arm), good)


def test_torques_that_show_nothing_are_not_doubted(arm, tmp_path):
    """One joint that goes one way at one speed, the others standing: friction alone, no gravity that changes."""
    rng, t = np.random.default_rng(0), np.arange(600) / 100
    table = {"t": t, "q1": 0.1 * t, "q2": 0 * t - 0.6, "q3": 0 * t + 0.9}
    table |= {f"tau{j}": level + 0.5 * rng.standard_normal(600) for j, level in ((1, 5.0), (2, -12.0), (3, -3.0))}
    notes = logs.read(small_logs.write(tmp_path / "log.csv", table), arm).notes
    assert len(notes) == 2 and all("stood still" in note for note in notes)


def test_an_angle_that_is_dead_under_load_is_refused(arm, tmp_path):
    """Friction does not hold what the torque changes by. A joint that stands may do with what it holds."""
    t, q, qd, qdd = small_logs.motion(12.0, 100.0, 1)
    weak = arm.replace(torque_limit=np.array([30.0, 30.0, 30.0]))
    for stands in (False, True):
        q[:, 1] = -0.6 if stands else -0.6 + 1.2 * np.sin(0.7 * t)
        qd[:, 1], qdd[:, 1] = np.gradient(q[:, 1], t), 0.0
        tau = small_logs.torque(arm, q, qd, qdd)
        table = {"t": t} | {f"q{j + 1}": q[:, j] for j in range(3)} | {f"tau{j + 1}": tau[:, j] for j in range(3)}
        path = small_logs.write(tmp_path / "log.csv", table | {"q2": np.full(len(t), q[0, 1])})
        if stands:
            assert any("stood still, or its column is dead" in note for note in logs.read(path, weak).notes)
            continue
        words = r"column of angle 2 \(shoulder_joint\) is -0.6 rad in every row while its torque changes by \d+\.\d N m"
        with pytest.raises(ValueError, match=words):
            logs.read(path, weak)
        assert any("it is dead, unless that is the fault" in note for note in logs.read(path, weak, faulty=True).notes)


def test_segments_do_not_touch(arm, good, tmp_path):
    log = logs.read(small_logs.write(tmp_path / "log.csv", gap(good, 100, 150)), arm)
    assert log.stretches == ((0, 100), (100, 550)) and abs(log.t[100] - 1.5) < 1e-9
    np.testing.assert_allclose(log.q[100], [good[f"q{j}"][150] for j in (1, 2, 3)], atol=1e-6)


def test_jitter_is_taken_out_with_the_stamps(arm, tmp_path):
    t, q, qd, qdd = small_logs.motion(6, 100, 1)
    stamps = t + 0.003 * np.sin(7.0 * np.arange(600))
    at = np.stack([np.interp(stamps, t, column) for column in q.T], 1)
    tau = small_logs.torque(arm, q, qd, qdd)
    tau = np.stack([np.interp(stamps, t, column) for column in tau.T], 1)
    table = {"t": stamps} | {f"q{j + 1}": at[:, j] for j in range(3)} | {f"tau{j + 1}": tau[:, j] for j in range(3)}
    log = logs.read(small_logs.write(tmp_path / "log.csv", table), arm)
    assert log.dt == 0.01
    ours = np.stack([np.interp(stamps[0] + log.t, t, column) for column in q.T], 1)
    np.testing.assert_allclose(log.q[1:-1], ours[1:-1], atol=3e-4)  # without the stamps it would be 3e-3


def test_uneven_stamps_are_uncertain_where_the_readings_bear_it_out(arm, tmp_path):
    t, q, _, _ = small_logs.motion(6, 100, 1)
    stamps = t + np.random.default_rng(0).uniform(0, 0.006, 600)
    found = {}
    for name, at in (("right", stamps), ("wrong", t)):
        read = np.stack([np.interp(at, t, column) for column in q.T], 1)
        path = small_logs.write(tmp_path / "log.csv", {"t": stamps} | {f"q{j + 1}": read[:, j] for j in range(3)})
        found[name] = logs.read(path, arm).jitter
    assert found["right"].max() < 0.002 and found["wrong"].min() > 0.005
    late = t + np.where((np.arange(600) == 100) | (np.arange(600) == 400), 0.004, 0.0)
    apart = uneven(late)
    np.testing.assert_allclose(apart[[50, 99, 100, 101, 250, 400]], [0, 0.008, 0.008, 0.008, 0, 0.008], atol=1e-9)
    assert (apart > 0).sum() <= 10 and not uneven(t).any()


def test_the_rate_is_the_logs_own_or_the_configs(arm, tmp_path):
    for rate, dt in ((125, 0.008), (500, 0.002), (30, 1 / 30), (90.9, 0.011), (4, 0.25)):  # 0.25 is not taken for ms
        path = small_logs.write(tmp_path / "log.csv", small_logs.table(arm, seconds=8 + 120 / rate, rate=rate))
        assert logs.read(path, arm).dt == pytest.approx(dt, rel=1e-3)
    path = small_logs.write(tmp_path / "log.csv", small_logs.table(arm, rate=125))
    assert logs.read(path, Config(arm, dt=0.01, t_final=1.0)).dt == 0.01
    with pytest.raises(ValueError, match=r"the log has a row every 8 ms \(125 Hz\) and 1 ms are wanted"):
        logs.read(path, Config(arm))


def test_the_arms_file_says_how_its_logs_are_read(arm, good, tmp_path):
    strange = {"when": good["t"]} | {f"a{j}{j}": good[f"q{j}"] for j in (1, 2, 3)}
    strange |= {f"b{j}{j}": (good[f"tau{j}"] - 0.5) / -4 for j in (1, 2, 3)}
    path = small_logs.write(tmp_path / "log.csv", strange)
    columns = (("t", ("when",)), ("q", ("a11", "a22", "a33")), ("tau", ("-b11", "-b22", "-b33")))
    recording = Recording(torque_gain=(4.0, 4.0, 4.0), torque_offset=(0.5, 0.5, 0.5), columns=columns)
    same(logs.read(path, Arm(arm, recording)), good)
    same(logs.read(path, Config(arm, dt=0.01, t_final=1.0), recording=recording), good)
    other = {"stamp" if name == "when" else name: column for name, column in strange.items()}
    path = small_logs.write(tmp_path / "other.csv", other)
    same(logs.read(path, Arm(arm, recording), columns={"t": "stamp"}), good)
    without_time = Recording(sample_time=0.01)
    same(logs.read(small_logs.write(tmp_path / "bare.csv", without(good, "t")), Arm(arm, without_time)), good)


def test_a_letter_behind_a_name_is_no_unit_but_of_what_has_it(arm, good, tmp_path):
    """Arms a and b of one file: ``tau1_a`` is no current; ``current1_a`` is one."""
    named = {"t": "stamp"} | {
        f"{word}{k}": f"{own}{k}_a" for word, own in (("q", "pos"), ("tau", "torque")) for k in (1, 2, 3)
    }
    path = small_logs.write(tmp_path / "log.csv", {named.get(key, key): value for key, value in good.items()})
    log = logs.read(path, arm, columns=named)
    same(log, good)
    assert log.unit == "N m"
    currents = {key.replace("tau", "current") + "_a" * key.startswith("tau"): value for key, value in good.items()}
    assert logs.read(small_logs.write(tmp_path / "log.csv", currents), arm).unit == "A"


def test_a_sign_that_is_given_is_turned(arm, good, tmp_path):
    path = small_logs.write(tmp_path / "log.csv", good | {"tau2": -good["tau2"]})
    named = {"tau1": "tau1", "tau2": "-tau2", "tau3": "tau3"}
    same(logs.read(path, arm, columns=named), good)
    assert logs.read(path, arm, check=False).tau[0, 1] == pytest.approx(-good["tau2"][0])


def test_a_fault_is_no_defect_of_the_log(arm, good, tmp_path):
    """Faults that are for the diagnosis to find do not refuse a log, and nothing of them is repaired."""
    on = K > 300
    faults = {
        "actuator": good | {"tau2": good["tau2"] - 10 * on},
        "bias": good | {"q2": good["q2"] + 0.03 * on},
        "jump": good | {"q2": good["q2"] + 1.0 * on},
        "drift": good | {"q3": good["q3"] + 0.17 * (good["t"] - 3) * on},
        "freeze": good | {"q2": np.where(on, good["q2"][300], good["q2"])},
    }
    for fault in faults.values():
        log = logs.read(small_logs.write(tmp_path / "log.csv", fault), arm)
        np.testing.assert_allclose(log.q[:, 1], fault["q2"], atol=1e-6)
        np.testing.assert_allclose(log.tau[:, 1], fault["tau2"], atol=1e-5)
