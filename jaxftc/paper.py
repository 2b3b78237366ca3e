"""The paper's experiment: four conditions, three observers, three controllers; ``claims`` says what became of its claims.

One set of gains serves every run. The three controllers are compared at equal chattering: each runs with its switching
gain scaled over ``SWEEP``, and its tracking error is read off where it chatters as ESMC does with the gains as given. That
is done for ``SEEDS`` encoder noises, the same for all three; a difference counts where its
95 % interval leaves out 0.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc import identify, metrics
from jaxftc.claims import Claim, judge
from jaxftc.closed_loop import Trace, simulate
from jaxftc.compile import jit
from jaxftc.config import CONTROLS, OBSERVERS, Config
from jaxftc.faults.scenario import CONDITIONS, Scenario, paper_scenario, stack, trail
from jaxftc.gains import Gains
from jaxftc.types import Array

SWEEP = np.geomspace(1 / 8, 8, 9)  # factors on the switching gain; the middle one is 1
SEEDS = 5  # encoder noises per condition and factor
T_95 = 2.776  # Student's t, two-sided 95 %, SEEDS - 1 degrees of freedom
WRONG = (("healthy", 0.1), ("actuator", 3.0))  # Figure 7: a condition, and the factor that makes its thresholds wrong
PLAIN = len(CONDITIONS) + 1 + len(WRONG)  # runs whose traces are kept: the conditions, healthy once more, wrong thresholds
LAST = OBSERVERS[-1], CONTROLS[-1]


class Row(NamedTuple):
    """One condition with one observer and one controller."""

    condition: str
    observer: str
    controller: str
    fault_tau_rms_nm: float
    fault_q_rms_deg: float
    delay_s: float | None
    isolated: bool
    false_alarm_s: float | None
    tracking_rms_deg: float
    chattering: float


class Comparison(NamedTuple):
    """Two controllers in one condition at equal chattering, over the seeds."""

    condition: str
    before: str
    after: str
    seeds: int
    chattering: float  # 1/s, at which both were read off
    louder: bool  # ``before`` chatters more than that even at its calmest, where it was read off
    before_deg: float  # tracking rms, geometric mean
    after_deg: float
    change: tuple[float, float, float]  # relative: mean, and 95 % interval from low to high

    @property
    def word(self) -> str:
        """What became of the error: falls, rises or tie."""
        return "falls" if self.change[2] < 0 else "rises" if self.change[1] > 0 else "tie"


class Arx(NamedTuple):
    """The ARX-Laguerre model identified from one healthy run, on another: same motion, other noise."""

    log: identify.Log
    free_run: np.ndarray  # [T, n] rad, predicted from the first reading and the torques alone
    errors: identify.Errors


class Experiment(NamedTuple):
    """Everything that the table, the claims and the report need."""

    rows: list[Row]
    comparisons: list[Comparison]
    traces: dict[tuple[str, str], list[dict[str, np.ndarray]]]  # (observer, controller) -> columns by condition
    wrong: list[dict[str, np.ndarray]]  # columns of the runs of WRONG, T-S with AFESMC
    curves: dict[str, np.ndarray]  # controller -> (chattering 1/s, tracking rms rad) [2, factors, seeds, conditions]
    arx: Arx
    claims: list[Claim]


def run(config: Config, gains: Gains, key: Array, on_done: Callable[[], object] = lambda: None) -> Experiment:
    """Run the whole experiment; ``on_done`` is called after each of the nine pairs of observer and controller.

    Raises:
        ValueError: a run diverged.
    """
    pairs = [(observer, control) for observer in OBSERVERS for control in CONTROLS]
    plain = _plain(config, gains)
    swept = _with_sweep(config, gains, plain[0])

    def one(pair: tuple[str, str]) -> tuple[Trace, Array]:
        variant = dataclasses.replace(config, observer=pair[0], control=pair[1])  # pyright: ignore[reportArgumentType]
        scenarios, scaled = swept if pair[0] == OBSERVERS[-1] else plain
        result = jax.block_until_ready(_pair(variant, scaled, scenarios, key))
        on_done()
        return result

    with ThreadPoolExecutor(2) as pool:  # XLA compiles outside the interpreter lock
        results = dict(zip(pairs, pool.map(one, pairs), strict=True))
    traces = {pair: [metrics.columns(trace, c) for c in range(len(CONDITIONS))] for pair, (trace, _) in results.items()}
    rows = [
        Row(condition, *pair, **metrics.evaluate(config, traces[pair][c])._asdict())
        for c, condition in enumerate(CONDITIONS)
        for pair in pairs
    ]
    shape = (2, len(SWEEP), SEEDS, len(CONDITIONS))
    curves = {control: np.asarray(results[OBSERVERS[-1], control][1]).reshape(shape) for control in CONTROLS}
    again, *wrong = (metrics.columns(results[LAST][0], c) for c in range(len(CONDITIONS), PLAIN))
    arx = _arx(config, gains, traces[LAST][0], again)
    experiment = Experiment(rows, list(_comparisons(curves)), traces, wrong, curves, arx, [])
    return experiment._replace(claims=list(judge(config, experiment)))


def _plain(config: Config, gains: Gains) -> tuple[Scenario, Gains]:
    """The runs whose traces are kept, on a trailing axis, and their gains."""
    kept = [*enumerate(CONDITIONS), (len(CONDITIONS), "healthy")]  # noise, condition
    kept += [(CONDITIONS.index(condition), condition) for condition, _ in WRONG]
    scenarios = [paper_scenario(condition, config, scenario_id=noise) for noise, condition in kept]
    return trail(stack(scenarios)), _scaled(gains, np.ones(PLAIN))


def _with_sweep(config: Config, gains: Gains, plain: Scenario) -> tuple[Scenario, Gains]:
    """The plain runs, then factor, seed and condition (fastest) on the same trailing axis, and gains scaled to match.

    The noise of a run depends on seed and condition, so that factors and controllers are compared on the same.
    """
    four = trail(stack([paper_scenario(condition, config) for condition in CONDITIONS]))
    runs = jnp.arange(SEEDS * len(CONDITIONS), dtype=jnp.int32)
    many = jax.tree.map(lambda leaf: jnp.concatenate([leaf] * len(SWEEP) * SEEDS, axis=-1), four)
    many = many._replace(id=jnp.tile(100 + runs, len(SWEEP)))
    both = jax.tree.map(lambda a, b: jnp.concatenate([a, b], axis=-1), plain, many)
    return both, _scaled(gains, np.concatenate([np.ones(PLAIN), np.repeat(SWEEP, len(runs))]))


def _scaled(gains: Gains, switching: np.ndarray) -> Gains:
    """Gains of the runs: switching gains times a factor each, thresholds as given but for the last plain runs, WRONG's."""
    threshold = np.ones_like(switching)
    threshold[PLAIN - len(WRONG) : PLAIN] = [factor for _, factor in WRONG]
    blocks = {
        name: dataclasses.replace(block, **{gain: jnp.asarray(factor) * getattr(block, gain)[:, None] for gain in scaled})
        for name, block, factor, scaled in (
            ("control", gains.control, switching, ("alpha_sm", "alpha_sm2")),
            ("diagnosis", gains.diagnosis, threshold, ("alpha_tau", "alpha_q")),
        )
    }
    return dataclasses.replace(gains, **blocks)


