"""The paper's two rankings with every structure tuned alike: PI, ESO, T-S by fault estimate; SMC, ESMC, AFESMC by tracking.

Each of the five structures is tuned from the default gains with the same budget. Both rankings are then read on held-out
scenarios, scenario by scenario, as the median of the ratio of two errors with its bootstrap interval. The controllers are
compared at equal chattering: each runs with its switching gain scaled over ``SWEEP``, and its error is read off where it
chatters as tuned ESMC does on the same scenario.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxftc.config import CONTROLS, OBSERVERS, Config
from jaxftc.control import fuzzy_gain
from jaxftc.evaluation import metrics
from jaxftc.evaluation.intervals import Interval, median
from jaxftc.gains import Gains
from jaxftc.scenarios.sample import sample_scenarios
from jaxftc.scenarios.scenario import CONDITIONS, Scenario
from jaxftc.schemes.defaults import default_gains
from jaxftc.types import Array
from tuning.loop import fit
from tuning.problem import Problem
from tuning.settings import Settings
from tuning.terms import CHATTERING, OBJECTIVE, TRACKING

SWEEP = np.geomspace(1 / 8, 8, 9)  # factors on the switching gain
SWITCHING = {"smc": "alpha_sm", "esmc": "alpha_sm2", "afesmc": "alpha_sm2"}
STRUCTURES = [(observer, CONTROLS[-1]) for observer in OBSERVERS] + [(OBSERVERS[-1], c) for c in CONTROLS[:-1]]


class Pair(NamedTuple):
    """Two neighbours of a ranking in one condition."""

    ranking: str  # torque estimate, encoder estimate or tracking
    condition: str
    before: str
    after: str
    n: int  # scenarios
    ratio: Interval  # median over scenarios of error after over error before
    louder: float  # share of scenarios in which one of the two cannot be made to chatter alike; 0 for estimates

    @property
    def word(self) -> str:
        """What became of the error."""
        return "falls" if self.ratio.high < 1 else "rises" if self.ratio.low > 1 else "tie"


class Surface(NamedTuple):
    """What tuning made of Table 1."""

    lowest: float
    highest: float
    by_q: float  # share of the variance over the map that joint position explains alone
    by_s: float  # and the sliding surface


def measure(
    config: Config, seed: int, n: int, settings: Settings, done: Callable[[], object]
) -> tuple[list[Pair], dict[str, Any]]:
    """Both rankings, and notes: held-out objective of each structure, Table 1's surface."""
    train, validate, noise, draw, unseen = jax.random.split(jax.random.key(seed), 5)
    training = sample_scenarios(train, settings.steps * settings.batch, config=config)
    validation = sample_scenarios(validate, settings.validation, config=config)
    held_out = sample_scenarios(draw, n, config=config)
    tuned: dict[tuple[str, str], Gains] = {}
    scores: dict[tuple[str, str], dict[str, np.ndarray]] = {}
    notes: dict[str, Any] = {}
    for structure in STRUCTURES:
        variant = _variant(config, *structure)
        start = default_gains(variant)
        result = fit(variant, start, training, validation=validation, key=noise, settings=settings)
        tuned[structure] = result.gains
        problem = Problem(variant, OBJECTIVE, unseen, settings.batch)
        values = problem.scores(result.gains, held_out)
        scores[structure] = dict(zip(problem.names, values, strict=True))
        before = problem.total(problem.scores(start, held_out))
        notes["-".join(structure)] = {"held_out_before": before, "held_out_after": problem.total(values)}
        done()
    pairs = list(_estimates(scores, _conditions(held_out)))
    curves = {}
    for control in CONTROLS:
        structure = (OBSERVERS[-1], control)
        curves[control] = _curves(_variant(config, *structure), tuned[structure], held_out, unseen, settings.batch)
        done()
    pairs += list(_tracking(curves, _conditions(held_out)))
    last = OBSERVERS[-1], CONTROLS[-1]
    notes["surface_default"] = surface(config, default_gains(config))._asdict()
    notes["surface_tuned"] = surface(config, tuned[last])._asdict()
    return pairs, notes


def _variant(config: Config, observer: str, control: str) -> Config:
    return dataclasses.replace(config, observer=observer, control=control)  # pyright: ignore[reportArgumentType]


def _conditions(scenarios: Scenario) -> np.ndarray:
    """Index into CONDITIONS of each scenario."""
    tau, q = (np.asarray(fault.kind).max(1) > 0 for fault in (scenarios.fault_tau, scenarios.fault_q))
    return tau + 2 * q


def _error(share: np.ndarray) -> np.ndarray:
    """An error over its tolerance from the share x / (1 + x) that is its term; a run that diverged has a huge one."""
    share = np.minimum(share, 1 - 1e-6)
    return share / (1 - share)


def _estimates(scores: dict[tuple[str, str], dict[str, np.ndarray]], conditions: np.ndarray) -> Iterator[Pair]:
    for term, name, faulty in (("fault_tau", "torque estimate", (1, 3)), ("fault_q", "encoder estimate", (2, 3))):
        for before, after in pairwise(OBSERVERS):
            errors = [_error(scores[observer, CONTROLS[-1]][term]) for observer in (before, after)]
            for c in faulty:
                where = conditions == c
                yield _pair(name, c, before, after, errors[0][where], errors[1][where], 0.0)


def _curves(config: Config, gains: Gains, scenarios: Scenario, key: Array, batch: int) -> np.ndarray:
    """(chattering 1/s, tracking deg) [2, factors, scenarios] with the switching gain scaled over SWEEP."""
    objective = {name: OBJECTIVE[name] for name in ("chattering", "tracking")}
    problem = Problem(config, objective, key, batch)
    name = SWITCHING[config.control]
    curves = []
    for factor in SWEEP:
        scaled = gains.replace({f"control.{name}": factor * getattr(gains.control, name)})
        curves.append(_error(problem.scores(scaled, scenarios)))
    return np.stack(curves, axis=1) * np.array([CHATTERING, np.rad2deg(TRACKING)])[:, None, None]


def _tracking(curves: dict[str, np.ndarray], conditions: np.ndarray) -> Iterator[Pair]:
    level = curves["esmc"][0, len(SWEEP) // 2]  # [scenarios], tuned ESMC as it is
    read = {
        control: np.array([metrics.at_level(curve[:, :, k], level[k]) for k in range(len(level))])
        for control, curve in curves.items()
    }
    for before, after in pairwise(CONTROLS):
        unlike = np.abs(np.log(read[before][:, 0] / read[after][:, 0])) > 0.02
        for c in range(len(CONDITIONS)):
            where = conditions == c
            yield _pair(
                "tracking", c, before, after, read[before][where, 1], read[after][where, 1], float(unlike[where].mean())
            )


def _pair(ranking: str, condition: int, before: str, after: str, was: np.ndarray, now: np.ndarray, louder: float) -> Pair:
    ratio = Interval(*np.exp(median(np.log(now / was))))
    return Pair(ranking, CONDITIONS[condition], before, after, len(was), ratio, louder)


def surface(config: Config, gains: Gains) -> Surface:
    """alpha_online over the ranges of Table 1: its span, and how much of it each input explains."""
    q, s = np.meshgrid(np.deg2rad(np.linspace(-100, 100, 41)), np.linspace(-1, 1, 41))
    value = fuzzy_gain.surface(config, gains, q, s)
    spread = max(value.var(), 1e-12)
    return Surface(
        float(value.min()), float(value.max()), float(value.mean(0).var() / spread), float(value.mean(1).var() / spread)
    )
