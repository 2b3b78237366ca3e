"""How the closed loop scales: with the batch, the horizon, the cores and the joints."""

from __future__ import annotations

from benchmarks import arms, workloads
from benchmarks.clock import race
from benchmarks.peers.mujoco_c import Rollout
from benchmarks.results import Results, Setup, Table
from benchmarks.worker import Worker
from jaxftc.config import Config
from jaxftc.robot.arm_file import load_robot

SHORT = 0.1  # s, long enough for a rate; large batches stay short
ROUNDS = 3


def scaling(setup: Setup, results: Results) -> None:
    """All tables."""
    for part in (_batch, _horizon, _cores, _joints):
        part(setup, results)


def _rate(setup: Setup, duration: float, batch: int, lanes: int | None = None) -> float:
    config = setup.config(duration=duration)
    call = workloads.loop(config, setup.gains(config), batch, lanes)
    return batch * config.ticks / race({"loop": call}, ROUNDS)["loop"].best


def _batch(setup: Setup, results: Results) -> None:
    rows = [(b, _rate(setup, SHORT, b, b), _rate(setup, SHORT, b)) for b in setup.sizes.batches]
    columns = ("scenarios", "one program as wide", "as campaigns run")
    results.tables["batch"] = Table("Closed loop by batch, scenario-steps/s", columns, rows)


def _horizon(setup: Setup, results: Results) -> None:
    batch = min(setup.sizes.loop, 512)
    rows = [(duration, _rate(setup, duration, batch)) for duration in setup.sizes.horizons]
    results.tables["horizon"] = Table(f"Closed loop by horizon, {batch} scenarios", ("s", "scenario-steps/s"), rows)


def _cores(setup: Setup, results: Results) -> None:
    sizes, config, rows = setup.sizes, setup.config(), []
    batch = min(sizes.loop, 1024)
    begin = workloads.starts(config, min(sizes.plant, 512))
    for cores in sorted({1, setup.cores}):
        rollout = Rollout(config.robot, config.dt, config.ticks, begin.q.shape[1], cores)
        rollout.load(*begin)
        with Worker(setup.task("loop", batch=batch, cores=cores), setup.folder / "forward") as loop:
            laps = race({"loop": loop, "rollout": rollout}, ROUNDS)
        rollout.close()
        counts = batch, begin.q.shape[1]
        rates = [count * config.ticks / lap.best for count, lap in zip(counts, laps.values(), strict=True)]
        rows.append((cores, *rates))
    columns = ("cores", "closed loop", "mujoco.rollout, plant only")
    results.tables["cores"] = Table("By cores, scenario-steps/s", columns, rows)


def _joints(setup: Setup, results: Results) -> None:
    rows = []
    for n in setup.sizes.joints:
        path = setup.folder / f"arm{n}.xml"
        path.write_text(arms.serial(n), encoding="utf-8")
        config = Config(load_robot(path), engine="chain", duration=SHORT)
        begin = workloads.starts(config, 256)
        rollout = Rollout(config.robot, config.dt, config.ticks, 256, setup.cores)
        rollout.load(*begin)
        task = setup.task("loop", robot=str(path), coulomb=False, gains=None, batch=1024, duration=SHORT)
        with Worker(task, setup.folder / f"joints{n}") as loop:
            laps = race({"loop": loop, "rollout": rollout}, ROUNDS)
        rollout.close()
        rates = [count * config.ticks / lap.best for count, lap in zip((1024, 256), laps.values(), strict=True)]
        rows.append((n, *rates, loop.first - laps["loop"].best))
    columns = ("joints", "closed loop", "mujoco.rollout, plant only", "compile s")
    results.tables["joints"] = Table("By joints, scenario-steps/s", columns, rows)
