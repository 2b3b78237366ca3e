"""What is minimised: weighted terms of simulated scenarios, as compiled programs over all devices.

The objective is the weighted sum of the terms' means. The loss that every method follows is the objective plus a guard: what
a term is worse by than with the starting gains, on the same scenarios and the same noise, counts ``GUARD`` times on top, so
that no term pays for the others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc import stages
from jaxftc.compile.devices import everywhere, over_scenarios
from jaxftc.compile.jit import jit
from jaxftc.compile.xla import Kind
from jaxftc.config import Config
from jaxftc.diagnosis import threshold
from jaxftc.gains import Gains
from jaxftc.scenarios.scenario import Scenario, take, trail
from jaxftc.simulation.closed_loop import program_kind, run_loop
from jaxftc.stages import Stages
from jaxftc.types import Array
from jaxftc.variants import SCHEMES
from tuning import terms as built_in
from tuning.terms import Run, Term
from tuning.transform import Free, Layout, Space, gains_of, gather, spread

GUARD = 2.0
LOST = 10.0  # what every term of a run that diverged counts
CLIP = 1.0  # largest norm of one scenario's gradient, per unit of theta
DIFFERENCE = 0.02  # step of finite differences in theta


class Problem:
    """The objective of a config, compiled once for runs of ``batch`` scenarios.

    Scenarios have a leading axis, as sampled; the noise of each depends on ``key`` and its id alone, so that any two sets of
    gains are compared run by run.
    """

    def __init__(
        self, config: Config, objective: Mapping[str, Term], key: Array, batch: int, *, follows: bool = True
    ) -> None:
        """``follows`` says whether torque thresholds may follow the motion; without it programs do not look at that."""
        self.config, self.objective, self.key, self.batch = config, dict(objective), key, batch
        self._follows = follows
        self.names = tuple(self.objective)
        self.weights = np.array([term.weight for term in self.objective.values()], float)
        # Programs of built-in terms serve every observer and controller; a user's own terms may look at the config.
        built = all(getattr(built_in, term.value.__name__, None) is term.value for term in self.objective.values())
        self.stages = stages.as_data(config) if built else None
        self._traced = stages.general(config) if built else config
        self.kind = self._traced, tuple(self.objective.items()), batch, follows
        self.program_kind: Kind = program_kind(config.engine)
        # Programs are kept between processes where their names tell all of their code: a user's is not looked at.
        self.cached_as = _cached_as(*self.kind) if built and config.scheme in SCHEMES else None
        scores = over_scenarios(lambda given, split: self.terms(given[0], given[1], given[2], split), batch)
        self.sharding = everywhere(batch)
        self._scores = shared(
            ("scores", *self.kind),
            lambda: jit(scores, kind=self.program_kind, cached_as=self.cached_as, like=0, sharding=self.sharding),
        )

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
        return self._scores((self.key, self.stages, gains), scenarios)

    def total(self, scores: np.ndarray) -> float:
        """The objective from terms [terms, scenarios]."""
        return float(self.weights @ scores.mean(1))

    def loss(self, scores: np.ndarray, start: np.ndarray) -> float:
        """Objective and guard, from terms [terms, scenarios] and those of the starting gains on the same scenarios."""
        return float(self.weights @ (scores.mean(1) + GUARD * np.maximum(scores.mean(1) - start.mean(1), 0.0)))

    def terms(self, key: Array, on: Stages | None, gains: Gains, scenarios: Scenario) -> Array:
        """Terms [terms, B] of scenarios with a trailing axis, traced; gains may carry the same axis.

        A run with a term that is not finite has diverged: it counts ``LOST`` in every term.
        """
        return self._joined(self._alone(on, gains, scenarios.id.shape), self._simulated(key, on, gains, scenarios))

    def _alone(self, on: Stages | None, gains: Gains, axes: tuple[int, ...] = ()) -> Array:
        """The terms of gains alone, [terms, ...]."""
        run = Run(self._traced, gains, stages=on)
        return _rows([term.value(run) for term in self.objective.values() if term.gains_only], axes)

    def _simulated(self, key: Array, on: Stages | None, gains: Gains, scenarios: Scenario) -> Array:
        """The other terms, [terms, B]."""
        gains = gains if self._follows else threshold.known_constant(gains)
        trace = run_loop(self._traced, stages.as_data(self.config) if on is None else on, gains, scenarios, key)
        run = Run(self._traced, gains, scenarios, trace, on)
        rows = _rows([term.value(run) for term in self.objective.values() if not term.gains_only], scenarios.id.shape)
        return _sound(rows)

    def _joined(self, alone: Array, simulated: Array) -> Array:
        """All terms [terms, B], in their order."""
        kinds = {True: iter(alone), False: iter(simulated)}
        return _sound(_rows([next(kinds[term.gains_only]) for term in self.objective.values()], simulated.shape[1:]))

    def at(self, space: Space) -> Callable[[Array, Array, Array | float, Scenario], Array]:
        """(key, points [size, B], widen, scenarios) to terms [terms, B], one theta a scenario. To be traced."""
        run = self._spread(space.layout, self.terms)
        return lambda key, points, widen, scenarios: run(
            key, space.free, spread(space.free, space.padded(points)), widen, scenarios
        )

    def _spread(
        self, layout: Layout, terms: Callable[[Array, Stages | None, Gains, Scenario], Array]
    ) -> Callable[[Array, Free, Array, Array | float, Scenario], Array]:
        """(key, free, moves [layout.size, B], widen, scenarios) to some of the terms, over all devices."""

        def block(shared: tuple[Array, Free, Array], split: tuple[Array, Scenario]) -> Array:
            (key, free, widen), (moves, scenarios) = shared, split
            on = None if self.stages is None else free.stages
            return terms(key, on, gains_of(layout, free, moves, widen), scenarios)

        run = over_scenarios(block, self.batch)
        return lambda key, free, moves, widen, scenarios: run(
            (key, free, jnp.asarray(widen, moves.dtype)), (moves, scenarios)
        )

    def slope(self, space: Space, mode: str) -> Callable[[Array, Array, Array, Scenario, Array], tuple[Array, Array]]:
        """(key, theta, widen, scenarios, start terms) to (terms [terms, B], a gradient of the loss a scenario [size, B]).

        To be traced; see ``slope_of``.
        """
        slope = self.slope_of(space.layout, mode, space.size)

        def call(key: Array, theta: Array, *rest: Any) -> tuple[Array, Array]:
            terms, slopes = slope(key, space.free, space.padded(theta), *rest)
            return terms, slopes[: space.size]

        return call

    def slope_of(self, layout: Layout, mode: str, size: int) -> Callable[..., tuple[Array, Array]]:
        """(key, free, theta, widen, scenarios, start terms) to (terms [terms, B], gradients [layout.size, B]); to be traced.

        ``theta`` is as long as the layout; its first ``size`` entries count. ``mode`` is how gradients are found:
        ``reverse``, ``forward`` (a run with tangents for each entry of theta: for few gains) or ``finite`` differences;
        terms of gains alone have theirs in reverse. A gradient that is not finite counts as 0, one longer than ``CLIP`` is
        cut to that: one run that hits a limit must not turn the whole step.
        """
        run = self._spread(layout, self._simulated)
        gains_only = np.array([term.gains_only for term in self.objective.values()])

        def copies(vector: Array) -> Array:
            return jnp.broadcast_to(vector[:, None], (vector.size, self.batch))

        def call(
            key: Array, free: Free, theta: Array, widen: Array, scenarios: Scenario, start: Array
        ) -> tuple[Array, Array]:
            def at(moves: Array) -> Array:
                return run(key, free, moves, widen, scenarios)

            moves = spread(free, theta)
            on = None if self.stages is None else free.stages
            alone, pull_alone = jax.vjp(lambda moves: self._alone(on, gains_of(layout, free, moves, widen)), moves)
            simulated, pull = jax.vjp(at, copies(moves)) if mode == "reverse" else (at(copies(moves)), None)
            terms = self._joined(alone, simulated)
            weights = self._pull(terms, start).astype(theta.dtype)
            if pull is not None:
                slopes = gather(free, pull(jnp.broadcast_to(weights[~gains_only, None], simulated.shape))[0])
            else:
                if mode == "forward":
                    change = lambda d: jax.jvp(at, (copies(moves),), (copies(spread(free, d)),))[1]  # noqa: E731
                else:
                    change = lambda d: (at(copies(moves + DIFFERENCE * spread(free, d))) - simulated) / DIFFERENCE  # noqa: E731
                changes = jax.lax.map(change, jnp.eye(size, theta.size, dtype=theta.dtype))
                slopes = jnp.einsum("k,pkb->pb", weights[~gains_only], changes)
                slopes = jnp.pad(slopes, ((0, theta.size - size), (0, 0)))
            own = gather(free, pull_alone(weights[gains_only])[0])[:, None]
            slopes = jnp.where((terms == LOST).all(0), slopes, slopes + own)
            length = jnp.sqrt((slopes * slopes).sum(0))
            return terms, jnp.where(jnp.isfinite(length), slopes * jnp.minimum(1.0, CLIP / (length + 1e-12)), 0.0)

        return call

    def _pull(self, terms: Array, start: Array) -> Array:
        """Derivative [terms] of the loss by the mean of each term."""
        worse = terms.mean(1) > start.mean(1)
        return jnp.asarray(self.weights, terms.dtype) * (1 + GUARD * worse)


_programs: dict[Any, Any] = {}


def shared(kind: tuple[Any, ...], make: Callable[[], Any]) -> Any:
    """The program of a kind: made once in a process, whichever problem asks for it."""
    if kind not in _programs:
        _programs[kind] = make()
    return _programs[kind]


def _cached_as(config: Config, objective: tuple[tuple[str, Term], ...], batch: int, follows: bool) -> str:
    """What a problem's programs are made of."""
    every = [(name, term.weight, term.value.__name__, term.gains_only) for name, term in objective]
    return repr((config, every, batch, follows))


def _rows(values: list[Array], axes: tuple[int, ...]) -> Array:
    """One array [values, *axes]."""
    return jnp.stack([jnp.broadcast_to(value, axes) for value in values]) if values else jnp.zeros((0, *axes))


def _sound(terms: Array) -> Array:
    """Terms [terms, B] with ``LOST`` in all of a run that has one that is not finite."""
    return jnp.where(jnp.isfinite(terms).all(0), terms, LOST)
