"""The speed suite: what users would otherwise pick, in turns with ours, results checked while they are timed."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from pathlib import Path

import jax
import numpy as np

from benchmarks import campaigns, scaling, workloads
from benchmarks.clock import race
from benchmarks.metrics import METRICS, Section, expected
from benchmarks.peers import dynamics as others
from benchmarks.peers import mujoco_c, numpy_loop
from benchmarks.results import Results, Setup, Table, apart
from benchmarks.slope import slope_error
from benchmarks.worker import Failed, Task, Worker, compiling
from jaxftc.campaigns import run as campaign_run
from jaxftc.config import Config
from jaxftc.evaluation.online import Score
from jaxftc.gains import Gains
from jaxftc.scenarios.scenario import paper_scenario, take
from jaxftc.simulation import closed_loop
from tuning.settings import ROUND

KERNELS_TICKS = 20  # of programs whose text is counted
FRESH = 3  # processes that are started from a filled cache; the least time counts
COMPARED = 8  # scenarios of the closed loop that are run again by ``simulate``


def run(setup: Setup, sections: Iterable[Section]) -> Results:
    """Measure some sections, in the order given.

    Raises:
        Failed: a timed result is wrong, a process failed, or a figure is missing.
    """
    results, ran = Results(), []
    for section in sections:
        SECTIONS[section](setup, results)
        ran.append(section)
    missing = set(expected(ran, quick=not setup.sizes.everything)) - results.metrics.keys() - results.absent
    if missing:
        raise Failed(f"not measured: {', '.join(sorted(missing))}")
    return results


def forward(setup: Setup, results: Results) -> None:
    """Plant alone and the whole loop against MuJoCo C and against the loop in NumPy."""
    sizes, config = setup.sizes, setup.config()
    gains, begin, few = setup.gains(config), workloads.starts(config, sizes.plant), slice(0, sizes.step)
    rollout = mujoco_c.Rollout(config.robot, config.dt, config.ticks, sizes.plant, setup.cores)
    rollout.load(*begin)
    step = mujoco_c.Step(config.robot, config.dt, config.ticks)
    scenario, key = paper_scenario("both", config), jax.random.key(workloads.NOISE)
    noise = np.asarray(closed_loop.encoder_noise(config, scenario, key))
    sides = {
        "plant": workloads.plant(config, begin, sizes.width, setup.cores),
        "loop": workloads.loop(config, gains, sizes.loop),
        "rollout": rollout,
        "mj_step": lambda: step(*(x[:, few] for x in begin)),
        "numpy": lambda: numpy_loop.simulate(config, gains, scenario, noise),
    }
    laps = race(sides, sizes.rounds)
    rollout.close()
    counts = {"plant": sizes.plant, "loop": sizes.loop, "rollout": sizes.plant, "mj_step": sizes.step, "numpy": 1}
    rates = {name: count * config.ticks / laps[name].best for name, count in counts.items()}
    results.metrics |= {f"{name}_steps_per_s": rate for name, rate in rates.items()}
    results.metrics["plant_chain_over_c"] = rates["plant"] / rates["rollout"]
    results.metrics["loop_chain_over_c"] = rates["loop"] / rates["rollout"]
    results.metrics["loop_over_numpy"] = rates["loop"] / rates["numpy"]

    q, qd = (np.moveaxis(x, 0, -1) for x in laps["rollout"].result)  # [T, n, B]
    ours = [np.concatenate([np.asarray(part[k]) for part in laps["plant"].result], axis=-1) for k in (0, 1)]
    results.check("plant, angles of every step against mujoco.rollout, rad", apart(ours[0], q), 1e-3)
    results.check("plant, speeds of every step against mujoco.rollout, rad/s", apart(ours[1], qd), 1e-2)
    results.check("mj_step, last angles against mujoco.rollout, rad", apart(laps["mj_step"].result[0], q[-1][:, few]), 1e-9)
    trace = closed_loop.simulate(config, gains, scenario, key)
    results.check("NumPy loop, true angles against simulate, rad", apart(laps["numpy"].result.q, trace.q), 1e-4)
    wrong = np.mean(laps["numpy"].result.verdict != np.asarray(trace.out.verdict))
    results.check("NumPy loop, share of verdicts that differ from simulate's", float(wrong), 0.01)
    _check_loop(results, config, gains, laps["loop"].result)

    with Worker(setup.task("loop"), setup.folder / "forward") as cold:
        results.metrics["compile_forward_s"] = compiling(cold)
    if sizes.everything:
        results.metrics["compile_forward_warm_s"] = _warm(setup.task("loop"), setup.folder / "forward")


def _warm(task: Task, cache: Path) -> float:
    """Seconds that compiling takes from a filled cache: the least of some fresh processes."""
    seconds = []
    for _ in range(FRESH):
        with Worker(task, cache) as worker:
            seconds.append(compiling(worker))
    return min(seconds)


def _check_loop(results: Results, config: Config, gains: Gains, scores: Score) -> None:
    """Scores that were timed, against the same scenarios through ``simulate``."""
    count = min(COMPARED, len(scores.ise))
    scenarios = take(workloads.drawn(config, count), slice(None))
    trace = closed_loop.simulate(config, gains, scenarios, jax.random.key(workloads.NOISE))
    again = np.sum(np.square(np.asarray(trace.q, float) - np.asarray(trace.q_ref, float)), axis=(1, 2))
    finite = float(np.isfinite(scores.ise).all() and not scores.lost.any())
    results.check(f"closed loop, engine {config.engine}, runs that were lost", 1 - finite, 0.0)
    error = apart(scores.ise[:count] / again, np.ones(count))
    results.check(f"closed loop, engine {config.engine}, squared tracking error against simulate, relative", error, 0.02)


def mjx(setup: Setup, results: Results) -> None:
    """The whole loop on MJX against ``mjx.step`` as it comes, each at its own best batch."""
    sizes, config = setup.sizes, setup.config("mjx")
    gains, rates, rows = setup.gains(config), {}, []
    loop = workloads.loop(config, gains, sizes.loop_mjx)
    for batch, ticks in sizes.mjx_default:
        task = setup.task("mjx", engine="mjx", batch=batch, duration=ticks * config.dt)
        with Worker(task, setup.folder / f"mjx-{batch}") as default:
            laps = race({"loop": loop, "default": default}, sizes.rounds)
            rate = batch * ticks / laps["default"].best
            ours = sizes.loop_mjx * config.ticks / laps["loop"].best
            compile_s = default.first - laps["default"].best
        rows.append((batch, ticks, rate, compile_s))
        rates[batch] = (rate, ours, compile_s)
        last = mujoco_c.Step(config.robot, config.dt, ticks)(*workloads.starts(config, batch))
        error = apart(laps["default"].result["value"][0], last[0])
        results.check(f"mjx.step, {batch} arms, last angles against mj_step, rad", error, 1e-3)
        _check_loop(results, config, gains, laps["loop"].result)
    rate, ours, compile_s = max(rates.values())
    results.metrics |= {"mjx_default_steps_per_s": rate, "loop_mjx_steps_per_s": ours, "compile_mjx_default_s": compile_s}
    results.metrics["loop_mjx_over_mjx_default"] = ours / rate
    columns = ("arms", "steps", "scenario-steps/s", "compile s")
    results.tables["mjx_default"] = Table("mjx.step in jit(vmap(scan)), XLA's own options", columns, rows)


def gradient(setup: Setup, results: Results) -> None:
    """The gradient of tuning's loss for all gains against the forward run; its memory at the size that counts."""
    sizes, config = setup.sizes, setup.config()
    gains, cache = setup.gains(config), setup.folder / "gradient"
    task = setup.task("gradient", batch=sizes.gradient)
    with Worker(task, cache) as cold:
        results.metrics["compile_grad_s"] = compiling(cold)
        _race_gradient(setup, results, config, gains, cold)
        answer, size = cold(), cold.memory()
    if sizes.everything:
        results.metrics["compile_grad_warm_s"] = _warm(task, cache)
    rows = [(sizes.gradient, results.metrics["grad_steps_per_s"])]
    if sizes.memory != sizes.gradient:
        with Worker(setup.task("gradient", batch=sizes.memory), cache) as large:
            answer, size = large(), large.memory()
        results.check("gradient of the largest batch, runs lost or no slope", float(not answer["value"]["sound"]), 0.0)
        rows.append((sizes.memory, ROUND * sizes.memory * config.ticks / answer["seconds"]))
    results.metrics |= {"grad_memory_gib": size / 2**30, "grad_peak_gib": answer["peak_bytes"] / 2**30}
    results.tables["gradient"] = Table("Gradient for all gains", ("scenarios", "scenario-steps/s"), rows)
    if sizes.everything:
        results.check("gradient against finite differences, float64, two hinges, relative", slope_error(), 1e-3)


