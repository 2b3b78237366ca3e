"""Scenarios through the closed loop, scored while they run.

One compiled program of a fixed number of scenarios does all the work, whatever is asked for, several at a time on a machine
with several cores: how a campaign is cut, its order and the number of cores change no bit of a row. (Two programs that
differ in width, or in how they are spread over devices, round differently.) The program also keeps the trace of its first
scenario, which costs nothing, so that a replay is the same program again.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc import checks, stages
from jaxftc.compile.devices import cores
from jaxftc.compile.jit import jit
from jaxftc.config import Config
from jaxftc.diagnosis import threshold
from jaxftc.evaluation import online, table
from jaxftc.gains import Gains
from jaxftc.scenarios.preset import Preset
from jaxftc.scenarios.sample import draw_all
from jaxftc.scenarios.scenario import Scenario, take, trail
from jaxftc.simulation.closed_loop import Trace, blank_trace, check, program_kind, watch
from jaxftc.types import Array
from jaxftc.variants import SCHEMES

LANES = {"cpu": 256}  # scenarios side by side: enough to fill a core's vector units, few enough for its caches
MANY_LANES = 4096  # on a device with thousands of cores; two such blocks run at a time


def campaign(
    config: Config,
    gains: Gains,
    scenarios: Scenario,
    key: Array,
    done: Callable[[int], object] = lambda count: None,
    *,
    at_a_time: int | None = None,
) -> dict[str, np.ndarray]:
    """Run scenarios through the closed loop and score them while they run, on all cores.

    Args:
        config: Robot, structure and timing.
        gains: One set for all scenarios.
        scenarios: A set with a leading axis, as ``sample_scenarios`` draws it.
        key: Of the encoder noise; a scenario's noise depends on it and the scenario's id alone.
        done: Called with the number of runs that are newly through.
        at_a_time: Programs that run at a time; one for each core of the process if None.

    Returns:
        Columns by name, a row a scenario (``docs/campaigns.md`` lists them).

    Raises:
        ValueError: gains or scenarios are of a wrong shape, not finite or outside their limits.
    """
    return table.columns(config, scenarios, scores(config, gains, scenarios, key, done, at_a_time))


def scores(
    config: Config,
    gains: Gains,
    scenarios: Scenario,
    key: Array,
    done: Callable[[int], object] = lambda count: None,
    at_a_time: int | None = None,
) -> online.Score:
    """The scores of scenarios with a leading axis, [..., scenarios], as NumPy arrays."""
    if at_a_time is not None:
        checks.integer("at_a_time", at_a_time, 1, "None is one for each core")
    check_set(scenarios)
    check(config, gains, scenarios)
    checks.random_key("key", key)
    program, on = _program(stages.general(config), threshold.follows(gains.diagnosis)), stages.as_data(config)
    order = np.argsort(_onset(config, scenarios), kind="stable")
    found = _in_blocks(take(scenarios, order), lambda piece: program(key, on, gains, piece)[0], done, at_a_time)
    return jax.tree.map(lambda leaf: leaf[..., np.argsort(order)], found)


def check_set(scenarios: Scenario) -> None:
    """Refuse what is no set of scenarios with a leading axis, or an empty one.

    Raises:
        ValueError: it is another thing, one scenario, or none.
    """
    checks.instance("scenarios", scenarios, Scenario)
    if np.ndim(scenarios.id) != 1:
        raise ValueError(
            "scenarios must have one leading axis, as sample_scenarios gives them, got ids of shape "
            f"{list(np.shape(scenarios.id))}; jaxftc.simulate takes a single one"
        )
    if not len(scenarios.id):
        raise ValueError("scenarios must be at least one, got none; draw them with jaxftc.sample_scenarios")


def _onset(config: Config, scenarios: Scenario) -> np.ndarray:
    """First onset [scenarios] s, infinite in a healthy run: until the first of a block the learned decision is not asked."""
    true = online.truth(config, trail(scenarios))
    return np.asarray(jnp.where(true.healthy, jnp.inf, true.onset))


def torque_statistics(config: Config, gains: Gains, scenarios: Scenario, key: Array, every: int) -> np.ndarray:
    """|S| of the torque channel [n, ticks, scenarios] N m, every so many ticks of scenarios with a leading axis."""
    program, on = _statistics(stages.general(config), every), stages.as_data(config)
    return np.moveaxis(_in_blocks(scenarios, lambda piece: program(on, gains, trail(piece), key)), 0, 1)


def _in_blocks(
    scenarios: Scenario,
    run: Callable[[Scenario], Any],
    done: Callable[[int], object] = lambda count: None,
    at_a_time: int | None = None,
) -> Any:
    """What ``run`` makes of scenarios, its last axis, a program's width at a time on all cores; as NumPy arrays."""
    count, wide = len(scenarios.id), width()

    def block(first: int) -> Any:
        return jax.tree.map(np.asarray, run(take(scenarios, np.arange(first, first + wide) % count)))

    pieces, starts = [], range(0, count, wide)
    pool = ThreadPoolExecutor(at_a_time or _at_a_time())
    try:
        for first, piece in zip(starts, pool.map(block, starts), strict=True):
            pieces.append(piece)
            done(min(wide, count - first))
    finally:
        pool.shutdown(cancel_futures=True)
    return jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1)[..., :count], *pieces)


