"""The return level of a statistic: what its largest values exceed in a wanted share of runs.

It is counted where there are enough runs, and otherwise that of a generalised Pareto law fitted to the tail.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import stats

from jaxftc.evaluation.intervals import tolerated

TAIL = 0.3  # share of the blocks that a tail is fitted to
LEAST_TAIL, MEMORY = 5, 30  # blocks it takes at least; blocks that an exponential tail counts as beside the fitted one
TRANSFER = 1.15  # times the largest seen, at least: other motions are not quite these
FARTHEST = 1.2  # and at most: what a minute has shown of a tail is not believed further out
MIXED = 5  # blocks in a row that go to the same half


class ReturnLevel:
    """The return level, as a factor on the largest values seen.

    Args:
        false_alarms: Share of runs that may exceed it.
        confidence: That the share is not larger, where runs are counted.
        blocks: Stretches, of about a second, that a largest value is known of.
        per_run: How many of them a run is.

    Attributes:
        method: ``sample`` where runs are counted, ``tail`` where the level is extrapolated.
        rate: Of a block exceeding it, by the fitted tails so far; 0 where runs are counted.
    """

    def __init__(self, false_alarms: float, confidence: float, blocks: int, per_run: int) -> None:
        self.share, self.confidence, self.per_run = false_alarms, confidence, per_run
        self.allowed = tolerated(blocks // per_run, false_alarms, confidence) if blocks >= per_run else -1
        self.method = "sample" if self.allowed >= 0 else "tail"
        self.rate = 0.0

    def factor(self, peaks: np.ndarray) -> float:
        """From the largest statistics [blocks, n] of every block, to be put on the largest of all of each joint.

        Half of the blocks, in turns, are scaled by the largest of the other half: what has not been seen yet counts as much
        as it did between the halves.
        """
        half = np.arange(len(peaks)) // MIXED % 2 == 0
        largest = np.concatenate([(peaks[part] / peaks[~part].max(0)).max(1) for part in (half, ~half)])
        if self.method == "sample":
            return max(self._counted(largest), TRANSFER)
        return self._fitted(largest)

    def _counted(self, largest: np.ndarray) -> float:
        """The level that no more than the allowed number of runs exceeds, of ``largest`` [blocks]."""
        runs = largest[: len(largest) // self.per_run * self.per_run].reshape(-1, self.per_run).max(1)
        return 1.000001 * float(np.sort(runs)[len(runs) - 1 - self.allowed])

    def _fitted(self, largest: np.ndarray) -> float:
        """The level that a tail fitted to ``largest`` [blocks] gives for the wanted share; its rate goes to ``rate``."""
        ordered = np.sort(largest)
        count = max(LEAST_TAIL, round(TAIL * len(ordered)))
        base, above = ordered[-count - 1], ordered[-count:] - ordered[-count - 1]
        above = above[above > 0]
        if not len(above):
            return TRANSFER
        fitted = stats.genpareto.fit(above, floc=0)[0] if len(above) > LEAST_TAIL else 0.0
        shape = float(np.clip(len(above) * fitted / (len(above) + MEMORY), -0.3, 0.3))
        tail = stats.genpareto(shape, loc=base, scale=above.mean() * (1 - shape))
        share = count / len(ordered)
        p = -math.expm1(math.log1p(-self.share) / self.per_run)  # wanted, of a block
        level = float(np.clip(tail.isf(min(p / share, 1.0)), TRANSFER, FARTHEST))
        self.rate = max(self.rate, share * float(tail.sf(level)))
        return level
