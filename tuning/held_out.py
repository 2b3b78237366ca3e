"""What tuned gains are worth on scenarios that nobody has tuned on: terms before and after, paired by scenario."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxftc.config import Config
from jaxftc.diagnosis import threshold
from jaxftc.evaluation import intervals
from jaxftc.evaluation.intervals import Interval, bootstrap
from jaxftc.gains import Gains
from jaxftc.scenarios.preset import Encoder
from jaxftc.scenarios.preset_file import load_preset
from jaxftc.scenarios.sample import sample_scenarios
from jaxftc.scenarios.scenario import Scenario
from jaxftc.types import Array
from tuning.problem import LOST, Problem
from tuning.terms import OBJECTIVE, Term

FELT = 1e-3  # share of the objective below which a change of one term is none
PRESETS = ("standard", "hard")


class Comparison(NamedTuple):
    """Two sets of gains on the same held-out scenarios."""

    preset: str
    sign: str  # smooth or hard sgn
    names: tuple[str, ...]  # of the terms
    weights: np.ndarray  # [terms]
    before: np.ndarray  # [terms, scenarios]
    after: np.ndarray  # [terms, scenarios]
    scenarios: Scenario  # leading axis
    key: Array  # of the noise

    @property
    def objective(self) -> tuple[float, float]:
        """The objective before and after: weighted sum of the terms' means."""
        return float(self.weights @ self.before.mean(1)), float(self.weights @ self.after.mean(1))

    @property
    def ratio(self) -> Interval:
        """Objective after over before, with a bootstrap interval over scenarios."""
        pairs = np.stack([self.weights @ self.before, self.weights @ self.after])
        return bootstrap(pairs, lambda x: x[1].mean(-1) / x[0].mean(-1))

    @property
    def median(self) -> tuple[Interval, Interval]:
        """Median over scenarios of a scenario's own objective, before and after."""
        before, after = self.weights @ self.before, self.weights @ self.after
        return intervals.median(before), intervals.median(after)

    @property
    def diverged(self) -> tuple[int, int]:
        """Runs that diverged, before and after; they count ``LOST`` in every term."""
        return int((self.before == LOST).all(0).sum()), int((self.after == LOST).all(0).sum())

    def term_ratio(self, name: str) -> Interval:
        """Mean of a term after over before; 1 where it was and is 0."""
        k = self.names.index(name)
        pairs = np.stack([self.before[k], self.after[k]])
        if not pairs.any():
            return Interval(1.0, 1.0, 1.0)
        return bootstrap(pairs, lambda x: x[1].mean(-1) / np.maximum(x[0].mean(-1), 1e-12))

    def word(self, name: str) -> str:
        """Whether a term, or the objective, got better, worse or stayed the same.

        By the 95 % interval of its ratio, and if the objective feels it: by more than ``FELT`` of what it was.
        """
        if name == "objective":
            before, after = self.objective
            ratio, change = self.ratio, after - before
        else:
            k = self.names.index(name)
            ratio, change = self.term_ratio(name), self.weights[k] * (self.after[k].mean() - self.before[k].mean())
        if ratio.low <= 1 <= ratio.high or abs(change) <= FELT * self.objective[0]:
            return "same"
        return "worse" if change > 0 else "better"

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        before, after = self.objective
        terms = {
            name: {"before": float(b.mean()), "after": float(a.mean()), "ratio": self.term_ratio(name)._asdict()}
            for name, b, a in zip(self.names, self.before, self.after, strict=True)
        }
        median = [interval._asdict() for interval in self.median]
        return {
            "before": before,
            "after": after,
            "n": self.before.shape[1],
            "diverged_before": self.diverged[0],
            "diverged_after": self.diverged[1],
            "ratio": self.ratio._asdict(),
            "median_before": median[0],
            "median_after": median[1],
            "terms": terms,
        }


def compare(
    config: Config,
    before: Gains,
    after: Gains,
    key: Array,
    *,
    presets: tuple[str, ...] = PRESETS,
    encoder: Encoder | None = None,
    n: int = 512,
    objective: Mapping[str, Term] = OBJECTIVE,
    batch: int = 64,
) -> list[Comparison]:
    """Both sets of gains on fresh scenarios of each preset: with the smooth sgn, then with the hard one.

    The hard sgn shows how far gains tuned with the smooth one hold.

    Args:
        config: Robot, structure and timing.
        before: One set of gains.
        after: The other.
        key: One that no tuning has seen.
        presets: Names of presets.
        encoder: Of their scenarios, if not the presets' own.
        n: Scenarios of each.
        objective: Terms by name.
        batch: Scenarios side by side.

    Returns:
        A comparison for each sgn and preset.
    """
    draw, noise = jax.random.split(key)
    found = []
    follows = any(threshold.follows(gains.diagnosis) for gains in (before, after))
    for sign in ("smooth", "hard"):
        problem = Problem(dataclasses.replace(config, sign=sign), objective, noise, batch, follows=follows)
        for preset in presets:
            laws = load_preset(preset)
            laws = laws if encoder is None else dataclasses.replace(laws, encoder=encoder)
            scenarios = sample_scenarios(draw, n, laws, config=config)
            scores = [problem.scores(gains, scenarios) for gains in (before, after)]
            found.append(Comparison(preset, sign, problem.names, problem.weights, scores[0], scores[1], scenarios, noise))
    return found
