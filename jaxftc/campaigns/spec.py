"""One scheme through one campaign: what the folder's manifest says, the rows that are missing, a scenario again."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np
import tomli_w

from jaxftc.campaigns import store
from jaxftc.campaigns.calibrate import Calibration, calibrate
from jaxftc.campaigns.run import campaign, draw, replay
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.gains_file import load_gains, save_gains
from jaxftc.io.files import write_text
from jaxftc.scenarios.preset import Preset
from jaxftc.scenarios.preset_file import as_dict, load_preset
from jaxftc.schemes.registry import scheme
from jaxftc.simulation.closed_loop import Trace
from jaxftc.types import Array
from jaxftc.variants import changes
from jaxftc.version import __version__

CHUNK = 4096  # rows of a file
HEALTHY = 8192  # healthy runs that thresholds are set on and checked on, half each
CALIBRATION = 0x43414C49  # keeps the scenarios of a calibration apart from all others of a seed
UNSEEN = 0x43414D50  # keeps a campaign's scenarios apart from those of a tuning seed with the same number


class Job(NamedTuple):
    """Everything that a row depends on, its id apart."""

    config: Config
    gains: Gains  # with the thresholds that the campaign runs with
    preset: Preset  # distributions of the scenarios
    seed: int  # of the scenarios and of their noise
    scheme: str = "cascade"  # its name in the table of variants

    @property
    def keys(self) -> tuple[Array, Array]:
        """Random keys of the scenarios and of their noise."""
        draws, noise = jax.random.split(jax.random.fold_in(jax.random.key(self.seed), UNSEEN))
        return draws, noise


class Progress(NamedTuple):
    """What a call has done."""

    kept: int  # rows that were there
    run: int  # rows that were run
    rate: float | None  # scenario-steps/s, storage included, from the second call of the compiled program on


def variant(base: Config, name: str) -> Config:
    """The config of a scheme, or of another of the variants that have a name.

    Raises:
        ValueError: neither a variant nor a scheme of the user's has that name.
    """
    return dataclasses.replace(base, **changes(name))  # pyright: ignore[reportArgumentType]


# Runs chunks of a job, has their files count, and calls the last argument with the rows of each.
Runner = Callable[[Job, Iterable[store.Chunk], Callable[[int], object]], None]


def here(job: Job, chunks: Iterable[store.Chunk], tell: Callable[[int], object]) -> None:
    """Run chunks in this process, on all its cores, one after the other."""
    for chunk in chunks:
        store.keep(chunk, write(job, chunk, tell))


def write(job: Job, chunk: store.Chunk, tell: Callable[[int], object], at_a_time: int | None = None) -> str:
    """Run a chunk and write its file, whose SHA-256 it gives: the same bytes whenever, wherever and however often it runs.

    Raises:
        OSError: it cannot be written.
    """
    draws, noise = job.keys
    scenarios = draw(job.preset, job.config, draws, chunk.ids)
    rows = campaign(job.config, job.gains, scenarios, noise, tell, at_a_time=at_a_time)
    return store.write_chunk(chunk, _named(job, rows))


def complete(
    folder: Path,
    job: Job,
    n: int,
    done: Callable[[int], object],
    note: Callable[[str], object] = lambda text: None,
    run: Runner = here,
) -> Progress:
    """Run what is missing of the first n scenarios of a folder that ``begin`` has seen.

    Args:
        folder: The campaign's, with its manifest.
        job: As ``begin`` returned it.
        n: Number of scenarios, those that are there included.
        done: Called with the number of rows that are newly there, found or run.
        note: Called with a line of text for each file that has to be run again.
        run: Where chunks run: in this process, or on workers (``tasks.spread``).

    Returns:
        What was there, what was run, and how fast.

    Raises:
        OSError: a chunk cannot be written; those before it are there.
    """
    kept, marks = 0, []

    def tell(count: int) -> None:
        marks.append((time.perf_counter(), count))
        done(count)

    def missing() -> Iterator[store.Chunk]:
        """Chunks whose file is absent, damaged or shorter than it must be now."""
        nonlocal kept
        for chunk in store.chunks(folder, n, store.read_manifest(folder)["chunk"]):
            fault = store.fault_of(chunk)
            if fault is None:
                kept += chunk.rows
                done(chunk.rows)
                continue
            if fault == store.SHORTER:
                note(f"{chunk.path.name} is of a shorter campaign; it is run whole")
            elif fault != store.ABSENT:
                note(f"{chunk.path.name} is {fault}; its rows are run again")
            yield chunk

    run(job, missing(), tell)
    ran = sum(count for _, count in marks)
    rate = None
    if len(marks) > 1:
        rate = (ran - marks[0][1]) * job.config.ticks / (time.perf_counter() - marks[0][0])
    return Progress(kept, ran, rate)


def begin(
    folder: Path,
    job: Job,
    request: dict[str, Any],
    false_alarms: float | None,
    done: Callable[[int], object] = lambda count: None,
    *,
    follow: bool = False,
    note: Callable[[str], object] = lambda text: None,
) -> tuple[Job, dict[str, Any]]:
    """The folder's campaign: that of an earlier call if it was the same request, a new one otherwise.

    Args:
        folder: Where the campaign is, or will be.
        job: What was asked for; its gains are replaced by the folder's, or by calibrated ones.
        request: The options that rows depend on, for the manifest.
        false_alarms: Share of healthy runs with an alarm, 0 to 1, that a new campaign sets its thresholds for first.
        done: Called with the number of healthy runs that are newly through.
        follow: Whether torque thresholds follow the motion, as in ``calibrate``.
        note: Called with a line of text where versions differ from those that the campaign was begun with.

    Returns:
        The job with the gains that run, and the manifest.

    Raises:
        ValueError: the folder holds another campaign, or the thresholds cannot be set.
    """
    made_with = versions()
    if (folder / store.MANIFEST).exists():
        store.check_same_request(folder, request)
        store.check_inputs_unchanged(folder)
        manifest = store.read_manifest(folder)
        if manifest["made_with"] != made_with:
            begun, now = (" ".join(map(" ".join, v.items())) for v in (manifest["made_with"], made_with))
            note(f"{folder} was begun with {begun}, here {now}: new rows may differ in their last digits")
        return job._replace(gains=load_gains(folder / store.GAINS, job.config)), manifest
    store.refuse_orphan_chunks(folder)
    manifest = {"made_with": made_with, "chunk": CHUNK, "request": request, "config": describe(job.config)}
    if false_alarms is not None and scheme(job.config).DIAGNOSES:
        found = set_thresholds(job, false_alarms, done, follow=follow)
        job = job._replace(gains=found.gains)
        manifest["calibration"] = as_record(found)
    save_gains(folder / store.GAINS, job.gains, job.config)
    write_text(folder / store.PRESET, tomli_w.dumps(as_dict(job.preset)))
    store.write_manifest(folder, manifest)
    return job, manifest


def set_thresholds(
    job: Job,
    false_alarms: float,
    done: Callable[[int], object] = lambda count: None,
    *,
    runs: int = HEALTHY,
    confidence: float = 0.95,
    follow: bool = False,
) -> Calibration:
    """Thresholds for a share of healthy runs with an alarm, on motions and arms that the preset's campaign does not see.

    Args:
        job: Config, gains to start from, preset and seed.
        false_alarms: Share of healthy runs with an alarm, 0 to 1.
        done: Called with the number of runs that are newly through.
        runs: Healthy runs; one half sets the thresholds, the other checks them.
        confidence: Probability with which the share is not larger, 0 to 1.
        follow: Whether torque thresholds follow the motion.
    """
    draws, noise = jax.random.split(jax.random.fold_in(jax.random.key(job.seed), CALIBRATION))
    scenarios = draw(job.preset, job.config, draws, np.arange(runs, dtype=np.int32))
    wanted = {"false_alarms": false_alarms, "confidence": confidence, "follow": follow}
    return calibrate(job.config, job.gains, scenarios, noise, **wanted, done=done)


def as_record(found: Calibration) -> dict[str, Any]:
    """What calibration reached, for manifests and JSON."""
    low, high = found.reached[1:]
    followed = {} if found.shares is None else {"follow_loss": found.shares.loss.tolist()}
    return {
        "wanted": found.wanted,
        "confidence": found.confidence,
        "runs": found.runs,
        "rounds": found.rounds,
        "settled": found.settled,
        "met": found.met,
        "fresh_runs": found.fresh,
        "false_alarm_runs": found.reached.value,
        "false_alarm_runs_95": [low, high],
    } | followed


def again(job: Job, scenario_id: int) -> tuple[dict[str, np.ndarray], Trace]:
    """Row and trace [T, n] of one scenario, bit for bit as in the campaign."""
    draws, noise = job.keys
    scenario = jax.tree.map(lambda leaf: leaf[0], draw(job.preset, job.config, draws, np.array([scenario_id], np.int32)))
    row, trace = replay(job.config, job.gains, scenario, noise)
    return _named(job, row), trace


def _named(job: Job, rows: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Rows that say whose they are, so that those of several campaigns can be read together."""
    count = len(rows["scenario_id"])
    return {"scheme": np.full(count, job.scheme), "seed": np.full(count, job.seed, np.int64)} | rows


