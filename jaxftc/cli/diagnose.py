"""``jaxftc diagnose``: what failed in a recording, where, when and by how much."""

from __future__ import annotations

import csv
import dataclasses
import io
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from jaxftc.cli import common, results
from jaxftc.cli.identify import LogOptions, log_config, reading
from jaxftc.io.text_table import aligned

if TYPE_CHECKING:
    from jaxftc.config import Config
    from jaxftc.robot.arm_table import Arm

MEMORY = "256MB"  # of the table of samples, which is on disk
DEFAULT = (
    "no --gains: the thresholds are those of an exact model, which a real arm exceeds without a fault; set them with "
    "jaxftc calibrate --robot ... --logs HEALTHY..."
)
SIGNALS = ("verdict", "statistic_tau", "statistic_q", "fault_tau_hat", "fault_q_hat")  # of every sample


@dataclasses.dataclass
class Diagnose(LogOptions, common.ArmOptions):
    """Diagnose a recording under any controller; writes result.json, events.csv, samples.parquet and report.html.

    Calibrate the thresholds on healthy logs first: jaxftc calibrate --logs. Without torques, only encoder faults are found.
    """

    log: Annotated[Path | None, tyro.conf.Positional, common.left_out("LOG")] = None
    """Log: text, Parquet, MCAP, or rosbag2 of sensor_msgs/JointState."""
    contact: int = 0
    """Judge contacts, where at most so many motors fail at once (1 or 2); 0 judges none."""
    gains: common.MaybePath = None
    """Gains that jaxftc calibrate --logs wrote; default thresholds, which suit an exact model only, if not given."""

    def run(self) -> None:
        """Read piece by piece, judge, write."""
        if self.log is None:
            raise ValueError("give a log: jaxftc diagnose LOG --robot FILE --gains FILE --out DIR")
        common.prepare(self)
        arm = common.whole_arm(self.robot, self.tip, self.lock)
        with results.folder(self, "diagnose") as folder:
            text = self._diagnose(self.log, arm, folder)
        common.say(self, f"\nWritten to {folder}: events.csv, report.html, result.json, samples.parquet")
        if self.json:
            print(text)

    def _diagnose(self, path: Path, arm: Arm, folder: Path) -> str:
        """Everything that is written; the JSON of it."""
        import numpy as np
        from tqdm import tqdm

        from jaxftc.cli import record
        from jaxftc.io.files import write_text
        from jaxftc.logs import timeline
        from jaxftc.logs.diagnose import Stream
        from jaxftc.logs.pieces import pieces, rows
        from jaxftc.report.diagnosis import Envelope, diagnosis_page

        names = arm.robot.joint_names
        curves = {name: Envelope() for name in ("t", "tau", "q", "threshold_tau")}
        notes = [] if self.gains else [DEFAULT]
        found = stream = None
        duration = 0.0
        with (
            Samples(folder / "samples.parquet", names) as samples,
            tqdm(total=rows(path), desc="diagnose", unit="row", unit_scale=True, leave=False) as bar,
        ):
            for log, begins, goes_on in pieces(path, *self._wanted(arm), **self._reading(arm)):
                notes += [note for note in log.notes if note not in notes]
                if stream is None:
                    config = dataclasses.replace(log_config(arm.robot, log.sample_time), contact=self.contact)
                    stream = Stream(config, self._gains(arm, config))
                    found = timeline.Timeline(names, config.dt)
                assert found is not None
                t = log.t if log.t is not None else stream.config.dt * np_arange(len(log.q))
                for first, said in stream.feed(log, goes_on=goes_on):
                    found.add(said, begins + float(t[first]))
                    curves["tau"].add(np.asarray(said.statistic_tau))
                    curves["q"].add(np.asarray(said.statistic_q))
                    curves["threshold_tau"].add(np.asarray(said.threshold_tau))
                    times = begins + t[first : first + len(said.verdict)]
                    curves["t"].add(times[:, None])
                    samples.add(times, said)
                    bar.update(len(said.verdict))
                duration = begins + float(t[-1])
        assert found is not None and stream is not None
        result, ran = timeline.as_record(found, duration), record.of(self, stream.config)
        for note in notes:
            common.say(self, f"{path.name}: {note}")
        common.say(self, as_text(result))
        write_text(folder / "events.csv", events_csv(found.events))
        levels = {"tau": curves["threshold_tau"].curve, "q": as_row(stream.gains.diagnosis.alpha_q)}
        write_text(
            folder / "report.html",
            diagnosis_page(f"Diagnosis of {path.name}", result, curves, levels, names, tuple(notes), ran),
        )
        return results.write_json(folder / "result.json", result | {"provenance": ran})

    def _wanted(self, arm: Arm) -> tuple[Any, Any]:
        """What ``pieces`` reads the log for: the arm at the log's own sample time, or at that of the gains."""
        from jaxftc.gains_file import sample_time

        dt = None if self.dt is not None or self.gains is None else sample_time(self.gains)
        return arm if dt is None else log_config(arm.robot, dt), lambda own: log_config(arm.robot, own)

    def _reading(self, arm: Arm) -> dict[str, Any]:
        return {
            "recording": arm.recording,
            "dt": self.dt,
            "check": self.check,
            "faulty": True,
            **reading(self),
        }

    def _gains(self, arm: Arm, config: Config) -> Any:
        from jaxftc import default_gains
        from jaxftc.gains_file import DIAGNOSER, load_and_doubt

        if self.gains is not None:
            gains, doubt = load_and_doubt(self.gains, config, DIAGNOSER)
            if doubt:
                print(f"{doubt} --logs", file=sys.stderr)
            return gains
        recording = arm.recording
        return default_gains(config, noise=recording.encoder_noise, resolution=recording.encoder_resolution)


