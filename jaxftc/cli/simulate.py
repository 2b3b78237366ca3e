"""``jaxftc simulate``: one scenario, its table, its trace and its figures."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import tyro

from jaxftc.cli import common, results
from jaxftc.io.files import write_text
from jaxftc.io.text_table import aligned

if TYPE_CHECKING:
    import numpy as np

    from jaxftc.campaigns.spec import Job
    from jaxftc.config import Config
    from jaxftc.evaluation.metrics import Metrics


PLACES = {"fault_tau_rms_nm": 3, "fault_q_rms_deg": 4, "tracking_rms_deg": 4, "peak_torque_nm": 1}


class Run(NamedTuple):
    """A run for the table, the trace file and the page."""

    config: Config
    trace: dict[str, np.ndarray]  # columns
    title: str
    more: dict[str, Any]  # for result.json


@dataclasses.dataclass
class Simulate(common.Options):
    """Simulate one scenario: table by joint, trace.parquet and figures.html.

    The scenario is one of the paper's conditions, or one of a campaign (--from and --id), which is replayed bit for bit with
    the campaign's robot, gains and timing.
    """

    scenario: Literal["healthy", "actuator", "sensor", "both"] = "actuator"
    """Condition of the paper: faults on all joints from 0.1 to 0.25 s."""
    observer: Literal["pi", "eso", "ts"] = "ts"
    """PI, PI with super-twisting, or both with the Takagi-Sugeno stage."""
    control: Literal["smc", "esmc", "afesmc"] = "afesmc"
    """Sliding mode, with fault estimates, or with these and the fuzzy gain."""
    adaptive: bool = False
    """Learn payload and friction while the arm runs."""
    decision: Literal["rule", "learned"] = "rule"
    """What names joints and channels after an alarm: the paper's rule, or a network with memory."""
    sign: Literal["smooth", "hard"] = "smooth"
    """Sign function: tanh(x / eps), or the printed sgn."""
    torque: float = 5.0
    """Size of the actuator fault, N m."""
    angle: float = 1.5
    """Size of the encoder fault, deg."""
    campaign: Annotated[Path | None, tyro.conf.arg(name="from", metavar="PATH", help_behavior_hint="")] = None
    """Folder of a campaign to replay a scenario of; needs --id. Of --compare, the folder of one scheme."""
    id: common.MaybeInteger = None
    """scenario_id in that campaign."""
    t_final: float = 1.0
    """End of the motion, s."""
    duration: common.MaybeNumber = None
    """Length of the simulation, s; the motion's if not given."""

    def run(self) -> None:
        """Run it, print the table, write the trace, the figures and result.json."""
        from_campaign = self.campaign is not None
        if from_campaign != (self.id is not None):
            raise ValueError("--from and --id go together: a campaign's folder and one of its scenarios")
        engine = None
        if self.campaign is not None:
            from jaxftc.campaigns import store

            engine = store.read_manifest(self.campaign)["request"]["engine"]
        common.prepare(self, many=from_campaign, engine=engine)  # as the campaign did: the same program, to the last bit
        from jaxftc.cli import record
        from jaxftc.evaluation import metrics
        from jaxftc.io import trace_file
        from jaxftc.report.figures import trace_page

        run = self._again() if from_campaign else self._paper()
        with results.folder(self, "simulate") as folder:
            config, trace, title, more = run()
            diverged = from_campaign and more["row"]["diverged"]
            result = more if diverged else summary(config, trace, metrics.evaluate(config, trace)) | more
            if from_campaign and not diverged:  # as the campaign has it, which knows the scenario and not only its signals
                result |= {name: more["row"][name] for name in ("delay_s", "false_alarm_s")}
                result |= {"isolated": more["row"]["verdict_right"]}
            ran = record.of(self, config)
            if self.campaign is not None:
                ran |= record.of_campaign(self.campaign)
            trace_file.write(folder / "trace.parquet", trace, config.robot.joint_names)
            text = results.write_json(folder / "result.json", result | {"provenance": ran})
            write_text(folder / "figures.html", trace_page(config, trace, title, ran))
        common.say(self, f"{title}: the arm diverged" if diverged else table(title, result))
        if from_campaign:
            common.say(self, row_as_text(result))
        common.say(
            self, f"\nWritten: {', '.join(str(folder / name) for name in ('trace.parquet', 'figures.html', 'result.json'))}"
        )
        if self.json:
            print(text)

    def _paper(self) -> Callable[[], Run]:
        """One of the paper's conditions, checked and ready to run."""
        from jaxftc import Config, paper_scenario, simulate
        from jaxftc.evaluation import metrics

        for name in ("torque", "angle"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"--{name} must be a finite number, got {getattr(self, name)}")
        config = Config(
            common.load_arm(self),
            dt=common.sample_time(self),
            engine=self.engine,
            observer=self.observer,
            control=self.control,
            adaptive=self.adaptive,
            decision=self.decision,
            sign=self.sign,
            t_final=self.t_final,
            duration=self.duration,
        )
        gains = common.load_or_default(self, config)
        scenario = paper_scenario(self.scenario, config, torque=self.torque, angle=math.radians(self.angle))
        title = f"{self.scenario}: {self.observer.upper()} observer, {self.control.upper()} control"
        key = common.key(self)
        return lambda: Run(config, metrics.columns(simulate(config, gains, scenario, key)), title, {})

    def _again(self) -> Callable[[], Run]:
        """A scenario of a campaign, checked and ready to run."""
        from jaxftc import Config
        from jaxftc.campaigns import store
        from jaxftc.campaigns.spec import load

        assert self.campaign is not None and self.id is not None
        free = ("campaign", "id", "out", "json", "cache", "force", "words")
        idle = [f.name for f in dataclasses.fields(self) if f.name not in free and getattr(self, f.name) != f.default]
        if idle:
            raise ValueError(
                f"--{idle[0].replace('_', '-')} does nothing with --from, which takes the campaign's; leave it out"
            )
        if not 0 <= self.id < 2**31:
            raise ValueError(f"--id must lie in 0 to 2^31 - 1, got {self.id}")
        manifest = store.read_manifest(self.campaign)
        asked, name = manifest["request"], store.scheme_of(manifest)
        arm = {"robot": asked["robot"], "tip": asked.get("tip"), "lock": tuple(asked.get("lock", ()))}
        options = dataclasses.replace(self, **arm, coulomb=asked["coulomb"] and asked["robot"] == "puma560")
        common.look_here_for(name)
        base = Config(
            common.load_arm(options),
            dt=asked.get("dt", 1e-3),
            t_final=common.motion_time(asked.get("dt", 1e-3)),
            engine=asked["engine"],
            duration=asked.get("duration"),
            contact=asked.get("contact", 0),
            decision=asked.get("decision", "rule"),
        )
        job = load(self.campaign, base)
        stored = store.read_rows(self.campaign, self.id + 1, first=self.id)
        title = f"scenario {self.id} of {self.campaign}, scheme {name}"
        return functools.partial(replayed, job, self.id, stored, title)


