"""``fit``: gains for a batch of scenarios. One loop for every method: a round, a validation, a checkpoint.

The best gains on the validation scenarios are the answer; gains beyond a limit on a term are never the best. A
round after which the loss has run away is undone: back to the best gains, with a lower rate; what happened is kept
in ``Result.events``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from jaxftc.compile import processes
from jaxftc.config import Config
from jaxftc.diagnosis import threshold
from jaxftc.gains import Gains
from jaxftc.scenarios.scenario import Scenario, take
from jaxftc.simulation.closed_loop import check as check_scenario
from jaxftc.types import Array
from tuning import checkpoint, methods, transform
from tuning.problem import LOST, Problem
from tuning.settings import Settings
from tuning.terms import OBJECTIVE, Term, check_terms

RUNAWAY = 2.0  # times the starting loss
RECOVERIES = 3


class Progress(NamedTuple):
    """Where a run stands after a round."""

    step: int  # steps (or generations) done
    steps: int  # that there can be
    simulations: int  # closed-loop simulations spent, validation included
    seconds: float
    loss: float  # on the last batch, of the objective without guard
    gradient_norm: float  # per scenario clipped; nan for a method without one
    validation: float  # loss on the validation scenarios, guard included
    best: float  # the lowest of those of gains within the limits; infinite before there are any


class Result(NamedTuple):
    """What came of a run.

    Attributes:
        gains: The best on the validation scenarios.
        best_step: Step after which they were found.
        history: A row a round: the fields of Progress, and ``term_<name>`` on the last batch.
        events: Recoveries.
        stopped: Why it ended.
        simulations: Closed-loop runs, a gradient counted as ``GRADIENT_COST``.
        seconds: Wall time.
        steps: Steps that were made.
        validation: Mean of each term there, with the starting gains and with the gains.
        limits: Largest mean of a term there that was allowed.
    """

    gains: Gains
    best_step: int
    history: dict[str, np.ndarray]
    events: list[str]
    stopped: str
    simulations: int
    seconds: float
    steps: int
    validation: dict[str, tuple[float, float]]
    limits: dict[str, float]

    @property
    def within_limits(self) -> bool:
        """Whether the gains keep the limits: False only for starting gains, where none were found that do."""
        return all(self.validation[name][1] <= limit for name, limit in self.limits.items())


def fit(
    config: Config,
    gains: Gains,
    scenarios: Scenario,
    *,
    key: Array,
    validation: Scenario | None = None,
    objective: Mapping[str, Term] = OBJECTIVE,
    limits: Mapping[str, float] = MappingProxyType({}),
    only: Iterable[str] = (),
    freeze: Iterable[str] = (),
    shared: Iterable[str] = (),
    settings: Settings = Settings(),  # noqa: B008 (frozen)
    folder: Path | None = None,
    on_round: Callable[[Progress, Gains], object] = lambda progress, best: None,
) -> Result:
    """Tune gains over batches of scenarios, through the closed loop.

    ``only``, ``freeze`` and ``shared`` name gains (``observer.alpha_i``) or blocks (``control``).

    Args:
        config: Robot, structure and timing.
        gains: To start from.
        scenarios: To tune on, with a leading axis, as ``jaxftc.sample_scenarios`` gives them.
        key: Of the encoder noise and the choice of batches.
        validation: Scenarios to choose the best gains on; a quarter of ``scenarios`` if None.
        objective: Terms by name; their weighted mean is what is made smaller.
        limits: Largest means of terms on the validation scenarios. Gains beyond one are never
            chosen; where none are found that keep all, the start is the answer
            (``Result.within_limits``).
        only: What is tuned; if empty all that the config uses but the poles and what torque
            thresholds follow.
        freeze: What of it is not.
        shared: What moves on all joints alike.
        settings: How to search.
        folder: Where a checkpoint is written after every round. A run that finds one goes on from
            it, to the same gains bit for bit. Of several processes (``jax.distributed``) that of
            the first counts.
        on_round: Called after every round with where it stands and the best gains so far.

    Returns:
        The best gains and how they were found.

    Raises:
        ValueError: an unknown or unused gain, a limit on an unknown term, nothing to tune, no or too few scenarios, start
            gains that are not allowed or with which every run diverges, an objective without terms, or a checkpoint of
            another run.
    """
    settings.check()
    space = transform.space(config, gains, transform.select(config, only, freeze), shared)
    training, validation = _split(config, gains, scenarios, validation, settings)
    if not objective:
        raise ValueError("the objective has no terms; give at least one, or tuning.OBJECTIVE")
    follows = threshold.follows(gains.diagnosis) or not set(space.names).isdisjoint(threshold.GAINS)
    problem = Problem(config, objective, key, settings.batch, follows=follows)
    check_terms("limit", objective, limits)
    run = _Run(problem, space, training, validation, settings, limits)
    path = None if folder is None or not processes.first() else folder / checkpoint.NAME
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
    run.resume_from(path)
    while not run.stopped:
        progress = run.round()
        on_round(progress, run.best_gains)
        if path is not None:
            checkpoint.write(path, run.identity, run.pack())
    return run.result()


def _split(
    config: Config, gains: Gains, scenarios: Scenario, validation: Scenario | None, settings: Settings
) -> tuple[Scenario, Scenario]:
    """(training, validation), as NumPy arrays."""
    for name, part in (("scenarios", scenarios), ("validation", validation)):
        if part is not None and (np.ndim(part.id) != 1 or not len(part.id)):
            raise ValueError(
                f"{name} must be a set of at least one with a leading axis, got ids of shape {list(np.shape(part.id))}; "
                "draw them with jaxftc.sample_scenarios"
            )
    scenarios = take(scenarios, slice(None))
    if validation is None:
        count = min(settings.validation, len(scenarios.id) // 4)
        if not count:
            raise ValueError(f"{len(scenarios.id)} scenarios are too few to keep some back for validation; give at least 4")
        kept = take(scenarios, slice(-count, None))
        scenarios = take(scenarios, slice(-count))
    else:
        kept = take(validation, slice(None))
        kept = kept._replace(id=kept.id + 1 + scenarios.id.max() - kept.id.min())  # no noise of a training scenario
    for part in (scenarios, kept):
        check_scenario(config, gains, part)
    return scenarios, kept


class _Run:
    """The loop's state between rounds."""

    def __init__(
        self,
        problem: Problem,
        space: transform.Space,
        training: Scenario,
        validation: Scenario,
        settings: Settings,
        limits: Mapping[str, float],
    ) -> None:
        self.limits = dict(limits)
        self.problem, self.space, self.validation, self.settings = problem, space, validation, settings
        self.identity = checkpoint.identity(problem, space, training, validation, settings, limits)
        self.began = time.monotonic()
        self.before = problem.scores(space.start, validation)
        if (self.before == LOST).all():
            raise ValueError("every run diverges with the starting gains; start from other gains or smaller faults")
        self.method = methods.make(problem, space, training, settings)
        self.start_loss = problem.loss(self.before, self.before)
        self.best_means = self.before.mean(1)
        self.best = self.start_loss if self._within(self.best_means) else float("inf")
        self.best_theta, self.best_step = np.zeros(space.size), 0
        self.index, self.stale, self.recoveries = 0, 0, 0
        self.rows: list[list[float]] = []
        self.events: list[str] = []
        self.stopped = ""

    def round(self) -> Progress:
        """One round, its validation and what follows from it."""
        terms, norm = self.method.round(self.index)
        self.index += 1
        step = self.index * self.method.steps
        theta = self.method.theta
        scores = self.problem.scores(self.space.deploy(theta, self.settings.anneal[1]), self.validation)
        loss = self.problem.loss(scores, self.before)
        if loss < self.best and self._within(scores.mean(1)):
            self.best, self.best_theta, self.best_step, self.stale, self.recoveries = loss, theta, step, 0, 0
            self.best_means = scores.mean(1)
        else:
            self.stale += 1
        progress = Progress(
            step,
            self.method.rounds * self.method.steps,
            self.index * (self.method.cost + len(self.validation.id)) + len(self.validation.id),
            time.monotonic() - self.began,
            float(self.problem.weights @ terms),
            norm,
            loss,
            self.best,
        )
        self.rows.append([*progress, *terms])
        if loss > RUNAWAY * self.start_loss and self.method.restart(self.best_theta):
            self._recovered(step, loss, scores)
        elif self.stale > self.settings.patience * self.method.rounds:
            self.stopped = f"no better validation in {self.stale * self.method.steps} steps"
        if self.index == self.method.rounds and not self.stopped:
            self.stopped = "all steps done"
        return progress

    def _within(self, means: np.ndarray) -> bool:
        """Whether means of the terms [terms] keep the limits."""
        return all(means[self.problem.names.index(name)] <= limit for name, limit in self.limits.items())

    def _recovered(self, step: int, loss: float, scores: np.ndarray) -> None:
        """Note which term of scores [terms, scenarios] ran away; after too many times, stop."""
        worst = int(np.argmax(self.problem.weights * (scores.mean(1) - self.before.mean(1))))
        what = f"{self.problem.names[worst]} rose from {self.before[worst].mean():.3g} to {scores[worst].mean():.3g}"
        self.recoveries += 1
        self.events.append(
            f"step {step}: the loss ran away to {loss:.3g} ({what}); back to the gains of step {self.best_step}"
        )
        if self.recoveries > RECOVERIES:
            self.stopped = f"the loss ran away {self.recoveries} times, last because {what}; lower learning_rate"

    @property
    def best_gains(self) -> Gains:
        """The gains with the lowest validation loss so far; the start if none was lower."""
        return self.space.deploy(self.best_theta, self.settings.anneal[1] if self.best_step else 1.0)

    def result(self) -> Result:
        """The best gains, and how they were found."""
        columns = [*Progress._fields, *(f"term_{name}" for name in self.problem.names)]
        table = np.array(self.rows).reshape(-1, len(columns))
        history = dict(zip(columns, table.T, strict=True))
        return Result(
            gains=self.best_gains,
            best_step=self.best_step,
            history=history,
            events=self.events,
            stopped=self.stopped,
            simulations=int(history["simulations"][-1]),
            seconds=float(history["seconds"][-1]),
            steps=int(history["step"][-1]),
            validation={
                name: (float(before), float(after))
                for name, before, after in zip(self.problem.names, self.before.mean(1), self.best_means, strict=True)
            },
            limits=self.limits,
        )

    def pack(self) -> dict[str, Any]:
        """Everything that the next round needs, as arrays and texts."""
        return {
            **{f"method_{name}": value for name, value in self.method.pack().items()},
            "best_theta": self.best_theta,
            "best_means": self.best_means,
            "numbers": np.array([self.best, self.best_step, self.index, self.stale, self.recoveries]),
            "rows": np.array(self.rows),
            "texts": np.array([self.stopped, *self.events]),
        }

    def resume_from(self, path: Path | None) -> None:
        """Take over the state of an earlier run, if there is one; its time counts on."""
        arrays = checkpoint.read(path, self.identity)
        if arrays is None:
            return
        self.method.unpack({name[7:]: value for name, value in arrays.items() if name.startswith("method_")})
        self.best_theta, self.best_means = arrays["best_theta"], arrays["best_means"]
        self.best, *counts = arrays["numbers"].tolist()
        self.best_step, self.index, self.stale, self.recoveries = map(int, counts)
        self.rows = arrays["rows"].tolist()
        self.stopped, *self.events = arrays["texts"].tolist()
        self.began -= self.rows[-1][Progress._fields.index("seconds")]
