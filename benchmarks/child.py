"""The child's end of a worker: the workload, run whenever the parent asks; it returns what the parent checks."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from benchmarks import kernels, workloads
from benchmarks.clock import timed
from benchmarks.machine import own_peak
from benchmarks.peers import mjx_default
from benchmarks.worker import Task
from jaxftc.cli import common
from jaxftc.compile import native
from jaxftc.config import Config
from tuning.problem import LOST


def serve(task: Task, options: common.Options) -> None:
    """Call once, then on every line of stdin that says so; an answer is a line of JSON."""
    config = Config(common.load_arm(options), engine=task.engine, duration=task.duration)
    gains = common.load_or_default(options, config)
    call = _workload(task, config, gains)
    jax.block_until_ready(jax.numpy.zeros(()))  # the backend is up before the clock runs
    word = "run"
    while word:
        if word == "memory":
            answer = {"bytes": workloads.set_aside(workloads.largest_program())}
        elif word == "kernels":
            (module,) = workloads.largest_program().hlo_modules()
            answer = {"turns": kernels.count(module.to_string(), task.batch // len(jax.local_devices()))}
        else:
            seconds, value = timed(call)
            answer = {"seconds": seconds, "value": value, "peak_bytes": own_peak()}
        print(json.dumps(answer), flush=True)
        word = sys.stdin.readline().strip()


def _workload(task: Task, config: Config, gains: Any) -> Callable[[], Any]:
    if task.what == "loop":
        loop = workloads.loop(config, gains, task.batch)
        return lambda: loop().ise[:8].tolist()
    if task.what == "mjx":
        arms, begin = mjx_default.Plant(config.robot, config.dt, config.ticks), workloads.starts(config, task.batch)
        return lambda: [np.asarray(x).T.tolist() for x in arms(*begin)]
    if task.what == "tick":
        return lambda: _ticks(config, gains, task.batch)
    gradient = workloads.gradient(config, gains, task.batch)

    def summary() -> dict[str, Any]:
        state, steps = gradient()
        sound = (steps.terms < LOST).all() and np.isfinite(state.theta).all() and (steps.gradient_norm > 0).all()
        return {"sound": bool(sound), "terms": steps.terms.tolist(), "theta": state.theta.tolist()}

    return summary


def _ticks(config: Config, gains: Any, calls: int) -> dict[str, dict[str, float]]:
    """Of single ticks by each way to call them: percentiles, microseconds, and how far torques are from ``simulate``'s.

    The last is over the joint's limit. Without a C compiler, the ways that need one are left out.
    """
    run = workloads.recorded(config, gains)
    limit = np.where(np.isfinite(config.robot.torque_limit), config.robot.torque_limit, 1.0)
    done = {"tick": workloads.tick(config, gains, run, calls, "xla")}
    if native.compiler() is not None:
        done["tick_backend_c"] = workloads.tick(config, gains, run, calls, "c")
        with tempfile.TemporaryDirectory() as folder:
            done["tick_c"] = workloads.exported_tick(config, gains, run, calls, Path(folder))
    found = {}
    for name, ticks in done.items():
        shares = zip(("p50", "p99", "p999"), (50, 99, 99.9), strict=True)
        found[name] = {f"{name}_{key}_us": float(np.percentile(ticks.microseconds, share)) for key, share in shares}
        found[name]["error"] = float(np.abs((ticks.torque - run.torque) / limit).max())
    return found


def main(task: Task) -> None:
    """The process's settings first, then the workload."""
    if task.cores is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: task.cores])
    options = common.Options(
        engine=task.engine,
        robot=task.robot,
        tip=task.tip,
        lock=tuple(task.lock),
        coulomb=task.coulomb,
        gains=None if task.gains is None else Path(task.gains),
    )
    common.prepare(options, many=task.what in ("loop", "gradient"), devices=task.what == "gradient")  # as the commands do
    if task.what == "tick":  # as a control loop does, see jaxftc.Tick
        jax.config.update("jax_cpu_enable_async_dispatch", False)
    serve(task, options)


if __name__ == "__main__":
    main(Task(**json.loads(sys.argv[1])))
