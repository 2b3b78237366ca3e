"""``jaxftc identify``: the physical model of an arm from logs, or how well a model explains them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from jaxftc.cli import common, results
from jaxftc.io.text_table import aligned

if TYPE_CHECKING:
    from jaxftc.config import Config
    from jaxftc.identify.physical import Identified, Share
    from jaxftc.logs import Log
    from jaxftc.robot.arm_table import Arm


Columns = Annotated[tuple[str, ...], common.left_out("NAME=COLUMN ...")]
Numbers = Annotated[tuple[float, ...], common.left_out("NUMBER ...")]
Degrees = Annotated[bool | None, common.left_out("{True,False}")]


@dataclasses.dataclass
class LogOptions:
    """How logs are read."""

    columns: Columns = ()
    """Columns, where they are not found: t=stamp q1=pos_a tau1=-torque_a; a minus changes the sign."""
    dt: common.MaybeNumber = None
    """Sample time, s; the log's own if not given. Needed for a log without a time column."""
    torque_per_ampere: Numbers = ()
    """N m per ampere, where currents were recorded: one number, or one for each joint."""
    degrees: Degrees = None
    """Whether angles are in degrees; recognised if not given."""
    check: bool = True
    """Check the columns against the model."""


def column_names(pairs: tuple[str, ...]) -> dict[str, str] | None:
    """Our names and the file's, from ``--columns``."""
    given = {}
    for pair in pairs:
        key, mark, name = pair.partition("=")
        if not mark or not name:
            raise ValueError(f"--columns takes pairs such as q1=position_1, got {pair!r}")
        given[key] = name
    return given or None


def read_logs(options: Any, paths: tuple[Path, ...], arm: Arm) -> list[Log]:
    """Logs with the options of the command; what was found in each is said."""
    from jaxftc import logs

    found = []
    for path in paths:
        log = logs.read(path, arm, dt=options.dt, check=options.check, **reading(options))
        for note in log.notes:
            common.say(options, f"{path.name}: {note}")
        found.append(log)
    return found


def reading(options: Any) -> dict[str, Any]:
    """How the command's options say that the columns are read."""
    return {
        "columns": column_names(options.columns),
        "degrees": options.degrees,
        "torque_per_ampere": options.torque_per_ampere or None,
    }


