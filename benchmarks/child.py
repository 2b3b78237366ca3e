"""The child's end of a worker: the workload, run whenever the parent asks; it returns what the parent checks."""

from __future__ import annotations

import json
import os
import sys
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


def _ticks(config: Config, gains: Any, calls: int) -> dict[str, float]:
    """Percentiles of single ticks, microseconds, and how far their torque is from ``simulate``'s, over its limit."""
    done = workloads.tick(config, gains, calls)
    limit = np.where(np.isfinite(config.robot.torque_limit), config.robot.torque_limit, 1.0)
    shares = zip(("tick_p50_us", "tick_p99_us", "tick_p999_us"), (50, 99, 99.9), strict=True)
    percentiles = {key: float(np.percentile(done.microseconds, share)) for key, share in shares}
    return percentiles | {"error": float(np.abs((done.torque - done.expected) / limit).max())}


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
