"""The paper's experiment: four conditions, three observers, three controllers, and what became of each claim.

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
from jaxftc.closed_loop import Trace, simulate
from jaxftc.compile import jit
from jaxftc.config import CONTROLS, OBSERVERS, Config
from jaxftc.faults.scenario import CONDITIONS, Scenario, paper_scenario, stack, trail
from jaxftc.gains import Gains
from jaxftc.types import Array

SWEEP = np.geomspace(1 / 8, 8, 9)  # factors on the switching gain; the middle one is 1
SEEDS = 5  # encoder noises per condition and factor
T_95 = 2.776  # Student's t, two-sided 95 %, SEEDS - 1 degrees of freedom
TIE = 0.02  # relative difference below which two estimation errors are called equal
ARX_CLAIM_DEG = 0.05
PLAIN = len(CONDITIONS) + 1  # runs with the gains as given
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


class Claim(NamedTuple):
    """A claim of the paper, our number, and whether it was met."""

    id: str
    claim: str
    value: float
    unit: str
    met: bool
    detail: str


class Comparison(NamedTuple):
    """Two controllers in one condition at equal chattering, over the seeds."""

    condition: str
    before: str
    after: str
    chattering: float  # 1/s, at which both were read off
    louder: bool  # ``before`` chatters more than that even at its calmest, where it was read off
    before_deg: float  # tracking rms, geometric mean
    after_deg: float
    change: tuple[float, float, float]  # relative: mean, and 95 % interval from low to high

    @property
    def word(self) -> str:
        """What became of the error: falls, rises or tie."""
        return "falls" if self.change[2] < 0 else "rises" if self.change[1] > 0 else "tie"


class Experiment(NamedTuple):
    """Everything that the table, the claims and the report need."""

    rows: list[Row]
    claims: list[Claim]
    comparisons: list[Comparison]
    traces: dict[tuple[str, str], list[dict[str, np.ndarray]]]  # (observer, controller) -> columns by condition


def run(config: Config, gains: Gains, key: Array, on_done: Callable[[], object] = lambda: None) -> Experiment:
    """Run the whole experiment; ``on_done`` is called after each of the nine pairs of observer and controller.

    Raises:
        ValueError: a run diverged.
    """
    pairs = [(observer, control) for observer in OBSERVERS for control in CONTROLS]
    plain = _batch(config)
    swept = _with_sweep(config, gains, plain)

    def one(pair: tuple[str, str]) -> tuple[Trace, Array]:
        variant = dataclasses.replace(config, observer=pair[0], control=pair[1])  # pyright: ignore[reportArgumentType]
        scenarios, scaled = swept if pair[0] == OBSERVERS[-1] else (plain, gains)
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
    curves = {control: np.asarray(results[OBSERVERS[-1], control][1]) for control in CONTROLS}
    comparisons = list(_comparisons(curves))
    judge = metrics.columns(results[LAST][0], len(CONDITIONS))
    arx = _arx_errors(config, gains, traces[LAST][0], judge)
    return Experiment(rows, list(_claims(config, rows, comparisons, traces[LAST], arx)), comparisons, traces)


def _batch(config: Config) -> Scenario:
    """The four conditions on a trailing axis, and a second healthy run with a noise of its own."""
    scenarios = [paper_scenario(condition, config, scenario_id=c) for c, condition in enumerate(CONDITIONS)]
    return trail(stack([*scenarios, paper_scenario("healthy", config, scenario_id=PLAIN - 1)]))


def _with_sweep(config: Config, gains: Gains, plain: Scenario) -> tuple[Scenario, Gains]:
    """The plain runs, then factor, seed and condition (fastest) on the same trailing axis, and gains scaled to match.

    The noise of a run depends on seed and condition, so that factors and controllers are compared on the same.
    """
    four = trail(stack([paper_scenario(condition, config) for condition in CONDITIONS]))
    runs = jnp.arange(SEEDS * len(CONDITIONS), dtype=jnp.int32)
    many = jax.tree.map(lambda leaf: jnp.concatenate([leaf] * len(SWEEP) * SEEDS, axis=-1), four)
    many = many._replace(id=jnp.tile(100 + runs, len(SWEEP)))
    factor = np.concatenate([np.ones(PLAIN), np.repeat(SWEEP, len(runs))])
    scaled = {name: jnp.asarray(factor) * getattr(gains.control, name)[:, None] for name in ("alpha_sm", "alpha_sm2")}
    both = jax.tree.map(lambda a, b: jnp.concatenate([a, b], axis=-1), plain, many)
    return both, dataclasses.replace(gains, control=dataclasses.replace(gains.control, **scaled))


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


def _arx_errors(config: Config, gains: Gains, learn: dict[str, np.ndarray], judge: dict[str, np.ndarray]) -> identify.Errors:
    """Errors, on one healthy run, of the model identified from another: same motion, other noise."""
    log, other = (identify.Log(q=run_["y"], tau=run_["tau"]) for run_ in (learn, judge))
    return identify.errors(config, identify.fit_multistep(config, gains, log, horizon=len(log.q)), other)


def _comparisons(curves: dict[str, np.ndarray]) -> Iterator[Comparison]:
    """Neighbouring controllers, by condition, from (chattering, tracking) [2, runs] of each."""
    shaped = {control: curve.reshape(2, len(SWEEP), SEEDS, len(CONDITIONS)) for control, curve in curves.items()}
    for c, condition in enumerate(CONDITIONS):
        level = shaped["esmc"][0, len(SWEEP) // 2, :, c]  # [seeds], the gains as given
        read = {
            control: np.array([metrics.at_level(curve[:, :, s, c], level[s]) for s in range(SEEDS)])
            for control, curve in shaped.items()
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
                chattering=float(level.mean()),
                louder=bool(read[before][:, 0].mean() > 1.02 * read[after][:, 0].mean()),
                before_deg=error[before],
                after_deg=error[after],
                change=(float(mean), float(low), float(high)),
            )


def _claims(
    config: Config,
    rows: list[Row],
    comparisons: list[Comparison],
    traces: list[dict[str, np.ndarray]],
    arx: identify.Errors,
) -> Iterator[Claim]:
    sizes = (arx.free_run, arx.one_step, arx.fifty_step, arx.extrapolator_one_step, arx.extrapolator_fifty_step)
    worst, *others = (float(np.rad2deg(size.max.max())) for size in sizes)
    one, fifty, line_one, line_fifty = (f"{value:.3f}" for value in others)
    detail = (
        f"largest, model running alone over the whole motion, identified from another run of it; 1 and 50 steps ahead "
        f"{one} and {fifty} deg, where a straight line through two readings is off by {line_one} and {line_fifty} deg"
    )
    yield Claim("arx_healthy", "healthy ARX-Laguerre error below 0.05 deg", worst, "deg", worst < ARX_CLAIM_DEG, detail)
    for condition, trace in zip(CONDITIONS[1:], traces[1:], strict=True):
        yield _detected(config, condition, trace)
    for channel, name, unit in (("fault_tau_rms_nm", "torque", "N m"), ("fault_q_rms_deg", "encoder", "deg")):
        yield _estimation(rows, channel, name, unit)
    for pair in comparisons:
        if pair.condition != "healthy":
            yield _tracking(pair)


def _detected(config: Config, condition: str, trace: dict[str, np.ndarray]) -> Claim:
    """Verdicts of T-S with AFESMC, joint by joint, and no alarm where there is no fault."""
    wanted, present = metrics.truth(trace["fault_tau"], trace["fault_q"])
    found = metrics.detection(config, trace["verdict"], wanted, present)
    right = int((found.verdict == wanted).sum())
    alarm = (
        "no alarm" if found.delay_s is None or np.isinf(found.delay_s) else f"first alarm after {found.delay_s * 1e3:.0f} ms"
    )
    false = "no false alarm" if found.false_alarm_s is None else f"false alarm at {found.false_alarm_s:.3f} s"
    return Claim(
        f"detect_{condition}",
        "actuator and encoder fault at once: told on all joints"
        if condition == "both"
        else f"{condition} fault detected and told on all joints",
        float(right),
        f"joints of {config.n}",
        right == config.n and found.false_alarm_s is None,
        f"{alarm}, verdict {metrics.SETTLE * 1e3:.0f} ms later, {false}",
    )


def _estimation(rows: list[Row], channel: str, name: str, unit: str) -> Claim:
    """Fault-estimate error from PI to ESO to T-S, mean over the three faulty conditions."""

    def mean(observer: str) -> float:
        chosen = [r for r in rows if (r.observer, r.controller) == (observer, CONTROLS[-1]) and r.condition != "healthy"]
        return float(np.mean([getattr(r, channel) for r in chosen]))

    errors = [mean(observer) for observer in OBSERVERS]
    tied = [step for step, (a, b) in zip(("PI/ESO", "ESO/T-S"), pairwise(errors), strict=True) if abs(b - a) <= TIE * a]
    return Claim(
        f"estimation_{name}",
        f"{name}-fault estimation error falls from PI to ESO to T-S",
        errors[-1],
        unit,
        all(after < (1 - TIE) * before for before, after in pairwise(errors)),
        f"{', '.join(f'{e:.4g}' for e in errors)} {unit}, mean over the faulty conditions"
        + (f"; a tie between {' and '.join(tied)}" if tied else ""),
    )


def _tracking(pair: Comparison) -> Claim:
    before, after = pair.before.upper(), pair.after.upper()
    mean, low, high = (f"{100 * value:+.1f}" for value in pair.change)
    note = f"; {before} chatters more than that even at its calmest, where it was taken" if pair.louder else ""
    return Claim(
        f"tracking_{pair.condition}_{pair.before}_{pair.after}",
        f"{pair.condition}: tracking error falls from {before} to {after} at equal chattering",
        pair.after_deg,
        "deg",
        pair.word == "falls",
        f"{pair.before_deg:.4g} to {pair.after_deg:.4g} deg at {pair.chattering:.2f} 1/s, {mean} % [{low}, {high}] "
        f"over {SEEDS} noises: {pair.word}{note}",
    )


def as_json(experiment: Experiment) -> dict[str, Any]:
    """The machine-readable result; the infinite delay of a miss becomes null, with isolated false."""
    rows = [row._asdict() for row in experiment.rows]
    for row in rows:
        if row["delay_s"] is not None and not np.isfinite(row["delay_s"]):
            row["delay_s"] = None
    comparisons = [pair._asdict() | {"result": pair.word} for pair in experiment.comparisons]
    return {"claims": [claim._asdict() for claim in experiment.claims], "rows": rows, "equal_chattering": comparisons}
