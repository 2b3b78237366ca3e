"""What is timed on our side, each as a function without arguments, called the way that users and commands call it."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc import export
from jaxftc.campaigns import run
from jaxftc.compile import native
from jaxftc.compile.jit import jit
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.realtime.tick import Tick
from jaxftc.robot import dynamics as arm
from jaxftc.scenarios import reference
from jaxftc.scenarios.sample import sample_scenarios
from jaxftc.scenarios.scenario import Scenario, paper_scenario, take, trail
from jaxftc.schemes import registry
from jaxftc.simulation import closed_loop
from jaxftc.types import Measurement, Reference
from tuning import transform
from tuning.descent import Descent, State, Steps
from tuning.problem import Problem
from tuning.settings import ROUND, Settings
from tuning.terms import OBJECTIVE

Array = np.ndarray
NOISE, DRAW = 0, 1  # seeds


class Starts(NamedTuple):
    """Arms in motion under a held torque, all [n, B]."""

    q: Array  # rad
    qd: Array  # rad/s
    tau: Array  # N m


def starts(config: Config, batch: int) -> Starts:
    """Near the holding torque, so that arms move like arms and not like flails."""
    draw, robot = np.random.default_rng(DRAW), config.robot
    q, qd, push = (draw.uniform(-size, size, (robot.n, batch)) for size in (1.0, 0.5, 0.05))
    q = q + robot.q_zero[:, None]
    hold = np.asarray(arm.inverse_dynamics(robot, jnp.asarray(q), jnp.zeros_like(q), jnp.zeros_like(q)), float)
    limit = np.where(np.isfinite(robot.torque_limit), robot.torque_limit, 1.0)
    return Starts(*(x.astype(np.float32).astype(float) for x in (q, qd, hold + push * limit[:, None])))


def over_cores(call: Callable[[Any], Any], pieces: Iterable[Any], cores: int) -> list[Any]:
    """The same program on every piece, as many at a time as there are cores: what campaigns do."""
    with ThreadPoolExecutor(cores) as pool:
        return list(pool.map(call, pieces))


def plant(config: Config, begin: Starts, width: int, cores: int) -> Callable[[], list[tuple[Array, Array]]]:
    """Every (q, qd) [T, n, width] after each step, every arm with masses and friction of its own.

    The factors are 1 and the Coulomb friction 0, as MuJoCo's model has it; the program does not know.
    """
    robot, own = config.robot, _smooth(config, width)

    def block(plant: arm.Plant, q: jax.Array, qd: jax.Array, tau: jax.Array) -> tuple[jax.Array, jax.Array]:
        def body(at: tuple[jax.Array, jax.Array], _: None) -> tuple[Any, Any]:
            at = arm.advance(robot, config.engine, plant, *at, tau, config.dt)
            return at, at

        return jax.lax.scan(body, (q, qd), None, length=config.ticks)[1]

    program, pieces = jit(block, kind=closed_loop.program_kind(config.engine)), _pieces(begin, width)
    return lambda: over_cores(lambda piece: jax.block_until_ready(program(own, *piece)), pieces, cores)


def dynamics(config: Config, begin: Starts, width: int, cores: int) -> Callable[[], Array]:
    """Forward dynamics [B, n] of the same arms, once."""
    own = _smooth(config, width)

    def accelerations(q: jax.Array, qd: jax.Array, tau: jax.Array) -> jax.Array:
        return arm.forward_dynamics(config.robot, q, qd, tau, config.engine, own)

    program = jit(accelerations, kind=closed_loop.program_kind(config.engine))
    pieces = _pieces(begin, width)
    return lambda: np.concatenate(over_cores(lambda piece: np.asarray(program(*piece)), pieces, cores), axis=1).T


def _smooth(config: Config, width: int) -> arm.Plant:
    plant = arm.nominal_plant(config.robot)._replace(coulomb=jnp.zeros(config.n))
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[..., None], (*leaf.shape, width)) + 0.0, plant)


def _pieces(begin: Starts, width: int) -> list[list[jax.Array]]:
    return [[jnp.asarray(x[:, k : k + width], float) for x in begin] for k in range(0, begin.q.shape[1], width)]


def drawn(config: Config, batch: int) -> Scenario:
    """Scenarios of the preset ``standard``, leading axis, as NumPy arrays."""
    return take(sample_scenarios(jax.random.key(DRAW), batch, config=config), slice(None))


def loop(config: Config, gains: Gains, batch: int, lanes: int | None = None) -> Callable[[], Any]:
    """The closed loop of ``batch`` scenarios, scored: what a campaign does between drawing and storing.

    ``lanes`` is how many run side by side in one program; the library's own width if not given.
    """
    scenarios, backend = drawn(config, batch), jax.default_backend()

    def call() -> Any:
        own = run.LANES.copy()
        if lanes is not None:
            run.LANES[backend] = lanes
        try:
            return run.scores(config, gains, scenarios, jax.random.key(NOISE))
        finally:
            run.LANES.clear()
            run.LANES.update(own)

    return call


def gradient(config: Config, gains: Gains, batch: int) -> Callable[[], tuple[State, Steps]]:
    """A round of ``tune``, as one program: ROUND gradient steps over batches of scenarios; everything as NumPy arrays."""
    problem = Problem(config, OBJECTIVE, jax.random.key(NOISE), batch)
    space = transform.space(config, gains, transform.select(config))
    descent = Descent(problem, space, mode="reverse", optimizer="adam", rate=Settings.learning_rate, steps=ROUND)
    start, widen, before = descent.init(np.zeros(space.size)), np.ones(ROUND), np.zeros((ROUND, len(OBJECTIVE), batch))
    scenarios = jax.tree.map(lambda leaf: np.stack([leaf] * ROUND), trail(drawn(config, batch)))
    return lambda: descent.round(start, widen, scenarios, before)


def set_aside(program: Any) -> int:
    """Bytes that a program sets aside beside arguments and results, over all devices."""
    return program.get_compiled_memory_stats().temp_size_in_bytes * len(program.local_devices())


def largest_program() -> Any:
    """The program of this process that sets the most memory aside."""
    return max(jax.local_devices()[0].client.live_executables(), key=set_aside)


class Recorded(NamedTuple):
    """A run of ``simulate`` on the paper's motion: what its controller saw and said, tick by tick."""

    q_start: Array  # [n] rad
    signals: Array  # [T, 5, n] reference, reading and command of the tick before, rad, rad/s, rad/s^2, rad, N m
    torque: Array  # [T, n] N m, commands