def _race_gradient(setup: Setup, results: Results, config: Config, gains: Gains, worker: Worker) -> None:
    sizes = setup.sizes
    laps = race({"gradient": worker, "loop": workloads.loop(config, gains, sizes.loop)}, sizes.rounds)
    counts = {"gradient": ROUND * sizes.gradient, "loop": sizes.loop}
    rates = [count * config.ticks / laps[name].best for name, count in counts.items()]
    results.metrics |= {"grad_steps_per_s": rates[0], "grad_over_forward": rates[1] / rates[0]}
    now, before = laps["gradient"].result["value"], worker.value
    results.check("gradient, runs lost or no slope", float(not now["sound"]), 0.0)
    for name in ("terms", "theta"):
        results.check(f"gradient, difference of {name} between two calls", apart(now[name], before[name]), 0.0)


def tick(setup: Setup, results: Results) -> None:
    """One tick of the controller, called from Python and from C."""
    with Worker(setup.task("tick", batch=setup.sizes.ticks), setup.folder / "tick") as worker:
        found = worker.value
    for name, figures in found.items():
        results.check(f"{name}, torque against simulate's, over its limit", figures.pop("error"), 0.01)
        results.metrics |= figures
    if "tick_c" not in found:
        results.absent |= {metric.key for metric in METRICS if metric.key.startswith(("tick_c", "tick_backend_c"))}


