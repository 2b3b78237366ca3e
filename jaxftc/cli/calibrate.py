"""``jaxftc calibrate``: thresholds for a wanted share of healthy runs with an alarm."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from jaxftc.cli import common
from jaxftc.cli.campaign import Laws

if TYPE_CHECKING:
    from jaxftc.campaigns.calibrate import Calibration
    from jaxftc.config import Config
    from jaxftc.gains import Gains


@dataclasses.dataclass
class Calibrate(Laws):
    """Set the thresholds from healthy runs, for a share of runs with an alarm; writes gains.toml and result.json.

    The runs are simulated, on motions and arms of the preset, or cut from recorded logs of the healthy arm.
    """

    scheme: str = "cascade"
    """What diagnoses and controls, as in jaxftc campaign."""
    false_alarms: float = 0.01
    """Share of healthy runs that may raise an alarm."""
    confidence: float = 0.95
    """Confidence that the share is not larger."""
    lead: float | None = None
    """Weight of the innovation in the torque statistic of the cascade, 1/s^2, set before the thresholds; 10000 finds
    actuator faults some milliseconds sooner at the same false alarms. That of the gains if not given."""
    runs: int = 8192
    """Healthy runs to simulate, half to set the thresholds on and half to check them on."""
    logs: tuple[Path, ...] = ()
    """Logs to use instead, CSV or Parquet: t in s, q1, q2, ... in rad, tau1, tau2, ... in N m. Every --duration s (1 s) of
    them counts as a run."""

    def run(self) -> None:
        """Set, check, write."""
        from jaxftc import checks

        checks.integer("--runs", self.runs, 2, "half of them set the thresholds, half check them", high=1_000_000)
        common.prepare(self, many=True)
        from tqdm import tqdm

        from jaxftc import save_gains
        from jaxftc.campaigns.calibrate import by_joint, calibrate_on_logs, enough
        from jaxftc.campaigns.spec import as_record, set_thresholds, variant
        from jaxftc.cli import record
        from jaxftc.logs import read
        from jaxftc.schemes.registry import scheme

        common.look_here_for(self.scheme)
        base = self.base()
        if not scheme(variant(base, self.scheme)).DIAGNOSES:
            raise ValueError(
                f"scheme {self.scheme!r} has no diagnosis, so there is no threshold to set; give another --scheme"
            )
        job = self.job(base, self.scheme)
        if self.lead is not None:
            job = job._replace(gains=with_lead(job.config, job.gains, self.lead))
        share = {"false_alarms": self.false_alarms, "confidence": self.confidence}
        logs = [read(path, job.config) for path in self.logs]
        enough(sum(len(log.q) // job.config.ticks for log in logs) if logs else self.runs, **share)
        with common.folder(self, "calibrate") as folder:
            if logs:
                found = calibrate_on_logs(job.config, job.gains, logs, **share)
            else:
                with tqdm(desc="healthy runs", unit="run", leave=False) as bar:
                    found = set_thresholds(job, self.false_alarms, bar.update, runs=self.runs, confidence=self.confidence)
            save_gains(folder / "gains.toml", found.gains, job.config)
            result = as_record(found) | by_joint(job.config, found.gains) | {"gains": str(folder / "gains.toml")}
            text = common.write_json(folder / "result.json", result | {"provenance": record.of(self, job.config)})
        common.say(self, table(job.config, job.gains, found))
        common.say(self, f"\nWritten to {folder}: gains.toml, result.json")
        if self.json:
            print(text)


def with_lead(config: Config, gains: Gains, lead: float) -> Gains:
    """Gains with another lead, 1/s^2, on every joint."""
    from jaxftc.gains import check

    gains = gains.replace({"diagnosis.lead": lead})
    check(config, gains)
    return gains


def table(config: Config, before: Gains, found: Calibration) -> str:
    """Thresholds before and after, and what they reach."""
    from jaxftc.campaigns.calibrate import by_joint

    was, now = by_joint(config, before), by_joint(config, found.gains)
    lines = [f"{'joint':10}{'torque threshold, N m':>28}{'encoder threshold, deg':>30}"]
    for name in config.robot.joint_names:
        torque, angle = (f"{was[k][name]:.4g} -> {now[k][name]:.4g}" for k in ("alpha_tau_nm", "alpha_q_deg"))
        lines.append(f"{name:10}{torque:>28}{angle:>30}")
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