class Samples:
    """Every sample as a row of a Parquet file, written stretch by stretch."""

    def __init__(self, path: Path, joints: tuple[str, ...]) -> None:
        self.path, self.joints = path, joints

    def __enter__(self) -> Samples:
        import duckdb

        self._table = self.path.with_name(self.path.name + ".rows")
        self._table.unlink(missing_ok=True)
        self._rows = duckdb.connect(str(self._table), config={"memory_limit": MEMORY})  # else most of the machine's
        columns = ["t double"] + [
            f'"{s}_{j}" {"tinyint" if s == "verdict" else "float"}' for s in SIGNALS for j in self.joints
        ]
        self._rows.execute(f"create table samples ({', '.join(columns)})")
        return self

    def add(self, t: Any, said: Any) -> None:
        """More samples."""
        import numpy as np

        columns = {"t": np.ascontiguousarray(t)}
        for signal in SIGNALS:
            values = np.asarray(getattr(said, signal))
            columns |= {f"{signal}_{name}": np.ascontiguousarray(values[:, j]) for j, name in enumerate(self.joints)}
        self._rows.register("stretch", columns)
        self._rows.execute("insert into samples select * from stretch")
        self._rows.unregister("stretch")

    def __exit__(self, kind: Any, *_: object) -> None:
        from jaxftc.io.files import atomic_path

        if kind is None:
            with atomic_path(self.path) as temporary:
                self._rows.execute("copy samples to $path (format parquet)", {"path": str(temporary)})
        self._rows.close()
        self._table.unlink(missing_ok=True)


def np_arange(count: int) -> Any:
    """0, 1, ... as floats."""
    import numpy as np

    return np.arange(count, dtype=float)


def as_row(values: Any) -> Any:
    """A gain [n] as NumPy has it."""
    import numpy as np

    return np.asarray(values, float).reshape(-1)


def events_csv(events: list[Any]) -> str:
    """The timeline as CSV."""
    from jaxftc.logs.timeline import Event

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Event._fields)
    writer.writerows([f"{x:.9g}" if isinstance(x, float) else x for x in event] for event in events)
    return text.getvalue()


def as_text(record: dict[str, Any]) -> str:
    """The timeline as text."""
    rows = [
        (e["joint_name"], e["kind"], f"{e['start_s']:.2f}", f"{e['end_s']:.2f}", f"{e['size']:.3g} {e['unit']}")
        for e in record["events"]
    ]
    lines = (
        aligned(("joint", "kind", "start", "end", "size"), ("", "", "s", "s", ""), rows, text=2) if rows else ["no event"]
    )
    lines.append(
        f"{record['duration_s']:.4g} s at {1e3 * record['sample_time_s']:.4g} ms; alarm in "
        f"{100 * record['alarm_share']:.3g} % of the ticks, {record['glitches']} glitches"
    )
    return "\n".join(lines)