def versions() -> dict[str, str]:
    """Of what a result's last digits depend on."""
    return {"jaxftc": __version__, "jax": jax.__version__, "mujoco": mujoco.__version__}


def describe(config: Config) -> dict[str, Any]:
    """A config for the manifest: the robot by its fingerprint, nothing unset."""
    found = {name: value for name, value in config.record.items() if value is not None}
    return {"robot_fingerprint": config.robot.fingerprint} | found


def load(folder: Path, base: Config) -> Job:
    """The job of a folder for a base config with its robot, engine and timing.

    Raises:
        ValueError: no campaign, or the robot is another one than it ran with.
    """
    store.check_inputs_unchanged(folder)
    manifest = store.read_manifest(folder)
    name = store.scheme_of(manifest)
    config = variant(base, name)
    ours, theirs = describe(config), manifest["config"]
    other = [
        f"{name} {theirs.get(name)!r}, here {ours.get(name)!r}"
        for name in sorted({*ours, *theirs})
        if ours.get(name) != theirs.get(name)
    ]
    if other:
        raise ValueError(f"{folder} was run with another {'; another '.join(other)}")
    gains, preset = load_gains(folder / store.GAINS, config), load_preset(folder / store.PRESET)
    return Job(config, gains, preset, manifest["request"]["seed"], name)


def worst(job: Job, rows: Mapping[str, np.ndarray], count: int) -> list[tuple[dict[str, Any], Trace]]:
    """Rows and traces of the worst scenarios: diverged, missed, judged wrongly, alarmed falsely, then tracked badly."""
    missed = np.isinf(rows["delay_s"])
    order = np.lexsort((rows["tracking_rmse_deg"], rows["false_alarm"], ~rows["verdict_right"], missed, rows["diverged"]))
    found = []
    for scenario_id in rows["scenario_id"][order[::-1][:count]]:
        row, trace = again(job, int(scenario_id))
        found.append(({name: column[0].item() for name, column in row.items()}, trace))
    return found