def replayed(job: Job, scenario_id: int, stored: dict[str, np.ndarray], title: str) -> Run:
    """A scenario of a campaign, by the campaign's own program; its row, and whether the stored one is the same."""
    import numpy as np

    from jaxftc.campaigns.spec import again
    from jaxftc.evaluation import metrics

    row, trace = again(job, scenario_id)
    same = None
    if len(stored.get("scenario_id", ())):
        same = all(np.array_equal(stored[k], v, equal_nan=v.dtype.kind == "f") for k, v in row.items())
    values = {name: column[0].item() for name, column in row.items()}
    clean = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}
    return Run(job.config, metrics.columns(trace), title, {"row": clean, "same_as_stored": same})


def summary(config: Config, trace: dict[str, np.ndarray], merits: Metrics) -> dict[str, Any]:
    """The run as a dict: figures of merit, and the same by joint."""
    import numpy as np

    from jaxftc.evaluation import metrics
    from jaxftc.types import Verdict

    wanted, present = metrics.truth(trace)
    found = metrics.detection(config, trace["verdict"], wanted, present)
    unsure = np.zeros(config.n) if found.scored is None else trace["unsure"][found.scored]
    saturated = (np.abs(trace["tau"]) >= config.robot.torque_limit * (1 - 1e-6)).mean(0)
    fault_tau = trace["fault_tau"] + trace["contact_tau"]
    joints = [
        {
            "joint": name,
            "fault_tau_rms_nm": metrics.rms(trace["fault_tau_hat"][:, j] - fault_tau[:, j]),
            "fault_q_rms_deg": math.degrees(metrics.rms(trace["fault_q_hat"][:, j] - trace["fault_q"][:, j])),
            "verdict": Verdict(found.verdict[j]).label,
            "unsure": bool(unsure[j]),
            "truth": Verdict(wanted[j]).label,
            "tracking_rms_deg": math.degrees(metrics.rms(trace["q"][:, j] - trace["q_ref"][:, j])),
            "peak_torque_nm": float(np.abs(trace["tau"][:, j]).max()),
            "saturated_share": float(saturated[j]),
        }
        for j, name in enumerate(config.robot.joint_names)
    ]
    figures = merits._asdict()
    if figures["delay_s"] is not None and not math.isfinite(figures["delay_s"]):
        figures["delay_s"] = None
    return figures | {"joints": joints}


