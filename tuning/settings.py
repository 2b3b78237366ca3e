"""Settings of a tuning run: one dataclass is the check, the help text and the record."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any, Literal

from jaxftc import checks

METHODS = ("gradient", "cmaes", "random", "finite")
OPTIMIZERS = ("adam", "lion", "sgd")
GRADIENT_COST = 5  # closed-loop simulations that a gradient of one scenario counts as; `jaxftc bench tuning` measures it

if TYPE_CHECKING:
    Optimizer = Literal["adam", "lion", "sgd"] | Any  # also a GradientTransformation, which has no word on the command line
else:
    Optimizer = Literal["adam", "lion", "sgd"]
MOST = 10_000_000
ROUND = 5  # gradient steps between two validations, at most


@dataclasses.dataclass(frozen=True)
class Settings:
    """How to search.

    Attributes:
        method: Gradient through the closed loop; CMA-ES, random search or finite differences with
            the same budget of simulations.
        steps: Gradient steps; another method gets as many simulations as these would cost.
        batch: Scenarios per step.
        validation: Scenarios on which the best gains are chosen; never trained on.
        optimizer: Rule of the gradient steps, after clipping. From Python also any
            optax.GradientTransformation with a rate of 1.
        learning_rate: Step size; 0.1 changes a gain without an upper limit by about 10 % a step.
        mode: Reverse mode with checkpoints, or forward mode, which is cheaper for up to about five
            gains and needs less memory.
        anneal: Factors on the widths of both smooth signs, at the first and at the last step; the
            last one is in the tuned gains.
        patience: Stop after this share of the steps without a better validation; 1 never stops early.
    """

    method: Literal["gradient", "cmaes", "random", "finite"] = "gradient"
    steps: int = 100
    batch: int = 64
    validation: int = 128
    optimizer: Optimizer = "adam"
    learning_rate: float = 0.1
    mode: Literal["reverse", "forward"] = "reverse"
    anneal: tuple[float, float] = (2.0, 1.0)
    patience: float = 0.5

    def check(self) -> None:
        """Refuse what cannot be done.

        Raises:
            ValueError: a value is not allowed; the message says which are.
        """
        checks.one_of("method", self.method, METHODS)
        if not all(callable(getattr(self.optimizer, part, None)) for part in ("init", "update")):
            checks.one_of("optimizer", self.optimizer, OPTIMIZERS)
        checks.one_of("mode", self.mode, ("reverse", "forward"))
        checks.integer("steps", self.steps, 1, "100 suit the default gains")
        checks.integer("batch", self.batch, 1, "64 suit two cores")
        if self.steps * self.batch > MOST:
            raise ValueError(
                f"steps x batch must be at most {MOST} training scenarios, which are drawn at once, got {self.steps} x "
                f"{self.batch}; 100 x 64 suit the default gains"
            )
        checks.integer("validation", self.validation, 1, "128 tell steps apart", 1_000_000)
        checks.positive("patience", self.patience, "the steps")
        if self.patience > 1:
            raise ValueError(f"patience must be a share of the steps, at most 1, got {self.patience!r}; 1 never stops early")
        checks.positive("learning_rate", self.learning_rate, "theta")
        if len(self.anneal) != 2 or not all(math.isfinite(a) and a > 0 for a in self.anneal):
            raise ValueError(f"anneal must be two positive factors, first and last, got {self.anneal!r}")

    @property
    def budget(self) -> int:
        """Closed-loop simulations that a method may use."""
        return self.steps * self.batch * GRADIENT_COST

    def widen(self, share: float) -> float:
        """Factor on the widths of the smooth signs after a share of the steps, from the first to the last geometrically."""
        first, last = self.anneal
        return first * (last / first) ** share


def round_length(steps: int) -> int:
    """Steps between two validations: the largest divisor up to ROUND, so that every round is the same program."""
    return max(d for d in range(1, ROUND + 1) if steps % d == 0)
