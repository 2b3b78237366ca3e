"""The figures of ``jaxftc bench speed``, in one table: what each is, its unit, which way is better, what the gate allows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, get_args

Section = Literal["forward", "mjx", "gradient", "tick", "campaign", "kernels", "starts", "dynamics", "scaling"]
SECTIONS: tuple[Section, ...] = get_args(Section)  # the last four have tables only


class Metric(NamedTuple):
    """One figure."""

    section: Section  # of the suite that measures it
    key: str
    unit: str
    direction: Literal["higher", "lower"]  # which is better
    about: str
    tolerance: float | None = None  # share by which it may be worse than the baseline; None: not gated, since times drift
    quick: bool = True  # measured by a quick run too
    perfect: float = 0.0  # of a figure that should be low: a baseline below it was luck, and is taken for it


def _of(section: Section, *rows: tuple[Any, ...]) -> list[Metric]:
    return [Metric(section, *row) for row in rows]


HIGHER, LOWER = "higher", "lower"
RATE, TIMES = "scenario-steps/s", "times"
METRICS = (
    *_of(
        "forward",
        ("plant_chain_over_c", TIMES, HIGHER, "plant only, chain, over mujoco.rollout, all cores each", 0.15),
        ("loop_chain_over_c", TIMES, HIGHER, "whole closed loop, chain, over mujoco.rollout's plant only", 0.15),
        ("loop_over_numpy", TIMES, HIGHER, "whole closed loop over the same in NumPy on MuJoCo C, one arm", 0.25),
        ("plant_steps_per_s", RATE, HIGHER, "plant only, chain, all cores"),
        ("loop_steps_per_s", RATE, HIGHER, "whole closed loop with scores, chain, all cores"),
        ("rollout_steps_per_s", RATE, HIGHER, "MuJoCo C, mujoco.rollout, plant only, all cores"),
        ("mj_step_steps_per_s", RATE, HIGHER, "MuJoCo C, mj_step, plant only, one thread"),
        ("numpy_steps_per_s", RATE, HIGHER, "the same controller in NumPy on mj_step, one arm, one thread"),
        ("compile_forward_s", "s", LOWER, "compiling the closed loop with scores, empty cache"),
        ("compile_forward_warm_s", "s", LOWER, "the same from a filled cache, least of some fresh processes", None, False),
    ),
    *_of(
        "mjx",
        ("loop_mjx_over_mjx_default", TIMES, HIGHER, "closed loop, engine mjx, over mjx.step as it comes, plant only", 0.3),
        ("loop_mjx_steps_per_s", RATE, HIGHER, "whole closed loop with scores, engine mjx, all cores"),
        ("mjx_default_steps_per_s", RATE, HIGHER, "mjx.step in jit(vmap(scan)), XLA's own options, plant only"),
        ("compile_mjx_default_s", "s", LOWER, "compiling that, empty cache"),
    ),
    *_of(
        "gradient",
        ("grad_over_forward", TIMES, LOWER, "time of a gradient for all gains over the forward run's", 0.2),
        ("grad_steps_per_s", RATE, HIGHER, "five steps of jaxftc tune, gradient for all gains, chain, all cores"),
        ("grad_memory_gib", "GiB", LOWER, "what its compiler sets aside for 1,024 scenarios x 1,000 steps", 0.1),
        ("grad_peak_gib", "GiB", LOWER, "peak resident memory of a process that runs it"),
        ("compile_grad_s", "s", LOWER, "compiling the gradient, empty cache"),
        ("compile_grad_warm_s", "s", LOWER, "the same from a filled cache, least of some fresh processes", None, False),
    ),
    *_of(
        "tick",
        ("tick_p50_us", "us", LOWER, "one tick by jaxftc.Tick called from Python, NumPy in and out, median"),
        ("tick_p99_us", "us", LOWER, "99 % of ticks are faster"),
        ("tick_p999_us", "us", LOWER, "99.9 % of ticks are faster"),
        ("tick_backend_c_p50_us", "us", LOWER, 'the same by jaxftc.Tick(..., backend="c"), median'),
        ("tick_backend_c_p99_us", "us", LOWER, "99 % of those are faster"),
        ("tick_backend_c_p999_us", "us", LOWER, "99.9 % of those are faster"),
        ("tick_c_p50_us", "us", LOWER, "one tick of the C code of jaxftc export, float, called from C, median"),
        ("tick_c_p99_us", "us", LOWER, "99 % of those are faster"),
        ("tick_c_p999_us", "us", LOWER, "99.9 % of those are faster"),
    ),
    *_of(
        "campaign",
        ("campaign_10k_s", "s", LOWER, "jaxftc campaign -n 10000 from start to exit, storage included, warm cache"),
        ("campaign_steps_per_s", RATE, HIGHER, "in it, storage included, start and report left out"),
        (
            "campaign_linearity",
            TIMES,
            LOWER,
            "cost of a scenario in the largest one over that in 10,000",
            0.15,
            False,
            1.0,
        ),
        ("campaign_memory_growth", TIMES, LOWER, "peak memory of the largest one over that of 1,000", 0.25, False, 1.0),
    ),
)
TABLE = {metric.key: metric for metric in METRICS}


def expected(sections: Sequence[Section], *, quick: bool) -> list[str]:
    """Keys that a run of some sections must give."""
    return [m.key for m in METRICS if m.section in sections and (m.quick or not quick)]


def gated() -> dict[str, float]:
    """Keys that the gate looks at, with their tolerances."""
    return {m.key: m.tolerance for m in METRICS if m.tolerance is not None}
