"""``jaxftc campaign``: thousands of fault scenarios, scored in the loop; rows on disk, a summary and a report."""

from __future__ import annotations

import contextlib
import dataclasses
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from jaxftc.cli import common, results
from jaxftc.io.files import write_text

if TYPE_CHECKING:
    from jaxftc.campaigns.cluster import Cluster
    from jaxftc.campaigns.spec import Job
    from jaxftc.config import Config


@dataclasses.dataclass
class Laws(common.Options):
    """Options of the commands that draw scenarios from a preset."""

    preset: str = "standard"
    """Distributions of the scenarios: standard, hard, doubles, uncommon, contact, paper, or your own TOML file."""
    engine: Literal["mjx", "chain"] = "chain"
    """Simulated arm: recursions unrolled from its model, or MuJoCo MJX (same motion, several times slower)."""
    coulomb: bool = True
    """Give the PUMA 560 its Coulomb friction, in plant and model."""
    seed: int = 0
    """Seed of the scenarios and their noise."""
    duration: common.MaybeNumber = None
    """Length of a run, s; the motion's, 1 s, if not given."""

    def base(self) -> Config:
        """Robot, engine and timing, before a scheme is chosen."""
        from jaxftc import Config

        dt = common.sample_time(self)
        times = {"dt": dt, "t_final": common.motion_time(dt), "duration": self.duration}
        return Config(common.load_arm(self), engine=self.engine, **times)

    def job(self, base: Config, scheme: str, *, anew: bool) -> Job:
        """Everything that a row of a scheme depends on; thresholds of its gains are to be set ``anew``, or stay."""
        from jaxftc.campaigns.spec import Job, variant
        from jaxftc.scenarios.distributions import extent
        from jaxftc.scenarios.preset_file import load_preset
        from jaxftc.scenarios.sample import check_arm

        common.key(self)  # the seed's range
        common.look_here_for(scheme)
        config = variant(base, scheme)
        preset = load_preset(self.preset)
        check_arm(preset, config, self.preset)
        duration, onset = config.ticks * config.dt, extent(preset.times.onset_s)[0]
        if onset >= duration and preset.shares.healthy < 1:
            raise ValueError(
                f"no fault of preset {self.preset!r} begins within {duration:g} s; the first onset is at {onset:g} s, "
                "so give a longer --duration"
            )
        return Job(config, common.load_or_default(self, config, anew=anew, preset=preset), preset, self.seed, scheme)