@dataclasses.dataclass
class Identify(LogOptions, common.ArmOptions):
    """Fit the physical model of an arm to its logs: links, motor inertia, friction, torque offset, gain of currents.

    The logs must be of the healthy arm, with every joint in motion. Writes arm.toml, which --robot takes, and report.html.
    """

    logs: Annotated[tuple[Path, ...], tyro.conf.Positional, common.left_out("LOG ...")] = ()
    """Logs: text, Parquet, MCAP, or rosbag2 of sensor_msgs/JointState."""
    judge: bool = False
    """Fit nothing; say how well the model explains the logs."""

    def run(self) -> None:
        """Read, fit or judge, write."""
        if not self.logs:
            raise ValueError("give at least one log: jaxftc identify LOG... --robot FILE --out DIR")
        common.prepare(self)
        from jaxftc.cli import record

        arm = common.whole_arm(self.robot, self.tip, self.lock)
        found = read_logs(self, self.logs, arm)
        with results.folder(self, "identify") as folder:
            ran = record.of(self, log_config(arm.robot, found[0].sample_time))
            result = self._judge(arm, found) if self.judge else self._fit(arm, found, folder, ran)
            result = (
                {"sample_time_s": found[0].dt} | result | {"logs": [str(path) for path in self.logs], "robot": self.robot}
            )
            text = results.write_json(folder / "result.json", result | {"provenance": ran})
        written = ", ".join(sorted(p.name for p in folder.iterdir() if p.name[0] != "."))
        common.say(self, f"\nWritten to {folder}: {written}")
        if self.json:
            print(text)

    def _judge(self, arm: Arm, logs: list[Log]) -> dict[str, Any]:
        from jaxftc.identify import judge

        held = judge(arm.robot, logs, added=arm.recording.torque_offset or 0.0)
        common.say(self, share_lines(held, arm.robot.joint_names, judged=True))
        return {"held_out": as_json(held), "parameters": []}

    def _fit(self, arm: Arm, logs: list[Log], folder: Path, ran: dict[str, Any]) -> dict[str, Any]:
        from jaxftc.identify import dynamics
        from jaxftc.io.files import write_text
        from jaxftc.report.identify import identify_page
        from jaxftc.robot.arm_file import save_arm

        names = arm.robot.joint_names
        found = dynamics(arm.robot, logs, tell=lambda left: common.say(self, shown_lines(left, names)))
        for note in found.notes:
            common.say(self, note)
        common.say(self, share_lines(found.held_out, arm.robot.joint_names, judged=False))
        save_arm(folder, self._arm(arm, found, logs))
        page = identify_page(arm.robot, found, logs[0], f"Identified: {arm.robot.name}", ran)
        write_text(folder / "report.html", page)
        return {
            "held_out": as_json(found.held_out),
            "parameters": [p._asdict() for p in found.parameters],
            "torque_gain": found.gain.tolist(),
            "torque_offset_nm": found.offset.tolist(),
            "trust": found.trust,
            "notes": [*found.notes],
        }

    def _arm(self, arm: Arm, found: Identified, logs: list[Log]) -> Arm:
        """The arm with what was found, and how its logs are read."""
        import numpy as np

        from jaxftc.identify import encoder
        from jaxftc.robot.arm_table import Arm

        before = arm.recording
        gain = found.gain if before.torque_gain is None else found.gain * np.asarray(before.torque_gain)
        if self.torque_per_ampere:
            gain = np.broadcast_to(self.torque_per_ampere, arm.robot.n)
        offset = found.gain * np.asarray(before.torque_offset or 0.0) - found.offset
        resolution, noise = encoder(logs)
        given = dict(pair.split("=", 1) for pair in self.columns)
        n = arm.robot.n
        wide = {key: tuple(given[f"{key}{j + 1}"] for j in range(n)) for key in ("q", "tau") if f"{key}1" in given}
        names = tuple((dict(before.columns) | ({"t": (given["t"],)} if "t" in given else {}) | wide).items())
        recording = dataclasses.replace(
            before,
            sample_time=logs[0].dt,
            torque_gain=None if (gain == 1).all() else tuple(gain.tolist()),
            torque_offset=None if not offset.any() else tuple(offset.tolist()),
            encoder_resolution=tuple(resolution.tolist()),
            encoder_noise=tuple(noise.tolist()),
            columns=names,
        )
        return Arm(found.robot, recording)


def log_config(robot: Any, dt: float) -> Config:
    """The config of a log's sample time."""
    from jaxftc import Config

    return Config(robot, dt=dt, t_final=dt, engine="chain")


def as_json(held: Share) -> dict[str, Any]:
    """The fixed keys."""
    return {
        "torque_rms_nm": held.torque.tolist(),
        "before_rms_nm": held.before.tolist(),
        "after_rms_nm": held.after.tolist(),
        "share_before": held.share_before,
        "share_after": held.share_after,
    }


def shown_lines(left: list[tuple[str, int]], names: tuple[str, ...]) -> str:
    """What the motions cannot determine."""
    if not left:
        return "these motions show every parameter, at least in sums"
    by_joint: dict[int, list[str]] = {}
    for name, joint in left:
        by_joint.setdefault(joint, []).append(name)
    lines = [f"  {names[joint - 1]}: {', '.join(found)}" for joint, found in sorted(by_joint.items())]
    return "\n".join(["not shown by these motions, so the file's values stay:", *lines])


def share_lines(held: Share, names: tuple[str, ...], *, judged: bool) -> str:
    """Torque and what the model leaves of it, by joint."""
    heads = ("torque", "residual") if judged else ("torque", "residual, file", "residual, fitted")
    values = (held.torque, held.after) if judged else (held.torque, held.before, held.after)
    rows = [(name, *(f"{value[j]:.3g}" for value in values)) for j, name in enumerate(names)]
    lines = aligned(("joint", *heads), ("", *("rms N m",) * len(heads)), rows)
    was = "" if judged else f", {100 * held.share_before:.1f} % with the file's model"
    where = "of the torque" if judged else "of the torque, on held-out parts of the logs"
    return "\n".join([*lines, f"residual: {100 * held.share_after:.1f} % {where}{was}"])