def draw(preset: Preset, config: Config, key: Array, ids: np.ndarray) -> Scenario:
    """Scenarios of any ids, leading axis, as NumPy arrays; each depends on the key and its id alone, to the last bit."""
    wide, pieces = width(), []
    for first in range(0, len(ids), wide):
        some = ids[np.arange(first, first + wide) % len(ids)]
        pieces.append(jax.tree.map(np.asarray, draw_all(preset, config, key, jnp.asarray(some))))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[: len(ids)], *pieces)


def replay(config: Config, gains: Gains, scenario: Scenario, key: Array) -> tuple[dict[str, np.ndarray], Trace]:
    """One scenario's row, bit for bit that of its campaign, and its trace [T, n]."""
    copies = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[None], width(), axis=0), scenario)
    check(config, gains, copies)
    program = _program(stages.general(config), threshold.follows(gains.diagnosis))
    result, trace = program(key, stages.as_data(config), gains, copies)
    row = table.columns(config, take(copies, slice(0, 1)), jax.tree.map(lambda leaf: np.asarray(leaf)[..., :1], result))
    return row, trace


@functools.lru_cache(maxsize=16)
def _program(
    config: Config, follows: bool
) -> Callable[[Array, stages.Stages | None, Gains, Scenario], tuple[online.Score, Trace]]:
    """(key, stages, gains, scenarios with a leading axis) to (scores, trace of the first).

    ``follows`` says whether torque thresholds follow the motion: a program of constant ones does not look at it.
    """

    def block(key: Array, on: stages.Stages | None, gains: Gains, scenarios: Scenario) -> tuple[online.Score, Trace]:
        """Scores [..., scenarios] and the trace [T, n] of the first; scenarios have a trailing axis."""
        gains = gains if follows else threshold.known_constant(gains)
        true = online.truth(config, scenarios)

        def look(state: online.State, tick: Trace) -> tuple[online.State, Trace]:
            first = jax.tree.map(lambda leaf: leaf[..., 0] if leaf.ndim else leaf, tick)
            return online.step(config, gains, true, state, tick), first

        blank = online.init(config, scenarios.q_start.astype(gains.arx.xi_a.dtype))
        last, trace = watch(config, gains, scenarios, key, blank, look, on)
        return online.total(last), trace

    like = online.Score(*[0] * len(online.Score._fields)), blank_trace()  # pyright: ignore[reportArgumentType]
    # The code of a user's scheme is not in a program's name.
    known = f"{config!r} {follows}" if config.scheme in SCHEMES else None
    run = jit(block, kind=program_kind(config.engine), cached_as=known, like=like)
    return lambda key, on, gains, scenarios: run(key, on, gains, trail(scenarios))


@functools.lru_cache(maxsize=4)
def _statistics(config: Config, every: int) -> Callable[..., Array]:
    """(stages, gains, scenarios with a trailing axis, key) to |S| of the torque channel, every so many ticks."""

    def block(on: stages.Stages | None, gains: Gains, scenarios: Scenario, key: Array) -> Array:
        look = lambda seen, tick: (seen, jnp.abs(tick.out.statistic_tau))  # noqa: E731
        return watch(config, gains, scenarios, key, (), look, on)[1][::every]

    return jit(block, kind=program_kind(config.engine))


def width() -> int:
    """Scenarios side by side in one program of a campaign."""
    return LANES.get(jax.default_backend(), MANY_LANES)


def _at_a_time() -> int:
    """Programs that run at a time: one a core on the CPU, two elsewhere so that the device never waits."""
    if jax.default_backend() != "cpu":
        return 2
    return cores()
