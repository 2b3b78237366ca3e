"""The paper's experiment: four conditions, three observers, three controllers, and what became of each claim.

One set of gains serves every run. The three controllers are compared at equal chattering: each runs with its switching gain
scaled over ``SWEEP``, and its tracking error is read off where it chatters as much as ESMC does with the gains as given.
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
from jaxftc.config import CONTROLS, OBSERVERS, Config
from jaxftc.faults.scenario import CONDITIONS, PAPER_WINDOW, Scenario, paper_scenario, stack, trail
from jaxftc.gains import Gains
from jaxftc.types import ACTUATOR, BOTH, NORMAL, SENSOR

SWEEP = np.geomspace(1 / 8, 8, 13)  # factors on the switching gain; the middle one is 1
BASE = len(SWEEP) // 2
TIE = 0.02  # relative difference below which two errors are called equal
WANTED = {"healthy": NORMAL, "actuator": ACTUATOR, "sensor": SENSOR, "both": BOTH}
ARX_CLAIM_DEG = 0.05


class Row(NamedTuple):
    """One condition with one observer and one controller."""

    condition: str
    observer: str
    controller: str
    fault_tau_rms_nm: float
    fault_q_rms_deg: float
    delay_s: float | None
    isolated: bool
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


class Experiment(NamedTuple):
    """Everything that the table, the claims and the report need."""

    rows: list[Row]
    claims: list[Claim]
    equal_chattering: dict[str, dict[str, tuple[float, float]]]  # condition -> controller -> (chattering, tracking deg)
    traces: dict[tuple[str, str], list[dict[str, np.ndarray]]]  # (observer, controller) -> columns by condition
    arx: identify.Errors


def run(config: Config, gains: Gains, key: jax.Array, on_done: Callable[[], object] = lambda: None) -> Experiment:
    """Run the whole experiment; ``on_done`` is called after each of the nine pairs of observer and controller."""
    pairs = [(observer, control) for observer in OBSERVERS for control in CONTROLS]

    def one(pair: tuple[str, str]) -> Trace:
        observer, control = pair
        variant = dataclasses.replace(config, observer=observer, control=control)  # pyright: ignore[reportArgumentType]
        batch, swept = _batch(variant, gains, sweep=observer == OBSERVERS[-1])
        trace = jax.block_until_ready(simulate(variant, swept, batch, key))
        on_done()
        return trace

    with ThreadPoolExecutor(2) as pool:  # XLA compiles outside the interpreter lock
        traces = dict(zip(pairs, pool.map(one, pairs), strict=True))
    by_condition = {pair: [_pick(pair, trace, c) for c in range(len(CONDITIONS))] for pair, trace in traces.items()}
    rows = [
        Row(condition, *pair, *_metrics(config, by_condition[pair][c], condition))
        for c, condition in enumerate(CONDITIONS)
        for pair in pairs
    ]
    equal = _equal_chattering(config, {control: traces[OBSERVERS[-1], control] for control in CONTROLS})
    last = OBSERVERS[-1], CONTROLS[-1]
    arx = _arx_errors(config, gains, by_condition[last][0], metrics.columns(traces[last], 0))
    verdicts = {condition: run_["verdict"] for condition, run_ in zip(CONDITIONS, by_condition[last], strict=True)}
    return Experiment(rows, list(_claims(config, rows, equal, verdicts, arx)), equal, by_condition, arx)


def _batch(config: Config, gains: Gains, *, sweep: bool) -> tuple[Scenario, Gains]:
    """The four conditions on a trailing axis; with a sweep, once for each factor on the switching gain (factor slowest).

    Ids, and with them the noise, differ between factors; at factor 1 they are those of the runs without a sweep.
    """
    four = trail(stack([paper_scenario(condition, config, scenario_id=c) for c, condition in enumerate(CONDITIONS)]))
    if not sweep:
        return four, gains
    repeated = jax.tree.map(lambda leaf: jnp.concatenate([leaf] * len(SWEEP), axis=-1), four)
    runs = len(SWEEP) * len(CONDITIONS)
    repeated = repeated._replace(id=(jnp.arange(runs, dtype=jnp.int32) - BASE * len(CONDITIONS)) % runs)
    factor = jnp.repeat(jnp.asarray(SWEEP, gains.control.alpha_sm.dtype), len(CONDITIONS))
    control = dataclasses.replace(
        gains.control,
        alpha_sm=gains.control.alpha_sm[:, None] * factor,
        alpha_sm2=gains.control.alpha_sm2[:, None] * factor,
    )
    return repeated, dataclasses.replace(gains, control=control)


def _pick(pair: tuple[str, str], trace: Trace, condition: int) -> dict[str, np.ndarray]:
    """Columns of one condition with the gains as given."""
    return metrics.columns(trace, condition + (len(CONDITIONS) * BASE if pair[0] == OBSERVERS[-1] else 0))


def _metrics(config: Config, columns: dict[str, np.ndarray], condition: str) -> metrics.Metrics:
    return metrics.evaluate(config, columns, np.full(config.n, WANTED[condition]), PAPER_WINDOW[0])


def _arx_errors(config: Config, gains: Gains, learn: dict[str, np.ndarray], judge: dict[str, np.ndarray]) -> identify.Errors:
    """Errors, on one healthy run, of the model identified from another: same motion, other noise and another gain."""
    log, other = (identify.Log(q=run_["y"], tau=run_["tau"]) for run_ in (learn, judge))
    return identify.errors(config, identify.fit_multistep(config, gains, log, horizon=len(log.q)), other)


def _equal_chattering(config: Config, traces: dict[str, Trace]) -> dict[str, dict[str, tuple[float, float]]]:
    """(chattering, tracking rms deg) of each controller where it chatters like ESMC; its calmest run if it never does."""
    table: dict[str, dict[str, tuple[float, float]]] = {}
    for c, condition in enumerate(CONDITIONS):
        curves = {}
        for control, trace in traces.items():
            runs = [metrics.columns(trace, c + len(CONDITIONS) * f) for f in range(len(SWEEP))]
            merits = [_metrics(config, run_, condition) for run_ in runs]
            curves[control] = np.array([[m.chattering, m.tracking_rms_deg] for m in merits])
        level = curves["esmc"][BASE, 0]
        table[condition] = {control: _at_level(curve, level) for control, curve in curves.items()}
    return table


def _at_level(curve: np.ndarray, level: float) -> tuple[float, float]:
    """Tracking at a chattering level from (chattering, tracking) pairs, log-log between them, the calmest end kept below."""
    ordered = np.log(curve[np.argsort(curve[:, 0])])
    reached = np.clip(np.log(level), ordered[0, 0], ordered[-1, 0])
    return float(np.exp(reached)), float(np.exp(np.interp(reached, ordered[:, 0], ordered[:, 1])))


def _claims(
    config: Config,
    rows: list[Row],
    equal: dict[str, dict[str, tuple[float, float]]],
    verdicts: dict[str, np.ndarray],
    arx: identify.Errors,
) -> Iterator[Claim]:
    best = {row.condition: row for row in rows if (row.observer, row.controller) == (OBSERVERS[-1], CONTROLS[-1])}
    sizes = (arx.free_run, arx.one_step, arx.fifty_step, arx.extrapolator_one_step, arx.extrapolator_fifty_step)
    worst, *others = (float(np.rad2deg(size.max.max())) for size in sizes)
    one, fifty, line_one, line_fifty = (f"{value:.3f}" for value in others)
    detail = (
        f"largest, model running alone over the whole motion, on a run it was not identified from; 1 and 50 steps ahead "
        f"{one} and {fifty} deg, where a straight line through two readings is off by {line_one} and {line_fifty} deg"
    )
    yield Claim("arx_healthy", "healthy ARX-Laguerre error below 0.05 deg", worst, "deg", worst < ARX_CLAIM_DEG, detail)
    for condition in CONDITIONS[1:]:
        _, _, scored = metrics.detection(config, verdicts[condition], np.full(config.n, WANTED[condition]), PAPER_WINDOW[0])
        right = int((scored == WANTED[condition]).sum())
        delay = best[condition].delay_s
        yield Claim(
            f"detect_{condition}",
            f"{condition} fault detected and told apart on all joints",
            float(right),
            f"joints of {config.n}",
            right == config.n,
            f"first alarm after {delay * 1e3:.0f} ms" if delay is not None and np.isfinite(delay) else "no alarm",
        )
    for channel, name, unit in (("fault_tau_rms_nm", "torque", "N m"), ("fault_q_rms_deg", "encoder", "deg")):
        yield _estimation(rows, channel, name, unit)
    for condition in CONDITIONS[1:]:
        yield from _tracking(condition, equal[condition])


def _estimation(rows: list[Row], channel: str, name: str, unit: str) -> Claim:
    """Fault-estimate error from PI to ESO to T-S, mean over the three faulty conditions."""
    errors = [
        float(
            np.mean(
                [
                    getattr(r, channel)
                    for r in rows
                    if r.observer == observer and r.controller == CONTROLS[-1] and r.condition != "healthy"
                ]
            )
        )
        for observer in OBSERVERS
    ]
    falls = all(after < (1 - TIE) * before for before, after in pairwise(errors))
    listing = " > ".join(f"{e:.4g}" for e in errors)
    return Claim(
        f"estimation_{name}",
        f"{name}-fault estimation error falls from PI to ESO to T-S",
        errors[-1],
        unit,
        falls,
        f"PI, ESO, T-S: {listing} {unit}, mean over the faulty conditions{_tie(errors)}",
    )


def _tracking(condition: str, at: dict[str, tuple[float, float]]) -> Iterator[Claim]:
    for before, after in (("smc", "esmc"), ("esmc", "afesmc")):
        errors = [at[before][1], at[after][1]]
        louder = at[before][0] > (1 + TIE) * at[after][0]
        note = f"; {before.upper()} chatters more than that at its calmest" if louder else ""
        yield Claim(
            f"tracking_{condition}_{before}_{after}",
            f"{condition}: tracking error falls from {before.upper()} to {after.upper()} at equal chattering",
            errors[1],
            "deg",
            errors[1] < (1 - TIE) * errors[0],
            f"{errors[0]:.4g} to {errors[1]:.4g} deg at {at[after][0]:.2f} 1/s{_tie(errors)}{note}",
        )


def _tie(errors: list[float]) -> str:
    """Says which neighbours are within the tie band."""
    tied = [i for i in range(len(errors) - 1) if abs(errors[i + 1] - errors[i]) <= TIE * errors[i]]
    return (
        ", a tie" + ("" if len(errors) == 2 else f" between {' and '.join(('PI/ESO', 'ESO/T-S')[i] for i in tied)}")
        if tied
        else ""
    )


def as_json(experiment: Experiment) -> dict[str, Any]:
    """The machine-readable result; an infinite delay (a miss) becomes null with isolated false."""
    rows = [row._asdict() for row in experiment.rows]
    for row in rows:
        if row["delay_s"] is not None and not np.isfinite(row["delay_s"]):
            row["delay_s"] = None
    equal = {
        condition: {control: {"chattering": level, "tracking_rms_deg": error} for control, (level, error) in at.items()}
        for condition, at in experiment.equal_chattering.items()
    }
    return {"claims": [claim._asdict() for claim in experiment.claims], "rows": rows, "equal_chattering": equal}
