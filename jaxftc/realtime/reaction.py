"""From verdicts to a state to act on, joint by joint: confirm, latch, clear, heal.

A verdict says what one tick finds. Here it has to last before it counts, it is kept once it does, it has to be gone for a
while before it is given up, and the joint is on probation after that::

    healthy --verdict--> suspected --confirm s--> confirmed --latch s, and quiet for clear s--> healing --heal s--> healthy
                            |                         ^                                           |
                            +--gone--> healthy        +----------------- any verdict -------------+

Time comes in with every call, so that a test needs no clock.
"""

from __future__ import annotations

import dataclasses
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from jaxftc import checks
from jaxftc.types import Verdict


class Phase(IntEnum):
    """Where a joint is between healthy and faulty."""

    HEALTHY = 0
    SUSPECTED = 1
    CONFIRMED = 2
    HEALING = 3


class State(NamedTuple):
    """All [n]."""

    phase: np.ndarray  # a Phase's number
    verdict: np.ndarray  # the verdict that was confirmed; 0 while healthy or suspected
    seen: np.ndarray  # the verdict of the last tick
    steady: np.ndarray  # s that it has been that verdict
    age: np.ndarray  # s in this phase


class Change(NamedTuple):
    """A joint whose phase or confirmed verdict has changed."""

    joint: int  # from 1
    phase: Phase
    verdict: Verdict  # confirmed, or while only suspected what was seen


@dataclasses.dataclass(frozen=True)
class Reaction:
    """Times of the state machine. All zero, it follows the verdicts.

    Attributes:
        confirm: s, that one and the same verdict has to last before it counts.
        latch: s, that a confirmed fault is kept at least; infinite until ``reset``.
        clear: s, without any verdict, after which it is given up.
        heal: s, after that, in which any verdict is confirmed at once.

    Raises:
        ValueError: a time is negative or no number.
    """

    confirm: float = 0.02
    latch: float = 1.0
    clear: float = 0.5
    heal: float = 5.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            checks.span(f"reaction.{field.name}", getattr(self, field.name))

    def init(self, n: int) -> State:
        """Every joint healthy."""
        none, zero = np.zeros(n, int), np.zeros(n)
        return State(none, none, none, zero, zero)

    def step(self, state: State, verdict: np.ndarray, elapsed: float) -> tuple[State, list[Change]]:
        """The state after a tick with a verdict [n], ``elapsed`` s after the one before, and what has changed."""
        if not (verdict.any() or state.phase.any()):
            return state, []
        steady = np.where(verdict == state.seen, state.steady + elapsed, 0.0)
        age, enough = state.age + elapsed, 1 - 1e-9  # times add up with rounding
        there = verdict > 0
        lasted = there & (steady >= enough * self.confirm)
        over = ~there & (steady >= enough * self.clear) & (age >= enough * self.latch)
        phase = np.select(
            [state.phase == Phase.CONFIRMED, state.phase == Phase.HEALING],
            [
                np.where(over, Phase.HEALING, Phase.CONFIRMED),
                np.where(there, Phase.CONFIRMED, np.where(age >= enough * self.heal, Phase.HEALTHY, Phase.HEALING)),
            ],
            np.where(lasted, Phase.CONFIRMED, np.where(there, Phase.SUSPECTED, Phase.HEALTHY)),
        )
        again = (state.phase == Phase.HEALING) & there
        kept = np.isin(phase, (Phase.CONFIRMED, Phase.HEALING))
        confirmed = np.where(kept, np.where((lasted & kept) | again, verdict, state.verdict), 0)
        moved = phase != state.phase
        after = State(phase, confirmed, verdict, steady, np.where(moved, 0.0, age))
        shown = np.where(phase == Phase.SUSPECTED, verdict, confirmed)
        changed = np.flatnonzero(moved | (confirmed != state.verdict))
        return after, [Change(int(j) + 1, Phase(phase[j]), Verdict(shown[j])) for j in changed]

    def reset(self, state: State) -> State:
        """Every joint healthy again, by a person's word; a verdict that is still there is suspected anew."""
        return self.init(len(state.phase))


def names(changes: list[Change], joint_names: tuple[str, ...]) -> list[dict[str, object]]:
    """Changes as the event log has them."""
    return [
        {"joint": c.joint, "joint_name": joint_names[c.joint - 1], "phase": c.phase.name.lower(), "verdict": c.verdict.label}
        for c in changes
    ]
