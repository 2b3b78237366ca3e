"""Searches without a gradient, on the same loss, start, bounds and scenarios: CMA-ES and random search.

A generation is judged on one batch, the same for all its candidates. Neither keeps hidden state: a search that is given the
losses it was told before goes on exactly where it stood.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from tuning.transform import REACH

SIGMA = 0.3  # first standard deviation in theta
EXPLAIN = "CMA-ES needs the package cmaes; install it with: pip install 'jaxftc[baselines]'"


class Evolution:
    """CMA-ES, by the package ``cmaes``; the answer is the mean of its distribution."""

    def __init__(self, size: int, seed: int) -> None:
        try:
            from cmaes import CMA
        except ModuleNotFoundError as error:
            raise ValueError(EXPLAIN) from error
        bounds = np.tile([-REACH, REACH], (size, 1))
        self._cma: Any = CMA(mean=np.zeros(size), sigma=SIGMA, bounds=bounds, seed=seed % 2**32)
        self.population = int(self._cma.population_size)
        self.told = np.zeros((0, self.population))  # losses by generation

    @property
    def theta(self) -> np.ndarray:
        """Mean of the distribution, [size]."""
        return np.asarray(self._cma.mean)

    def generation(self, judge: Callable[[np.ndarray], float]) -> np.ndarray:
        """Judge a population; returns its losses."""
        candidates = [self._cma.ask() for _ in range(self.population)]
        losses = np.array([judge(candidate) for candidate in candidates])
        self._tell(candidates, losses)
        return losses

    def replay(self, told: np.ndarray) -> None:
        """Go through generations whose losses [generations, population] are known."""
        for losses in told:
            self._tell([self._cma.ask() for _ in losses], losses)

    def _tell(self, candidates: list[np.ndarray], losses: np.ndarray) -> None:
        self._cma.tell(list(zip(candidates, losses.tolist(), strict=True)))
        self.told = np.concatenate([self.told, losses[None]])


class Random:
    """Random search around the best so far: of it and one perturbed candidate, judged on the same batch, the better stays.

    The spread grows by a fifth with a success and shrinks with a failure, so that about one in five succeeds.
    """

    population = 2

    def __init__(self, size: int, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self.theta = np.zeros(size)
        self.spread = SIGMA
        self.told = np.zeros((0, self.population))

    def generation(self, judge: Callable[[np.ndarray], float]) -> np.ndarray:
        """Judge the best and a candidate; returns their losses."""
        candidate = self._candidate()
        losses = np.array([judge(self.theta), judge(candidate)])
        self._choose(candidate, losses)
        return losses

    def replay(self, told: np.ndarray) -> None:
        """Go through generations whose losses [generations, 2] are known."""
        for losses in told:
            self._choose(self._candidate(), losses)

    def _candidate(self) -> np.ndarray:
        # A step in all of many directions at once rarely succeeds; length SIGMA * sqrt(10) however many there are.
        step = self.spread * np.sqrt(10 / self.theta.size) * self._random.standard_normal(self.theta.size)
        return np.clip(self.theta + step, -REACH, REACH)

    def _choose(self, candidate: np.ndarray, losses: np.ndarray) -> None:
        success = losses[1] < losses[0]
        self.theta = candidate if success else self.theta
        self.spread *= 1.2 if success else 1.2**-0.25
        self.told = np.concatenate([self.told, losses[None]])
