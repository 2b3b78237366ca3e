"""``jaxftc calibrate``: thresholds for a wanted share of healthy runs with an alarm."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from jaxftc.cli import common, results
from jaxftc.cli import identify as logs_options
from jaxftc.cli.campaign import Laws

if TYPE_CHECKING:
    from jaxftc.campaigns.calibrate import Calibration
    from jaxftc.campaigns.log_thresholds import LogCalibration
    from jaxftc.config import Config
    from jaxftc.gains import Gains
    from jaxftc.logs.log import Log
    from jaxftc.robot.arm_table import Arm


@dataclasses.dataclass
class Calibrate(Laws):
    """Set the thresholds from healthy runs, for a share of runs with an alarm; writes gains.toml and result.json.

    The runs are simulated, on motions and arms of the preset, or cut from recorded logs of the healthy arm.
    """

    scheme: common.Scheme = "cascade"
    false_alarms: float = 0.01
    """Share of healthy runs that may raise an alarm."""
    confidence: float = 0.95
    """Probability with which the share is not larger."""
    lead: common.MaybeNumber = None
    """Gain diagnosis.lead of the cascade, 1/s^2, set first; 10000 detects actuator faults milliseconds sooner."""
    follow: bool = False
    """Torque thresholds that follow the motion: speed, acceleration, reversals, torques of links and payload."""
    runs: int = 8192
    """Healthy runs to simulate, half to set the thresholds on and half to check them on."""
    logs: Annotated[tuple[Path, ...], common.left_out("PATH ...")] = ()
    """Use logs of the healthy arm, for jaxftc diagnose, in place of simulations; --duration s of them are a run."""
    dt: common.MaybeNumber = None
    """Sample time of the controller, s; the logs' own, or 0.001 without logs, if not given."""
    columns: logs_options.Columns = ()
    """Columns of the logs, where they are not found: t=stamp q1=pos_a tau1=-torque_a; a minus changes the sign."""
    torque_per_ampere: logs_options.Numbers = ()
    """N m per ampere, where currents were recorded: one number, or one for each joint."""
    degrees: logs_options.Degrees = None
    """Whether angles of the logs are in degrees; recognised if not given."""
    check: bool = True
    """Check the columns of the logs against the model."""

    def run(self) -> None:
        """Set, check, write."""
        from jaxftc import checks

        checks.integer("--runs", self.runs, 2, "half of them set the thresholds, half check them", high=1_000_000)
        if self.logs:
            self._on_logs()
            return
        common.prepare(self, many=True)
        from tqdm import tqdm

        from jaxftc import save_gains
        from jaxftc.campaigns.calibrate import by_joint, enough
        from jaxftc.campaigns.patience import told
        from jaxftc.campaigns.spec import as_record, set_thresholds, variant
        from jaxftc.cli import record
        from jaxftc.schemes.registry import scheme

        common.look_here_for(self.scheme)
        base = self.base()
        if not scheme(variant(base, self.scheme)).DIAGNOSES:
            raise ValueError(
                f"scheme {self.scheme!r} has no diagnosis, so there is no threshold to set; give another --scheme"
            )
        job = self.job(base, self.scheme, anew=True)
        if self.lead is not None:
            job = job._replace(gains=with_lead(job.config, job.gains, self.lead))
        enough(self.runs, self.false_alarms, self.confidence)
        with results.folder(self, "calibrate") as folder:
            with tqdm(desc="healthy runs", unit="run", leave=False) as bar:
                wanted = {"runs": self.runs, "confidence": self.confidence, "follow": self.follow}
                counts = told(bar.update, lambda text: common.say(self, text), self.scheme, self.runs, follow=self.follow)
                found = set_thresholds(job, self.false_alarms, counts, **wanted)
            save_gains(folder / "gains.toml", found.gains, job.config)
            result = as_record(found) | by_joint(job.config, found.gains) | {"gains": str(folder / "gains.toml")}
            text = results.write_json(folder / "result.json", result | {"provenance": record.of(self, job.config)})
        common.say(self, table(job.config, job.gains, found))
        common.say(self, f"\nWritten to {folder}: gains.toml, result.json")
        if self.json:
            print(text)

    def _on_logs(self) -> None:
        """Thresholds for jaxftc diagnose."""
        if any(getattr(self, name) != getattr(Calibrate, name) for name in ("scheme", "lead")):
            raise ValueError("--scheme and --lead do nothing with --logs: the thresholds are those of jaxftc diagnose")
        common.prepare(self)
        from jaxftc import default_gains, load_gains, save_gains
        from jaxftc.campaigns import log_follow
        from jaxftc.campaigns.calibrate import by_joint
        from jaxftc.campaigns.follow import with_shares
        from jaxftc.campaigns.log_thresholds import calibrate_on_logs, reading_noise
        from jaxftc.cli import record
        from jaxftc.cli.identify import log_config, read_logs
        from jaxftc.gains_file import DIAGNOSER

        arm = common.whole_arm(self.robot, self.tip, self.lock)
        logs = read_logs(self, self.logs, arm)
        config = log_config(arm.robot, logs[0].sample_time)
        logs = one_rate(self, logs, arm, config)
        if self.gains is None:
            gains = default_gains(config, noise=reading_noise(config, default_gains(config), logs))
        else:
            gains = load_gains(self.gains, config)
        wanted = {"false_alarms": self.false_alarms, "confidence": self.confidence, "run": self.duration}
        found, followed = calibrate_on_logs(config, gains, logs, **wanted), {}
        if self.follow:
            shares = log_follow.fit(config, found.gains, logs)
            followed = {"follow_loss": shares.loss.tolist()}
            found = calibrate_on_logs(config, with_shares(gains, shares.values), logs, **wanted)
        with results.folder(self, "calibrate") as folder:
            save_gains(folder / "gains.toml", found.gains, config, scheme=DIAGNOSER)
            result = found.promise._asdict() | by_joint(config, found.gains) | {"gains": str(folder / "gains.toml")}
            result |= {"sample_time_s": config.dt, "noise_rad": [float(x) for x in found.noise]} | followed
            text = results.write_json(folder / "result.json", result | {"provenance": record.of(self, config)})
        common.say(self, log_table(config, gains, found))
        common.say(self, f"\nWritten to {folder}: gains.toml, result.json")
        if self.json:
            print(text)