def recorded(config: Config, gains: Gains) -> Recorded:
    """The run that single ticks are timed on."""
    scenario = paper_scenario("both", config)
    trace = closed_loop.simulate(config, gains, scenario, jax.random.key(NOISE))
    y, torque = (np.asarray(x) for x in (trace.y, trace.out.tau))
    wanted = reference.cubic(scenario.q_start[:, None], scenario.q_goal[:, None], config.t_final, trace.t)
    told = np.concatenate([np.asarray(registry.holding_torque(config, scenario.q_start))[None], torque[:-1]])
    signals = np.stack([*(np.asarray(x).T for x in wanted), y, told], axis=1)
    return Recorded(np.asarray(scenario.q_start), signals, torque)


class Ticks(NamedTuple):
    """Single ticks."""

    microseconds: Array  # [calls]
    torque: Array  # [T, n] N m, of the last lap


def tick(config: Config, gains: Gains, run: Recorded, calls: int, backend: Literal["xla", "c"]) -> Ticks:
    """``jaxftc.Tick`` called from Python once a tick of a recorded run, again and again: NumPy in, NumPy out.

    It gets the recorded commands, not its own: a recording does not answer to those, and rounding would grow in them.
    """
    compiled = Tick(config, gains, backend=backend)
    blank, torque, seconds = compiled.init(run.q_start), np.zeros_like(run.torque), []
    state = blank
    for call in range(config.ticks + calls):  # one lap to warm up
        k = call % config.ticks
        if k == 0:
            state = blank
        signals: Any = list(run.signals[k])
        began = time.perf_counter()
        state, out = compiled.step(state, Reference(*signals[:3]), Measurement(*signals[3:]))
        seconds.append(time.perf_counter() - began)
        torque[k] = out.tau
    return Ticks(1e6 * np.array(seconds[config.ticks :]), torque)


def exported_tick(config: Config, gains: Gains, run: Recorded, calls: int, folder: Path) -> Ticks:
    """The C code of ``jaxftc export`` on the same run, called and timed from C."""
    export.write(config, gains, folder, real="float")
    names = [folder / name for name in ("signals", "seconds", "torque")]
    run.signals.astype(np.float32).tofile(names[0])
    native.build([Path(__file__).with_name("tick.c"), folder / "ftc_step.c"], folder / "tick", f"-I{folder}")
    subprocess.run([folder / "tick", *names, str(config.ticks), str(calls)], check=True)
    torque = np.fromfile(names[2], np.float32).reshape(run.torque.shape)
    return Ticks(1e6 * np.fromfile(names[1]), torque)
