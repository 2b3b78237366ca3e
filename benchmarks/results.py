"""What a run of the speed suite collects, and where it runs: figures, tables, and the checks of what was timed."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.sizes import Sizes
from benchmarks.worker import Failed as Failed
from benchmarks.worker import Task
from jaxftc.cli import common
from jaxftc.config import Config
from jaxftc.gains import Gains


class Check(NamedTuple):
    """How far a timed result is from what it must be."""

    what: str
    error: float
    allowed: float


class Table(NamedTuple):
    """Rows of a scaling or a comparison."""

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]]


@dataclasses.dataclass
class Results:
    """Filled section by section."""

    metrics: dict[str, float] = dataclasses.field(default_factory=dict)
    tables: dict[str, Table] = dataclasses.field(default_factory=dict)
    checks: list[Check] = dataclasses.field(default_factory=list)

    def check(self, what: str, error: float, allowed: float) -> None:
        """Note a check.

        Raises:
            Failed: the error is larger than allowed, or not a number.
        """
        if not float(error) <= allowed:
            raise Failed(f"what was timed is wrong: {what} is off by {float(error):.3g}, allowed {allowed:.3g}")
        self.checks.append(Check(what, float(error), allowed))


@dataclasses.dataclass(frozen=True)
class Setup:
    """The arm, the sizes and the machine's cores."""

    options: common.Options
    sizes: Sizes
    cores: int
    folder: Path  # scratch

    def config(self, engine: str = "chain", duration: float | None = None) -> Config:
        """The default structure on the arm, for the suite's duration or another."""
        chosen = self.sizes.duration if duration is None else duration
        return Config(common.load_arm(self.options), engine=engine, duration=chosen)  # pyright: ignore[reportArgumentType]

    def gains(self, config: Config) -> Gains:
        """The gains that were asked for."""
        return common.load_or_default(self.options, config)

    def task(self, what: str, **changes: Any) -> Task:
        """A workload of a process of its own on the same arm."""
        robot, gains = self.options.robot, self.options.gains
        base = Task(
            what=what,  # pyright: ignore[reportArgumentType]
            robot=robot if robot == "puma560" else str(Path(robot).resolve()),
            tip=self.options.tip,
            lock=self.options.lock,
            coulomb=self.options.coulomb and robot == "puma560",
            gains=None if gains is None else str(gains.resolve()),
            duration=self.sizes.duration,
        )
        return dataclasses.replace(base, **changes)


def apart(a: Any, b: Any) -> float:
    """The largest distance of two arrays; infinite if one is not finite or they differ in shape."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    if a.shape != b.shape or not (np.isfinite(a).all() and np.isfinite(b).all()):
        return math.inf
    return float(np.abs(a - b).max())
