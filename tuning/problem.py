"""What is minimised: weighted terms of simulated scenarios, as compiled programs over all devices.

The objective is the weighted sum of the terms' means. The loss that every method follows is the objective plus a guard: what
a term is worse by than with the starting gains, on the same scenarios and the same noise, counts ``GUARD`` times on top, so
that no term pays for the others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.closed_loop import simulate
from jaxftc.compile import jit
from jaxftc.config import Config
from jaxftc.faults.scenario import Scenario, take, trail
from jaxftc.gains import Gains
from jaxftc.parallel import devices_for, over_scenarios
from jaxftc.types import Array
from tuning import terms as built_in
from tuning.terms import Run, Term
from tuning.transform import Space

GUARD = 2.0
LOST = 10.0  # what every term of a run that diverged counts
CLIP = 1.0  # largest norm of one scenario's gradient, per unit of theta
DIFFERENCE = 0.02  # step of finite differences in theta


class Problem:
    """The objective of a config, compiled once for runs of ``batch`` scenarios.

    Scenarios have a leading axis, as sampled; the noise of each depends on ``key`` and its id alone, so that any two sets of
    gains are compared run by run.
    """

    def __init__(self, config: Config, objective: Mapping[str, Term], key: Array, batch: int) -> None:
        self.config, self.objective, self.key, self.batch = config, dict(objective), key, batch
        self.names = tuple(self.objective)
        self.weights = np.array([term.weight for term in self.objective.values()], float)
        self.origin = _origin(config, self.objective, batch)
        self.alone = devices_for(batch) > 1  # each device has a core to itself then
        scores = over_scenarios(lambda shared, split: self.terms(shared[0], shared[1], split), batch)
        self._scores = jit(scores, origin=self.origin, alone=self.alone)

    def scores(self, gains: Gains, scenarios: Scenario) -> np.ndarray:
        """Terms [terms, scenarios] of one set of gains, in pieces of ``batch`` scenarios; the last piece is filled up."""
        count = len(scenarios.id)
        pieces = []
        for first in range(0, count, self.batch):
            piece = take(scenarios, np.arange(first, first + self.batch) % count)
            pieces.append(np.asarray(self.run(gains, trail(piece)), float))
        return np.concatenate(pieces, axis=1)[:, :count]

    def run(self, gains: Gains, scenarios: Scenario) -> Array:
        """Terms [terms, batch] of one set of gains, scenarios with a trailing axis; compiled."""
        return self._scores((self.key, gains), scenarios)

    def total(self, scores: np.ndarray) -> float:
        """The objective from terms [terms, scenarios]."""
        return float(self.weights @ scores.mean(1))

    def loss(self, scores: np.ndarray, start: np.ndarray) -> float:
        """Objective and guard, from terms [terms, scenarios] and those of the starting gains on the same scenarios."""
        return float(self.weights @ (scores.mean(1) + GUARD * np.maximum(scores.mean(1) - start.mean(1), 0.0)))

    def terms(self, key: Array, gains: Gains, scenarios: Scenario) -> Array:
        """Terms [terms, B] of scenarios with a trailing axis, traced; gains may carry the same axis.

        A run with a term that is not finite has diverged: it counts ``LOST`` in every term.
        """
        return self._joined(self._alone(gains, scenarios.id.shape), self._simulated(key, gains, scenarios))

    def _alone(self, gains: Gains, axes: tuple[int, ...] = ()) -> Array:
        """The terms of gains alone, [terms, ...]."""
        run = Run(self.config, gains)
        return _rows([term.value(run) for term in self.objective.values() if term.gains_only], axes)

    def _simulated(self, key: Array, gains: Gains, scenarios: Scenario) -> Array:
        """The other terms, [terms, B]."""
        run = Run(self.config, gains, scenarios, simulate(self.config, gains, scenarios, key))
        rows = _rows([term.value(run) for term in self.objective.values() if not term.gains_only], scenarios.id.shape)
        return _sound(rows)

    def _joined(self, alone: Array, simulated: Array) -> Array:
        """All terms [terms, B], in their order."""
        kinds = {True: iter(alone), False: iter(simulated)}
        return _sound(_rows([next(kinds[term.gains_only]) for term in self.objective.values()], simulated.shape[1:]))

    def at(self, space: Space) -> Callable[[Array, Array, Array | float, Scenario], Array]:
        """(key, points [size, B], widen, scenarios) to terms [terms, B], one theta a scenario. To be traced."""
        return self._spread(space, self.terms)

    def _spread(
        self, space: Space, terms: Callable[[Array, Gains, Scenario], Array]
    ) -> Callable[[Array, Array, Array | float, Scenario], Array]:
        """The same for some of the terms."""

        def block(shared: tuple[Array, Array], split: tuple[Array, Scenario]) -> Array:
            (key, widen), (points, scenarios) = shared, split
            return terms(key, space.gains(points, widen), scenarios)

        run = over_scenarios(block, self.batch)
        return lambda key, points, widen, scenarios: run((key, jnp.asarray(widen, points.dtype)), (points, scenarios))

    def slope(self, space: Space, mode: str) -> Callable[[Array, Array, Array, Scenario, Array], tuple[Array, Array]]:
        """(key, theta, widen, scenarios, start terms) to (terms [terms, B], a gradient of the loss a scenario [size, B]).

        To be traced. ``mode`` is how gradients are found: ``reverse``, ``forward`` (a run with tangents for each entry of
        theta: for few gains) or ``finite`` differences; terms of gains alone have theirs in reverse. A gradient that is not
        finite counts as 0, one longer than ``CLIP`` is cut to that: one run that hits a limit must not turn the whole step.
        """
        run = self._spread(space, self._simulated)
        gains_only = np.array([term.gains_only for term in self.objective.values()])

        def copies(vector: Array) -> Array:
            return jnp.broadcast_to(vector[:, None], (vector.size, self.batch))

        def call(key: Array, theta: Array, widen: Array, scenarios: Scenario, start: Array) -> tuple[Array, Array]:
            def at(points: Array) -> Array:
                return run(key, points, widen, scenarios)

            alone, pull_alone = jax.vjp(lambda theta: self._alone(space.gains(theta, widen)), theta)
            simulated, pull = jax.vjp(at, copies(theta)) if mode == "reverse" else (at(copies(theta)), None)
            terms = self._joined(alone, simulated)
            weights = self._pull(terms, start).astype(theta.dtype)
            if pull is not None:
                slopes = pull(jnp.broadcast_to(weights[~gains_only, None], simulated.shape))[0]
            else:
                if mode == "forward":
                    change = lambda d: jax.jvp(at, (copies(theta),), (copies(d),))[1]  # noqa: E731
                else:
                    change = lambda d: (at(copies(theta + DIFFERENCE * d)) - simulated) / DIFFERENCE  # noqa: E731
                changes = jax.lax.map(change, jnp.eye(theta.size, dtype=theta.dtype))
                slopes = jnp.einsum("k,pkb->pb", weights[~gains_only], changes)
            own = pull_alone(weights[gains_only])[0][:, None]
            slopes = jnp.where((terms == LOST).all(0), slopes, slopes + own)
            length = jnp.sqrt((slopes * slopes).sum(0))
            return terms, jnp.where(jnp.isfinite(length), slopes * jnp.minimum(1.0, CLIP / (length + 1e-12)), 0.0)

        return call

    def _pull(self, terms: Array, start: Array) -> Array:
        """Derivative [terms] of the loss by the mean of each term."""
        worse = terms.mean(1) > start.mean(1)
        return jnp.asarray(self.weights, terms.dtype) * (1 + GUARD * worse)


def _origin(config: Config, objective: Mapping[str, Term], batch: int) -> str | None:
    """What a problem's programs are made of; None with a user's own function, which says nothing about its source."""
    if any(getattr(built_in, getattr(term.value, "__name__", ""), None) is not term.value for term in objective.values()):
        return None
    every = [(name, term.weight, term.value.__name__, term.gains_only) for name, term in objective.items()]
    return repr((config, every, batch))


def _rows(values: list[Array], axes: tuple[int, ...]) -> Array:
    """One array [values, *axes]."""
    return jnp.stack([jnp.broadcast_to(value, axes) for value in values]) if values else jnp.zeros((0, *axes))


def _sound(terms: Array) -> Array:
    """``LOST`` in every term of a run that has one that is not finite."""
    return jnp.where(jnp.isfinite(terms).all(0), terms, LOST)