def table(title: str, result: dict[str, Any]) -> str:
    """The run as text."""
    from jaxftc.evaluation.metrics import SETTLE

    head = ("joint", "truth", "verdict", "torque est.", "angle est.", "tracking", "peak torque")
    units = ("", "", "", "rms N m", "rms deg", "rms deg", "N m")
    rows = [
        (*(joint[name] for name in head[:3]), *(f"{joint[name]:.{places}f}" for name, places in PLACES.items()))
        for joint in result["joints"]
    ]
    lines = [title, "", *aligned(head, units, rows, text=3)]
    if all(joint["truth"] == "normal" for joint in result["joints"]):
        lines.append("\nno fault in this run")
    else:
        delay = "none" if result["delay_s"] is None else f"{result['delay_s'] * 1e3:.0f} ms after onset"
        lines.append(
            f"\nfirst alarm: {delay}; every joint's verdict right {1e3 * SETTLE:.0f} ms later: "
            f"{'yes' if result['isolated'] else 'no'}"
        )
    guesses = ", ".join(joint["joint"] for joint in result["joints"] if joint["unsure"])
    if guesses:
        lines.append(f"kind unknown: what is said of {guesses} is a guess")
    if result["false_alarm_s"] is not None:
        lines.append(f"FALSE ALARM at {result['false_alarm_s']:.3f} s: an alarm was up where no fault was")
    limited = [f"{j['joint']} ({100 * j['saturated_share']:.0f} %)" for j in result["joints"] if j["saturated_share"] > 0]
    if limited:
        lines.append(f"torque limit reached by {', '.join(limited)} of the time: estimates of these joints mean little then")
    return "\n".join(lines)


def row_as_text(result: dict[str, Any]) -> str:
    """The campaign's row of a scenario, without the delays at other thresholds."""
    row = {name: value for name, value in result["row"].items() if not name.startswith("delay_at_")}
    words = {None: "none, the campaign has not run this scenario", True: "the same to the last bit", False: "DIFFERENT"}
    lines = ["", "row:", *(f"  {name:22} {_shown(value)}" for name, value in row.items() if value != "")]
    return "\n".join([*lines, f"stored row: {words[result['same_as_stored']]}"])


def _shown(value: Any) -> str:
    """A value of a row for people: six digits, which result.json has all."""
    return "-" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
