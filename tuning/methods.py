"""The methods behind one contract: rounds of gradient steps, of finite differences, or of a search.

All follow the same loss from the same start, within the same bounds, on the same batches in the same order.
"""

from __future__ import annotations

from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.compile.jit import jit
from jaxftc.gains import Gains
from jaxftc.scenarios.scenario import Scenario, take, trail
from tuning import search, transform
from tuning.descent import Descent
from tuning.problem import Problem
from tuning.settings import GRADIENT_COST, ROUND, Settings, round_length

TANGENT_COST = 2  # closed-loop simulations that a run with one tangent counts as
SLOWER = 0.3  # factor on the learning rate with each recovery


def make(problem: Problem, space: transform.Space, training: Scenario, settings: Settings) -> Method:
    """The method that the settings name, at the start."""
    batches = Batches(problem, space.start, training)
    if settings.method in ("gradient", "finite"):
        return _Descend(problem, space, batches, settings)
    return _Sample(problem, space, batches, settings)


class Method(Protocol):
    """What the loop needs of a method. Its state is arrays, so that a checkpoint holds all of it."""

    rounds: int
    steps: int  # in a round
    cost: int  # simulations of a round

    @property
    def theta(self) -> np.ndarray:
        """Its answer so far, [size]."""
        ...

    def round(self, index: int) -> tuple[np.ndarray, float]:
        """Do a round: (means of the terms on the last batch, norm of the gradient, nan without one)."""
        ...

    def pack(self) -> dict[str, np.ndarray]:
        """Its state between rounds."""
        ...

    def unpack(self, arrays: dict[str, np.ndarray]) -> None:
        """Take a state back."""
        ...

    def restart(self, theta: np.ndarray) -> bool:
        """Go on from theta, more carefully; False where that means nothing to the method."""
        ...


class Batches:
    """Training scenarios dealt out in batches: all in turn, shuffled anew each time they are used up."""

    def __init__(self, problem: Problem, start: Gains, scenarios: Scenario) -> None:
        self.problem, self.start, self.scenarios = problem, start, scenarios

    def rows(self, step: int) -> np.ndarray:
        """Scenarios [batch] of a step; the same whenever it is asked for."""
        count, batch = len(self.scenarios.id), self.problem.batch
        places = np.arange(step * batch, (step + 1) * batch)
        rows = np.empty(batch, int)
        for epoch in np.unique(places // count):
            order = np.arange(count) if epoch == 0 else np.random.default_rng(epoch).permutation(count)
            rows[places // count == epoch] = order[places[places // count == epoch] % count]
        return rows

    def take(self, step: int, widen: float) -> tuple[Scenario, np.ndarray]:
        """Scenarios [batch, ...] of a step, and the terms [terms, batch] of the starting gains with signs as wide."""
        chosen = take(self.scenarios, self.rows(step))
        return chosen, self.problem.scores(transform.widened(self.start, widen), chosen)


class _Descend:
    """Gradient and finite differences."""

    def __init__(self, problem: Problem, space: transform.Space, batches: Batches, settings: Settings) -> None:
        finite = settings.method == "finite"
        runs = GRADIENT_COST if settings.mode == "reverse" else 1 + TANGENT_COST * space.size
        step_cost = settings.batch * (1 + space.size if finite else runs)
        total = max(1, settings.budget // step_cost) if finite else settings.steps
        self.steps = round_length(total)
        self.rounds, self.cost = total // self.steps, self.steps * (step_cost + settings.batch)
        self.batches, self.settings, self.total, self.size = batches, settings, total, space.size
        self.descent = Descent(
            problem,
            space,
            mode="finite" if finite else settings.mode,
            optimizer=settings.optimizer,
            rate=settings.learning_rate,
            steps=total,
        )
        self.state = self.descent.init(np.zeros(space.size))

    @property
    def theta(self) -> np.ndarray:
        return np.asarray(self.state.theta)[: self.size]

    def round(self, index: int) -> tuple[np.ndarray, float]:
        steps = range(index * self.steps, (index + 1) * self.steps)
        widen = np.array([self.settings.widen(k / max(self.total - 1, 1)) for k in steps])
        taken = [self.batches.take(step, float(wide)) for step, wide in zip(steps, widen, strict=True)]
        scenarios = jax.tree.map(lambda *leaves: np.stack(leaves), *(trail(chosen) for chosen, _ in taken))
        start = np.stack([terms for _, terms in taken])
        self.state, info = self.descent.round(self.state, widen, scenarios, start)
        return np.asarray(info.terms[-1], float), float(info.gradient_norm[-1])

    def pack(self) -> dict[str, np.ndarray]:
        return {f"leaf{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(self.state))}

    def unpack(self, arrays: dict[str, np.ndarray]) -> None:
        tree = jax.tree.structure(self.state)
        self.state = jax.tree.unflatten(tree, [arrays[f"leaf{i}"] for i in range(tree.num_leaves)])

    def restart(self, theta: np.ndarray) -> bool:
        self.state = self.descent.init(theta, int(self.state.step), SLOWER * float(self.state.rate))
        return True


class _Sample:
    """CMA-ES and random search; a step is a generation, a round costs what one of the gradient's would."""

    def __init__(self, problem: Problem, space: transform.Space, batches: Batches, settings: Settings) -> None:
        kind = search.Evolution if settings.method == "cmaes" else search.Random
        self.search = kind(space.size, seed=int(np.asarray(jax.random.key_data(problem.key)).ravel()[-1]))
        generation = self.search.population * settings.batch
        total = max(1, settings.budget // generation)
        self.steps = min(total, max(1, ROUND * settings.batch * GRADIENT_COST // generation))
        self.rounds = total // self.steps
        self.cost = self.steps * (generation + settings.batch)
        self.batches, self.problem, self.settings = batches, problem, settings
        self.gains = jit(lambda theta: space.gains(theta, settings.anneal[1]))

    @property
    def theta(self) -> np.ndarray:
        return self.search.theta

    def round(self, index: int) -> tuple[np.ndarray, float]:
        """Some generations: means of the terms of the last one's best candidate, and no norm of a gradient."""
        means, losses = np.zeros((0, 0)), np.zeros(0)
        for step in range(index * self.steps, (index + 1) * self.steps):
            scenarios, start = self.batches.take(step, self.settings.anneal[1])
            scores = []

            def judge(theta: np.ndarray) -> float:
                scores.append(self.problem.scores(self.gains(jnp.asarray(theta, float)), scenarios))  # noqa: B023
                return self.problem.loss(scores[-1], start)  # noqa: B023

            losses = self.search.generation(judge)
            means = np.stack([score.mean(1) for score in scores])
        return means[int(np.argmin(losses))], float("nan")

    def pack(self) -> dict[str, np.ndarray]:
        return {"told": self.search.told}

    def unpack(self, arrays: dict[str, np.ndarray]) -> None:
        self.search.replay(arrays["told"])

    def restart(self, theta: np.ndarray) -> bool:
        """Nothing to undo: a candidate that is worse is not followed."""
        return False
