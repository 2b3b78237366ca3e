"""How much each section measures: a whole run, and a quick one that only shows that everything works."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Sizes:
    """Numbers of scenarios, steps and calls."""

    duration: float | None = None  # s; the motion's, 1 s at 1 kHz, if None
    rounds: int = 5  # timed calls of each side, after one to warm up
    plant: int = 1024  # arms of plant-only runs
    width: int = 256  # of them side by side in one of our programs
    step: int = 128  # arms of mj_step's
    loop: int = 4096  # scenarios of the closed loop
    loop_mjx: int = 256
    mjx_default: tuple[tuple[int, int], ...] = ((64, 20), (256, 20))  # (arms, steps) tried
    gradient: int = 512  # scenarios
    kernels: int = 512  # scenarios of the gradient whose kernels are counted
    memory: int = 1024  # scenarios of the gradient whose memory counts
    ticks: int = 20_000
    campaign: int = 10_000
    campaigns: tuple[int, ...] = (1000, 100_000)  # a smaller and a larger one, for whether cost is linear
    batches: tuple[int, ...] = (1, 4, 16, 64, 256, 1024, 4096, 16_384)
    horizons: tuple[float, ...] = (0.1, 1.0, 10.0)  # s
    joints: tuple[int, ...] = (1, 2, 3, 6, 7)
    dynamics: int = 16_384  # arms
    everything: bool = True  # warm compilation, whether cost is linear, start of every command, the float64 check


FULL = Sizes()
QUICK = Sizes(
    duration=0.15,
    rounds=2,
    plant=256,
    step=16,
    loop=256,
    loop_mjx=128,
    mjx_default=((8, 5),),
    gradient=8,
    kernels=64,
    memory=8,
    ticks=500,
    campaign=1024,
    campaigns=(),
    batches=(1, 128),
    horizons=(0.15,),
    joints=(2,),
    dynamics=1024,
    everything=False,
)
