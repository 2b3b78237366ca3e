"""Progress of a tune on stderr."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tqdm import tqdm

    from jaxftc.config import Config
    from jaxftc.gains import Gains
    from tuning.loop import Progress


class Bar:
    """Progress on stderr: loss, gradient norm, time left, scenario steps a second (a gradient counts as several runs)."""

    def __init__(self, config: Config, *, shown: bool = True) -> None:
        from tqdm import tqdm

        self.ticks = config.ticks
        self.last: Progress | None = None
        self.bar: tqdm[Any] = tqdm(
            desc="compiling, a minute or so the first time", unit="step", leave=False, disable=not shown
        )

    def __enter__(self) -> Bar:
        return self

    def __exit__(self, *error: object) -> None:
        self.bar.close()

    def show(self, progress: Progress, best: Gains) -> None:
        """After a round."""
        done, since = (self.last.simulations, self.last.seconds) if self.last else (0, 0.0)
        rate = (progress.simulations - done) * self.ticks / (progress.seconds - since)
        self.bar.set_description("tuning", refresh=False)
        self.bar.total = progress.steps
        norm = "" if progress.gradient_norm != progress.gradient_norm else f", |gradient| {progress.gradient_norm:.2g}"
        text = f"loss {progress.loss:.3f}{norm}, validation {progress.validation:.3f}, {rate:.1e} scenario-steps/s"
        self.bar.set_postfix_str(text, refresh=False)
        if self.last is None:  # time left is judged by the rounds that follow: this one compiled, or was a resumed run's
            self.bar.initial, self.bar.n, self.bar.start_t = progress.step, progress.step, time.time()
            self.bar.refresh()
        else:
            self.bar.update(progress.step - self.bar.n)
        self.last = progress
