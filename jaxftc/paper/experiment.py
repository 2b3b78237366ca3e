"""The paper's experiment: four conditions, three observers, three controllers; ``claims`` says what became of its claims.

One set of gains serves every run. The three controllers are compared at equal chattering: each runs with its switching
gain scaled over ``SWEEP``, and its tracking error is read off where it chatters as ESMC does with the gains as given. That
is done for ``SEEDS`` encoder noises, the same for all three; a difference counts where its
95 % interval leaves out 0.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc import identify, stages
from jaxftc.compile.jit import jit
from jaxftc.config import CONTROLS, OBSERVERS, Config
from jaxftc.evaluation import metrics
from jaxftc.gains import Gains
from jaxftc.paper.claims import judge
from jaxftc.paper.results import Arx, Comparison, Experiment, Row
from jaxftc.robot.dynamics import ENGINES
from jaxftc.scenarios.scenario import CONDITIONS, Scenario, paper_scenario, stack, trail
from jaxftc.simulation.closed_loop import Trace, blank_trace, check, lead, program_kind, watch
from jaxftc.types import Array

SWEEP = np.geomspace(1 / 8, 8, 9)  # factors on the switching gain; the middle one is 1
SEEDS = 5  # encoder noises per condition and factor
T_95 = 2.776  # Student's t, two-sided 95 %, SEEDS - 1 degrees of freedom
WRONG = (("healthy", 0.1), ("actuator", 3.0))  # Figure 7: a condition, and the factor that makes its thresholds wrong
PLAIN = len(CONDITIONS) + 1 + len(WRONG)  # runs whose traces are kept: the conditions, healthy once more, wrong thresholds
LAST = OBSERVERS[-1], CONTROLS[-1]


def run(config: Config, gains: Gains, key: Array) -> Experiment:
    """Run the whole experiment: every pair, condition, factor and noise side by side in one program.

    Raises:
        ValueError: a run diverged.
    """
    pairs = [(observer, control) for observer in OBSERVERS for control in CONTROLS]
    swept = [pair for pair in pairs if pair[0] == OBSERVERS[-1]]
    plain, sweep = _plain(config), _sweep(config)
    scenarios = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *[plain] * len(pairs), *[sweep] * len(swept))
    runs = [(pair, len(plain.id)) for pair in pairs] + [(pair, len(sweep.id)) for pair in swept]
    on = [stages.of(dataclasses.replace(config, observer=o, control=c)) for (o, c), _ in runs]  # pyright: ignore[reportArgumentType]
    flags = stages.Stages(*(jnp.asarray(np.repeat(f, [count for _, count in runs])) for f in zip(*on, strict=True)))
    threshold = np.ones(PLAIN)
    threshold[-len(WRONG) :] = [factor for _, factor in WRONG]
    factors = np.repeat(SWEEP, SEEDS * len(CONDITIONS))
    scaled = _scaled(
        gains,
        switching=np.concatenate([np.ones(PLAIN * len(pairs)), np.tile(factors, len(swept))]),
        threshold=np.concatenate([np.tile(threshold, len(pairs)), np.ones(len(factors) * len(swept))]),
    )
    check(config, scaled, scenarios)
    program, count = _PROGRAMS[config.engine], PLAIN * len(pairs)
    kept, curve = program(stages.general(config), count, flags, scaled, trail(scenarios), key)
    kept = lead(kept)

    first = {pair: PLAIN * k for k, pair in enumerate(pairs)}
    traces = {pair: [metrics.columns(kept, at + c) for c in range(len(CONDITIONS))] for pair, at in first.items()}
    rows = [
        Row(condition, *pair, **metrics.evaluate(config, traces[pair][c])._asdict())
        for c, condition in enumerate(CONDITIONS)
        for pair in pairs
    ]
    shape = (2, len(swept), len(SWEEP), SEEDS, len(CONDITIONS))
    curves = dict(zip(CONTROLS, np.moveaxis(np.asarray(curve).reshape(shape), 1, 0), strict=True))
    again, *wrong = (metrics.columns(kept, first[LAST] + c) for c in range(len(CONDITIONS), PLAIN))
    arx = _arx(config, gains, traces[LAST][0], again)
    experiment = Experiment(rows, list(_comparisons(curves)), traces, wrong, curves, arx, [])
    return experiment._replace(claims=list(judge(config, experiment)))


def _plain(config: Config) -> Scenario:
    """The runs whose traces are kept."""
    kept = [*enumerate(CONDITIONS), (len(CONDITIONS), "healthy")]  # noise, condition
    kept += [(CONDITIONS.index(condition), condition) for condition, _ in WRONG]
    return stack([paper_scenario(condition, config, scenario_id=noise) for noise, condition in kept])


def _sweep(config: Config) -> Scenario:
    """Factor, seed and condition (fastest) on one axis.

    The noise of a run depends on seed and condition, so that factors and controllers are compared on the same.
    """
    four = stack([paper_scenario(condition, config) for condition in CONDITIONS])
    many = jax.tree.map(lambda leaf: jnp.concatenate([leaf] * len(SWEEP) * SEEDS), four)
    return many._replace(id=jnp.tile(100 + jnp.arange(SEEDS * len(CONDITIONS), dtype=jnp.int32), len(SWEEP)))


def _scaled(gains: Gains, switching: np.ndarray, threshold: np.ndarray) -> Gains:
    """Gains of the runs: switching gains and thresholds times a factor each."""
    control, diagnosis = gains.control, gains.diagnosis
    return gains.replace(
        {
            "control.alpha_sm": switching * control.alpha_sm[:, None],
            "control.alpha_sm2": switching * control.alpha_sm2[:, None],
            "diagnosis.alpha_tau": threshold * diagnosis.alpha_tau[:, None],
            "diagnosis.alpha_q": threshold * diagnosis.alpha_q[:, None],
        }
    )


def _all(
    config: Config, count: int, on: stages.Stages, gains: Gains, scenarios: Scenario, key: Array
) -> tuple[Trace, Array]:
    """Traces of the first ``count`` runs, and (chattering 1/s, tracking rms rad) [2, runs] of those behind them."""
    limit = config.robot.torque_limit
    scale = jnp.asarray(np.where(np.isfinite(limit), limit, 1.0), gains.arx.xi_a.dtype)[:, None]

    def look(seen: tuple[Array, Array, Array], tick: Trace) -> tuple[tuple[Array, Array, Array], Trace]:
        tau, travel, square = seen
        travel = travel + jnp.where(tick.t > 0, jnp.abs(tick.out.tau - tau) / scale, 0.0).mean(0)
        square = square + ((tick.q - tick.q_ref) ** 2).mean(0)
        return (tick.out.tau, travel, square), jax.tree.map(lambda x: x[..., :count] if x.ndim else x, tick)

    zero = jnp.zeros((config.n, len(scenarios.id)), scale.dtype)
    (_, travel, square), kept = watch(config, gains, scenarios, key, (zero, zero[0], zero[0]), look, on)
    figures = jnp.stack([travel / (config.ticks * config.dt), jnp.sqrt(square / config.ticks)])
    return kept, figures[:, count:]


_PROGRAMS = {
    engine: jit(_all, kind=program_kind(engine), static_argnums=(0, 1), cached_as="paper", like=(blank_trace(), 0))
    for engine in ENGINES
}


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
