"""Tuning methods against each other: held-out objective over closed-loop simulations and over time.

All start from the same gains, on the same batches, with the same loss and bounds; each curve is the held-out objective of
the gains that validation calls the best so far. Every closed-loop run counts, those for validation and for the guard too; a
gradient counts as many as it takes the time of, which is measured here. Compilation is measured apart.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.compile.jit import jit
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.scenarios.sample import sample_scenarios
from jaxftc.scenarios.scenario import take, trail
from tuning import transform
from tuning.loop import Progress, fit
from tuning.problem import Problem
from tuning.settings import GRADIENT_COST, Settings
from tuning.terms import OBJECTIVE

HELD_OUT = 512
POINTS = 12  # of a curve that are evaluated on held-out scenarios


class Curve(NamedTuple):
    """One method, one seed."""

    method: str
    seed: int
    simulations: np.ndarray  # [points] closed-loop runs spent
    seconds: np.ndarray  # [points] without compilation, where that could be told
    objective: np.ndarray  # [points] held out
    compile_s: float | None  # None for a method of one round


def measure(
    config: Config, gains: Gains, seeds: int, settings: Settings, factors: dict[str, float], done: Callable[[], object]
) -> tuple[list[Curve], float]:
    """Curves of each seed and method of ``factors``, which scale its budget, and the cost of a gradient in simulations."""
    cost = gradient_cost(config, gains, settings)
    curves = []
    for seed in range(seeds):
        train, validate, noise, draw, unseen = jax.random.split(jax.random.key(seed), 5)
        training = sample_scenarios(train, settings.steps * settings.batch, config=config)
        validation = sample_scenarios(validate, settings.validation, config=config)
        held_out = sample_scenarios(draw, HELD_OUT, config=config)
        judge = Problem(config, OBJECTIVE, unseen, settings.batch)
        before = judge.total(judge.scores(gains, held_out))
        for method in factors:
            chosen = dataclasses.replace(
                settings, method=method, patience=1.0, steps=round(settings.steps * factors[method])
            )
            path: list[tuple[Progress, Gains]] = []
            fit(
                config,
                gains,
                training,
                validation=validation,
                key=noise,
                settings=chosen,
                on_round=lambda progress, best: path.append((progress, best)),  # noqa: B023
            )
            curves.append(_curve(method, seed, path, cost, chosen, lambda g: judge.total(judge.scores(g, held_out)), before))  # noqa: B023
            done()
    return curves, cost


def gradient_cost(config: Config, gains: Gains, settings: Settings) -> float:
    """Time of a gradient of a batch over that of the same batch run forward; both warm, the least of five."""
    problem = Problem(config, OBJECTIVE, jax.random.key(0), settings.batch)
    space = transform.space(config, gains, transform.select(config))
    scenarios = trail(take(sample_scenarios(jax.random.key(1), settings.batch, config=config), slice(None)))
    start = jnp.zeros((len(OBJECTIVE), settings.batch))
    slope = jit(problem.slope(space, settings.mode))
    theta = jnp.zeros(space.size)
    times = []
    for program in (
        lambda: slope(problem.key, theta, jnp.ones(()), scenarios, start),
        lambda: problem.run(gains, scenarios),
    ):
        jax.block_until_ready(program())
        runs = []
        for _ in range(5):
            began = time.perf_counter()
            jax.block_until_ready(program())
            runs.append(time.perf_counter() - began)
        times.append(min(runs))
    return times[0] / times[1]


def _curve(
    method: str,
    seed: int,
    path: list[tuple[Progress, Gains]],
    cost: float,
    settings: Settings,
    judge: Callable[[Gains], float],
    before: float,
) -> Curve:
    """A path as a curve: points spread evenly over the logarithm of simulations, the last one among them."""
    progress = [p for p, _ in path]
    simulations = np.array([p.simulations for p in progress], float)
    if method == "gradient":
        simulations += np.array([p.step for p in progress]) * settings.batch * (cost - GRADIENT_COST)
    seconds = np.array([p.seconds for p in progress])
    rounds = np.diff(seconds, prepend=0.0)
    compiled = max(0.0, float(rounds[0] - np.median(rounds[1:]))) if len(rounds) > 1 else None
    wanted = np.geomspace(simulations[0], simulations[-1], POINTS)
    rows = np.unique(np.searchsorted(simulations, wanted * (1 - 1e-9)))
    objective = [judge(path[row][1]) for row in rows]
    return Curve(
        method,
        seed,
        np.concatenate([[0.0], simulations[rows]]),
        np.concatenate([[0.0], seconds[rows] - (compiled or 0.0)]),
        np.array([before, *objective]),
        compiled,
    )


def reached(curve: Curve, level: float, axis: str = "simulations") -> float:
    """Simulations (or seconds) at which a curve, past its start, is first at or below a level; infinite if never."""
    at = np.flatnonzero(curve.objective[1:] <= level)
    return float(getattr(curve, axis)[1:][at[0]]) if at.size else float("inf")


def _times_fewer(gradient: Curve, other: Curve) -> float | None:
    """How many times fewer simulations the gradient needs for what another method ends at; 0 if it never gets there.

    None where that method is no better than the start: there is nothing to reach.
    """
    if other.objective[-1] >= other.objective[0]:
        return None
    return float(other.simulations[-1] / reached(gradient, other.objective[-1]))


def verdicts(curves: list[Curve]) -> dict[str, Any]:
    """Final objectives by method, and how many times fewer simulations the gradient needs to reach each, seed by seed."""
    by = {(c.method, c.seed): c for c in curves}
    seeds = sorted({c.seed for c in curves})
    found: dict[str, Any] = {}
    for method in dict.fromkeys(c.method for c in curves):
        mine = [by[method, seed] for seed in seeds]
        levels = [c.objective[-1] for c in mine]
        fewer = [_times_fewer(by["gradient", c.seed], c) for c in mine]
        counted = [times for times in fewer if times is not None]
        found[method] = {
            "final_median": float(np.median(levels)),
            "final": levels,
            "simulations": float(np.median([c.simulations[-1] for c in mine])),
            "seconds": float(np.median([c.seconds[-1] for c in mine])),
            "compile_s": mine[0].compile_s,
            "gradient_needs_times_fewer": fewer,
            "gradient_needs_times_fewer_median": float(np.median(counted)) if counted else None,
        }
    return found
