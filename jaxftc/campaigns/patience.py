"""A line for those who wait: how long thresholds take to set, where that is long."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from jaxftc.campaigns.calibrate import ROUNDS

PATIENCE = 20.0  # s of runs after which it is said


def told(
    update: Callable[[int], object], note: Callable[[str], object], name: str, runs: int, *, follow: bool = False
) -> Callable[[int], None]:
    """What a calibration calls with each count of healthy runs that is newly through.

    It passes the counts on to ``update``. If the runs take long, it tells ``note`` once how many there are to come and how
    long they take. Time begins with the first count, when all is compiled.

    Args:
        update: Takes each count, as a bar does.
        note: Takes the line of text.
        name: Of the scheme.
        runs: Healthy runs of the calibration: half of them are run in 2 to ``ROUNDS`` rounds, the other half once.
        follow: Whether thresholds that follow the motion are set after constant ones.
    """
    begun, through, said = math.nan, 0, False

    def done(count: int) -> None:
        """So many runs more are done."""
        nonlocal begun, through, said
        update(count)
        now = time.perf_counter()
        if math.isnan(begun):
            begun = now
            return
        through += count
        if not said and now - begun >= PATIENCE:
            said = True
            least, most = ((1 + follow) * number for number in (3, ROUNDS + 1))
            half = runs / 2
            minutes = half * (now - begun) / through / 60
            text = f"{half:,.0f} healthy runs take {minutes:.1f} min; the thresholds take {least} to {most} times as many"
            note(f"{name}: {text}")

    return done