def dynamics(setup: Setup, results: Results) -> None:
    """Forward dynamics against libraries that have nothing else to do."""
    sizes, config = setup.sizes, setup.config()
    begin = workloads.starts(config, sizes.dynamics)
    sides: dict[str, Callable[[], np.ndarray]] = {}
    notes = {"jaxftc, chain": (sizes.dynamics, "all cores"), "jaxftc, mjx": (sizes.dynamics, "all cores")}
    for engine in ("chain", "mjx"):
        sides[f"jaxftc, {engine}"] = workloads.dynamics(
            setup.config(engine), begin, sizes.dynamics // setup.cores, setup.cores
        )
    absent = []
    for peer in others.peers(config.robot):
        if not others.installed(peer):
            absent.append((peer.name, "not installed", peer.how))
            continue
        count = min(peer.batch, sizes.dynamics)
        arguments = [np.ascontiguousarray(x[:, :count].T) for x in begin]
        sides[peer.name] = functools.partial(peer.make(config.robot, setup.cores), *arguments)
        notes[peer.name] = (count, peer.how)
    laps = race(sides, sizes.rounds)
    truth = laps["MuJoCo C"].result
    rows = []
    for name, (count, how) in notes.items():
        rows.append((name, count / laps[name].best, how))
        found, wanted = laps[name].result[: len(truth)], truth[: len(laps[name].result)]
        results.check(f"dynamics, {name} against MuJoCo C, relative", apart(found, wanted) / np.abs(wanted).max(), 1e-3)
    results.tables["dynamics"] = Table("Forward dynamics", ("library", "arms/s", "how"), rows + absent)


def kernels(setup: Setup, results: Results) -> None:
    """What the compiled programs do in a tick, as far as XLA's text tells."""
    rows, duration = [], KERNELS_TICKS * setup.config().dt
    for what, batch in (("loop", campaign_run.width()), ("gradient", setup.sizes.kernels)):
        with Worker(setup.task(what, batch=batch, duration=duration), setup.folder / "kernels") as worker:
            rows += [(what, *turn) for turn in worker.kernels()]
    columns = ("program", "where", "kernels a turn", "operations", "numbers read", "numbers written")
    results.tables["kernels"] = Table("What a turn of each loop does, per scenario", columns, rows)


SECTIONS: dict[Section, Callable[[Setup, Results], None]] = {
    "forward": forward,
    "mjx": mjx,
    "gradient": gradient,
    "tick": tick,
    "campaign": campaigns.campaign,
    "kernels": kernels,
    "starts": campaigns.starts,
    "dynamics": dynamics,
    "scaling": scaling.scaling,
}