@dataclasses.dataclass
class Campaign(Laws):
    """Monte-Carlo fault campaign: rows in Parquet, summary.json and report.html.

    To resume, give the same command with the same --out; a larger -n adds scenarios.
    """

    n: Annotated[int, tyro.conf.arg(aliases=["-n"])] = 1000
    """Number of scenarios."""
    scheme: common.Scheme = "cascade"
    compare: Annotated[str | None, common.left_out("SCHEME,SCHEME,...")] = None
    """Several schemes on the same scenarios: cascade,momentum,ekf."""
    false_alarms: common.MaybeNumber = None
    """First calibrate the thresholds for this share of healthy runs with an alarm; 0.01 with --compare."""
    follow: bool = False
    """Torque thresholds that follow the motion, as in jaxftc calibrate; needs --false-alarms or --compare."""
    contact: int = 0
    """Judge contacts, where at most so many motors fail at once (1 or 2); 0 judges none. The cascade only."""
    decision: Literal["rule", "learned"] = "rule"
    """What names joints and channels in and between alarms: the paper's rule, or a network with memory. The cascade only."""
    worst: int = 3
    """Scenarios of each scheme whose traces the report shows."""
    cluster: Annotated[str | None, common.left_out("local|HOST:PORT")] = None
    """Run on a Ray cluster: one on this machine, or that of the head node; all machines share --out."""

    def run(self) -> None:
        """Run what is missing, then read all rows; write summary and report."""
        from jaxftc import checks

        checks.integer("-n", self.n, 1, "it is the number of scenarios")
        checks.integer("--worst", self.worst, 0, "it is the number of traces in the report")
        names = self._names()
        with self._workers() as workers:
            self._run(names, workers)

    def _run(self, names: list[str], workers: Cluster | None) -> None:
        """Run the schemes; workers are of the cluster, if one was asked for."""
        common.prepare(self, many=True, platform=None if self.cluster is None else "cpu")
        import json

        from jaxftc.campaigns import store
        from jaxftc.campaigns.calibrate import allowed
        from jaxftc.campaigns.spec import HEALTHY
        from jaxftc.cli import record
        from jaxftc.evaluation import comparison
        from jaxftc.report import campaign

        base = dataclasses.replace(self.base(), contact=self.contact, decision=self.decision)
        share = 0.01 if self.false_alarms is None and self.compare else self.false_alarms
        jobs = {name: self.job(base, name, anew=share is not None) for name in names}
        if self.follow and share is None:
            raise ValueError("--follow sets thresholds, and needs --false-alarms, the share of healthy runs with an alarm")
        if share is not None:
            allowed(HEALTHY // 2, share, 0.95)
        with results.folder(self, "campaign", goes_on=True) as folder:
            if self.out is None:
                common.say(self, f"To resume after a stop: the same command with --out {shlex.quote(str(folder))}")
            folders = {name: folder / name.replace(":", ".") if self.compare else folder for name in names}
            requests = {name: self._request(job, name, share) for name, job in jobs.items()}
            if self.force:
                for own in (folder, *(path.parent for path in folder.glob(f"*/{store.MANIFEST}"))):
                    store.clear(own)
            self._check(folder, folders, requests)
            found: dict[str, dict[str, Any]] = {}
            for name, job in jobs.items():
                folders[name].mkdir(exist_ok=True)
                found[name] = self._one(folders[name], job, requests[name], share, workers)
            common.say(self, comparison.as_text(found))
            if self.compare:
                rows = {name: store.Columns(folders[name], self.n) for name in names}
                pairs = comparison.against(rows)
                common.say(self, comparison.pairs_as_text(pairs))
                ran = record.of(self, self.base())
                text = results.write_json(folder / store.SUMMARY, {"schemes": found, "pairs": pairs, "provenance": ran})
                write_text(folder / store.REPORT, campaign.comparison(found, pairs, ran))
            else:
                common.say(self, comparison.kinds_as_text(found[names[0]]))
                text = json.dumps(found[names[0]], indent=2, allow_nan=False)
        rows_at = "a folder for each scheme" if self.compare else "rows (chunk-*.parquet)"
        common.say(self, f"\nWritten to {folder}: {rows_at}, summary.json, report.html")
        if self.json:
            print(text)

    def _workers(self) -> contextlib.AbstractContextManager[Cluster | None]:
        """The cluster that was asked for; Ray begins processes, which JAX does not want to see once it has begun itself."""
        if self.cluster is None:
            return contextlib.nullcontext()
        from jaxftc.campaigns.cluster import connect

        return connect(self.cluster)

    def _names(self) -> list[str]:
        """Schemes to run, the one that the others are held against first."""
        if self.compare is None:
            return [self.scheme]
        names = [name.strip() for name in self.compare.split(",")]
        if len(set(names)) < max(len(names), 2):
            raise ValueError(f"--compare takes two or more different schemes with commas, got {self.compare!r}")
        return names

    def _check(self, folder: Path, folders: dict[str, Path], requests: dict[str, dict[str, Any]]) -> None:
        """Refuse a folder that holds anything but the same campaign, before the first run."""
        from jaxftc.campaigns import store

        inside = [path.parent.name for path in folder.glob(f"*/{store.MANIFEST}")]
        if self.compare and (folder / store.MANIFEST).exists():
            raise ValueError(f"{folder} holds the campaign of one scheme; give another --out to --compare")
        if not self.compare and inside:
            raise ValueError(f"{folder} holds a comparison of {', '.join(sorted(inside))}; give another --out")
        if set(inside) - {own.name for own in folders.values()}:
            raise ValueError(f"{folder} holds a comparison of {', '.join(sorted(inside))}; name them all, or another --out")
        for name, own in folders.items():
            if (own / store.MANIFEST).exists():
                store.check_same_request(own, requests[name])
            else:
                store.refuse_orphan_chunks(own)

    def _one(
        self, folder: Path, job: Job, request: dict[str, Any], share: float | None, workers: Cluster | None
    ) -> dict[str, Any]:
        """One scheme: thresholds, missing rows, summary and report of its own."""
        from tqdm import tqdm

        from jaxftc.campaigns import store
        from jaxftc.campaigns.calibrate import by_joint
        from jaxftc.campaigns.patience import told
        from jaxftc.campaigns.spec import HEALTHY, begin, complete, here, worst
        from jaxftc.campaigns.tasks import spread
        from jaxftc.cli import record
        from jaxftc.evaluation import summary
        from jaxftc.report import campaign
        from jaxftc.schemes.registry import scheme

        name, note = job.scheme, lambda text: common.say(self, text)
        if share and not (folder / store.MANIFEST).exists():
            note(f"{name}: calibrating the thresholds for {100 * share:g} % of healthy runs with an alarm")
        with tqdm(desc=f"{name}: thresholds", unit="run", leave=False, disable=None if share else True) as bar:
            counts = told(bar.update, note, name, HEALTHY, follow=self.follow)
            job, manifest = begin(folder, job, request, share, counts, follow=self.follow, note=note)
        with tqdm(total=self.n, desc=name, unit="scenario", leave=False, smoothing=0.1) as bar:

            def done(count: int) -> None:
                if workers is not None:
                    bar.set_postfix_str(f"nodes {workers.nodes}, cores {workers.cores}", refresh=False)
                bar.update(count)

            run = here if workers is None else spread(workers, cached=self.cache)
            progress = complete(folder, job, self.n, done, note, run)
        rows = store.Columns(folder, self.n)
        result = summary.summarise(rows, name) | {"scenario_steps_per_s": progress.rate, "rows_kept": progress.kept}
        calibration = manifest.get("calibration")
        if calibration and not (calibration["met"] and calibration["settled"]):
            what = "still moved" if calibration["met"] else "let more false alarms through than wanted"
            note(f"{name}: the thresholds {what}")
        result |= {"calibration": calibration}
        if scheme(job.config).DIAGNOSES:
            result |= {"thresholds": by_joint(job.config, job.gains), "small_faults": summary.small(rows, job.gains)}
        ran = record.of(self, job.config)
        result |= {"provenance": ran | {"gains_that_ran": record.gains_file(folder / store.GAINS)}}
        results.write_json(folder / store.SUMMARY, result)
        shown = worst(job, rows, self.worst)
        write_text(folder / store.REPORT, campaign.campaign(job.config, folder, rows, result, shown))
        return result

    def _request(self, job: Job, name: str, share: float | None) -> dict[str, Any]:
        """The options that rows depend on, as the manifest keeps them."""
        import tomli_w

        from jaxftc.campaigns.store import fingerprint
        from jaxftc.scenarios.preset_file import as_dict

        robot = self.robot if self.robot == "puma560" else str(Path(self.robot).resolve())
        source = job.config.record.get("scheme_source")
        scheme = name if source is None else [name, source]
        request: dict[str, Any] = {"scheme": scheme, "robot": robot, "coulomb": self.coulomb, "engine": self.engine}
        request |= {"seed": self.seed, "preset": [self.preset, fingerprint(tomli_w.dumps(as_dict(job.preset)))]}
        request |= {} if self.tip is None else {"tip": self.tip}
        request |= {"lock": list(self.lock)} if self.lock else {}
        request |= {} if self.dt is None else {"dt": self.dt}
        request |= {} if self.duration is None else {"duration": self.duration}
        request |= {} if share is None else {"false_alarms": share}
        request |= {"follow": True} if self.follow else {}
        request |= {"contact": self.contact} if self.contact else {}
        request |= {} if self.decision == "rule" else {"decision": self.decision}
        if self.gains is not None:
            request["gains"] = [str(self.gains), fingerprint(self.gains.read_text(encoding="utf-8"))]
        return request