def _pair(config: Config, gains: Gains, scenarios: Scenario, key: Array) -> tuple[Trace, Array]:
    """Traces of the plain runs, and (chattering 1/s, tracking rms rad) [2, runs] of those behind them."""
    trace = simulate(config, gains, scenarios, key)
    limit = config.robot.torque_limit
    scale = jnp.asarray(np.where(np.isfinite(limit), limit, 1.0), trace.q.dtype)[:, None]
    travel = (jnp.abs(jnp.diff(trace.out.tau, axis=0)).sum(0) / scale).mean(0) / (config.ticks * config.dt)
    tracking = jnp.sqrt(((trace.q - trace.q_ref) ** 2).mean((0, 1)))
    plain = jax.tree.map(lambda x: x if x.ndim == 1 else x[..., :PLAIN], trace)
    return plain, jnp.stack([travel, tracking])[:, PLAIN:]


_pair = jit(_pair, static_argnums=0)


def _arx(config: Config, gains: Gains, learn: dict[str, np.ndarray], check: dict[str, np.ndarray]) -> Arx:
    """The model identified from one run, on another."""
    log, other = (identify.Log(q=run_["y"], tau=run_["tau"]) for run_ in (learn, check))
    model = identify.fit_multistep(config, gains, log, horizon=len(log.q))
    return Arx(other, identify.predict(config, model, other, len(other.q)), identify.errors(config, model, other))


def _comparisons(curves: dict[str, np.ndarray]) -> Iterator[Comparison]:
    """Neighbouring controllers, by condition, from the curves of each."""
    for c, condition in enumerate(CONDITIONS):
        level = curves["esmc"][0, len(SWEEP) // 2, :, c]  # [seeds], the gains as given
        read = {
            control: np.array([metrics.at_level(curve[:, :, s, c], level[s]) for s in range(SEEDS)])
            for control, curve in curves.items()
        }
        for before, after in pairwise(CONTROLS):
            ratio = np.log(read[after][:, 1] / read[before][:, 1])
            half = T_95 * ratio.std(ddof=1) / np.sqrt(SEEDS)
            mean, low, high = np.expm1([ratio.mean(), ratio.mean() - half, ratio.mean() + half])
            error = {name: float(np.rad2deg(np.exp(np.log(values[:, 1]).mean()))) for name, values in read.items()}
            yield Comparison(
                condition,
                before,
                after,
                SEEDS,
                chattering=float(level.mean()),
                louder=bool(read[before][:, 0].mean() > 1.02 * level.mean()),
                before_deg=error[before],
                after_deg=error[after],
                change=(float(mean), float(low), float(high)),
            )


def as_json(experiment: Experiment) -> dict[str, Any]:
    """The machine-readable result; the infinite delay of a miss becomes null, with isolated false."""
    rows = [row._asdict() for row in experiment.rows]
    for row in rows:
        if row["delay_s"] is not None and not np.isfinite(row["delay_s"]):
            row["delay_s"] = None
    comparisons = [pair._asdict() | {"result": pair.word} for pair in experiment.comparisons]
    return {"claims": [claim._asdict() for claim in experiment.claims], "rows": rows, "equal_chattering": comparisons}