def with_lead(config: Config, gains: Gains, lead: float) -> Gains:
    """Gains with another lead, 1/s^2, on every joint."""
    from jaxftc.gains import check

    gains = gains.replace({"diagnosis.lead": lead})
    check(config, gains)
    return gains


def one_rate(options: Calibrate, logs: list[Log], arm: Arm, config: Config) -> list[Log]:
    """The logs, those of another rate than the first read again at its sample time."""
    from jaxftc import logs as module
    from jaxftc.cli.identify import reading

    kept = []
    for path, log in zip(options.logs, logs, strict=True):
        if abs((log.dt or config.dt) - config.dt) > 1e-6 * config.dt:
            log = module.read(path, config, recording=arm.recording, check=options.check, **reading(options))
            common.say(options, f"{path.name}: brought to the {1e3 * config.dt:g} ms of the first log")
        kept.append(log)
    return kept


def log_table(config: Config, before: Gains, found: LogCalibration) -> str:
    """Thresholds, and what the healthy time can promise."""
    from jaxftc.campaigns.return_level import FARTHEST

    promise = found.promise
    wanted = f"{100 * promise.wanted:g} % of runs of {promise.run_s:.4g} s, which is {promise.wanted_per_hour:.3g} an hour"
    lines = [
        *levels(config, before, found.gains),
        "",
        f"{promise.healthy_s:.4g} s of healthy motion, with {promise.seen} alarms at these thresholds. That alone excludes "
        f"more than {promise.at_most_per_hour:.3g} alarms an hour, with {100 * promise.confidence:g} % confidence.",
        f"Wanted: at most an alarm in {wanted}.",
        "That is shown."
        if promise.at_most_per_hour <= promise.wanted_per_hour
        else f"NOT SHOWN: it takes {promise.needed_s / 60:.3g} minutes of healthy motion without an alarm.",
    ]
    if promise.method == "tail":
        lines.append(
            "The logs are too short to count such runs. The thresholds are EXTRAPOLATED from a fitted tail, to no more "
            f"than {FARTHEST:g} times the largest seen. At them the tail expects {promise.fitted_per_hour:.3g} alarms an "
            "hour; they are the same for every share that would need higher ones."
        )
    else:
        lines.append("The thresholds are set by counting runs.")
    return "\n".join(lines)


def table(config: Config, before: Gains, found: Calibration) -> str:
    """Thresholds before and after, and what they reach."""
    lines = levels(config, before, found.gains)
    low, high = found.reached[1:]
    lines.append(
        f"\nfalse alarms: {100 * found.reached.value:.2f} % of {found.fresh} fresh healthy runs, 95 % [{100 * low:.2f}, "
        f"{100 * high:.2f}]; wanted at most {100 * found.wanted:g} % with {100 * found.confidence:g} % confidence"
    )
    lines += (
        []
        if found.met
        else ["MORE THAN WANTED: the fresh runs differ from those the thresholds were set on; give more runs"]
    )
    lines += [] if found.settled else [f"the thresholds still moved after {found.rounds} rounds"]
    return "\n".join(lines)


def levels(config: Config, before: Gains, after: Gains) -> list[str]:
    """Thresholds before and after, a line a joint."""
    from jaxftc.campaigns.calibrate import by_joint
    from jaxftc.evaluation.comparison import RISES

    was, now = by_joint(config, before), by_joint(config, after)
    width = max(10, *(len(name) + 2 for name in config.robot.joint_names))
    lines = [f"{'joint':{width}}{'torque threshold, N m':>28}{'encoder threshold, deg':>30}"]
    for name in config.robot.joint_names:
        torque, angle = (f"{was[k][name]:.4g} -> {now[k][name]:.4g}" for k in ("alpha_tau_nm", "alpha_q_deg"))
        lines.append(f"{name:{width}}{torque:>28}{angle:>30}")
    if not RISES.keys() <= now.keys():
        return lines
    lines += [
        "\nshare by which the torque threshold of a joint at rest rises with",
        " " * width + "".join(map("{:>28}".format, RISES.values())),
    ]
    lines += [f"{name:{width}}" + "".join(f"{now[r][name]:28.4g}" for r in RISES) for name in config.robot.joint_names]
    return lines
