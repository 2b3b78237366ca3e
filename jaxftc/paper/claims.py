"""What became of the paper's claims: each with our number, whether it was met, and the figure of the paper it belongs to."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from jaxftc.config import CONTROLS, OBSERVERS, Config
from jaxftc.evaluation import metrics
from jaxftc.paper.results import Arx, Claim, Comparison, Experiment, Row
from jaxftc.scenarios.scenario import CONDITIONS, PAPER_TORQUE

TIE = 0.02  # relative difference below which two figures are called equal
ARX_DEG = 0.05  # the paper's bound on the healthy error
FIGURES = {"actuator": "12", "sensor": "13", "both": "14"}  # residuals by condition


def judge(config: Config, experiment: Experiment) -> Iterator[Claim]:
    """All claims, in the order of the figures."""
    best = experiment.traces[OBSERVERS[-1], CONTROLS[-1]]
    yield _arx(experiment.arx)
    yield from _first_joint(experiment)
    yield from _thresholds(config, experiment.wrong)
    yield _healthy(best[0])
    for channel, name, unit in (("fault_tau_rms_nm", "torque", "N m"), ("fault_q_rms_deg", "encoder", "deg")):
        yield _estimation(experiment.rows, channel, name, unit)
    for condition, trace in zip(CONDITIONS[1:], best[1:], strict=True):
        yield _detected(config, condition, trace)
    for pair in experiment.comparisons:
        if pair.condition != "healthy":
            yield _tracking(pair)
    yield _chattering(experiment.rows)


def _arx(arx: Arx) -> Claim:
    """The model running alone; its errors at other horizons beside what a straight line through two readings reaches."""
    found = arx.errors
    sizes = (found.free_run, found.one_step, found.fifty_step, found.extrapolator_one_step, found.extrapolator_fifty_step)
    worst, *others = (float(np.rad2deg(size.max.max())) for size in sizes)
    one, fifty, line_one, line_fifty = (f"{value:.3f}" for value in others)
    return Claim(
        "arx_healthy",
        "2",
        "healthy ARX-Laguerre error below 0.05 deg",
        worst,
        "deg",
        worst < ARX_DEG,
        f"largest, model running alone over the whole motion, identified from another run of it; 1 and 50 steps ahead "
        f"{one} and {fifty} deg, where a straight line through two readings is off by {line_one} and {line_fifty} deg",
    )


def _first_joint(experiment: Experiment) -> Iterator[Claim]:
    """Torque-fault estimate of the first joint with both faults on, observer by observer."""
    error, threshold = {}, 0.0
    for observer in OBSERVERS:
        trace = experiment.traces[observer, CONTROLS[-1]][-1]
        error[observer] = metrics.rms(trace["fault_tau_hat"][:, 0] - trace["fault_tau"][:, 0])
        threshold = float(trace["threshold_tau"][0, 0])
    pi, eso, ts = error.values()
    words = (
        ("pi", "3", "first joint: the PI estimate is not accurate", pi > threshold, f"above the threshold of {threshold:g}"),
        ("eso", "4", "first joint: the estimate improves with the sliding mode", eso < (1 - TIE) * pi, f"PI: {pi:.4g}"),
        ("ts", "6", "first joint: the T-S estimate is the best", ts < (1 - TIE) * min(pi, eso), f"ESO: {eso:.4g}"),
    )
    for observer, figure, claim, met, beside in words:
        detail = f"rms over the run, actuator and encoder fault at once; {beside} N m"
        yield Claim(f"first_joint_{observer}", figure, claim, error[observer], "N m", met, detail)


def _thresholds(config: Config, wrong: list[dict[str, np.ndarray]]) -> Iterator[Claim]:
    """Thresholds too small, in the healthy run, and too large, in that of the actuator fault."""
    small, large = wrong
    false = np.flatnonzero(small["detected"])
    level = f"{small['threshold_tau'][0, 0]:g} N m"
    first = f"the first at {false[0] * config.dt:.3f} s" if false.size else "none"
    claim = "thresholds too small raise false alarms"
    yield Claim("threshold_small", "7", claim, float(false.size), "ticks", bool(false.size), f"healthy, {level}; {first}")
    found = int((large["verdict"] > 0).any(0).sum())
    detail = f"actuator faults of {PAPER_TORQUE:g} N m on all joints, thresholds of {large['threshold_tau'][0, 0]:g} N m"
    yield Claim(
        "threshold_large", "7", "thresholds too large miss faults", float(found), f"joints of {config.n} with an alarm",
        found < config.n, detail,
    )  # fmt: skip


def _healthy(trace: dict[str, np.ndarray]) -> Claim:
    """Healthy statistics against their thresholds."""
    share = {c: float((np.abs(trace[f"statistic_{c}"]) / trace[f"threshold_{c}"]).max()) for c in ("tau", "q")}
    return Claim(
        "healthy_residuals",
        "10",
        "healthy residuals stay within the thresholds",
        100 * max(share.values()),
        "% of the threshold",
        max(share.values()) < 1,
        f"the largest of any joint; torque channel {100 * share['tau']:.1f} %, encoder channel {100 * share['q']:.1f} %",
    )


def _detected(config: Config, condition: str, trace: dict[str, np.ndarray]) -> Claim:
    """Verdicts of T-S with AFESMC, joint by joint, and no alarm where there is no fault."""
    wanted, present = metrics.truth(trace)
    found = metrics.detection(config, trace["verdict"], wanted, present)
    right = int((found.verdict == wanted).sum())
    alarm = (
        "no alarm" if found.delay_s is None or np.isinf(found.delay_s) else f"first alarm after {found.delay_s * 1e3:.0f} ms"
    )
    false = "no false alarm" if found.false_alarm_s is None else f"false alarm at {found.false_alarm_s:.3f} s"
    return Claim(
        f"detect_{condition}",
        FIGURES[condition],
        "actuator and encoder fault at once: isolated on all joints"
        if condition == "both"
        else f"{condition} fault detected and isolated on all joints",
        float(right),
        f"joints of {config.n}",
        right == config.n and found.false_alarm_s is None,
        f"{alarm}, verdict {metrics.SETTLE * 1e3:.0f} ms later, {false}",
    )


def _estimation(rows: list[Row], channel: str, name: str, unit: str) -> Claim:
    """Fault-estimate error from PI to ESO to T-S, mean over the three faulty conditions."""
    errors = [_mean(rows, observer, CONTROLS[-1], channel) for observer in OBSERVERS]
    tied = [step for step, (a, b) in zip(("PI/ESO", "ESO/T-S"), pairwise(errors), strict=True) if abs(b - a) <= TIE * a]
    return Claim(
        f"estimation_{name}",
        "11",
        f"{name}-fault estimation error falls from PI to ESO to T-S",
        errors[-1],
        unit,
        all(after < (1 - TIE) * before for before, after in pairwise(errors)),
        f"{', '.join(f'{e:.4g}' for e in errors)} {unit}, mean over the faulty conditions"
        + (f"; a tie between {' and '.join(tied)}" if tied else ""),
    )


def _tracking(pair: Comparison) -> Claim:
    before, after = pair.before.upper(), pair.after.upper()
    mean, low, high = (f"{100 * value:+.1f}" for value in pair.change)
    note = f"; {before} at its lowest chattering, which is higher" if pair.louder else ""
    return Claim(
        f"tracking_{pair.condition}_{pair.before}_{pair.after}",
        "15b",
        f"{pair.condition}: tracking error falls from {before} to {after} at equal chattering",
        pair.after_deg,
        "deg",
        pair.word == "falls",
        f"{pair.before_deg:.4g} to {pair.after_deg:.4g} deg at {pair.chattering:.2f} 1/s, {mean} % [{low}, {high}] "
        f"over {pair.seeds} noises: {pair.word}{note}",
    )


def _chattering(rows: list[Row]) -> Claim:
    """Travel of the torque with the gains as given: what the fuzzy factor is for."""
    levels = {control: _mean(rows, OBSERVERS[-1], control, "chattering") for control in CONTROLS}
    return Claim(
        "chattering",
        "16",
        "the fuzzy gain makes the torque calmer: chattering falls from ESMC to AFESMC",
        levels["afesmc"],
        "1/s",
        levels["afesmc"] < (1 - TIE) * levels["esmc"],
        ", ".join(f"{name.upper()} {level:.2f}" for name, level in levels.items())
        + " 1/s, mean over the faulty conditions, gains as given; Figure 15b compares at equal chattering",
    )


def _mean(rows: list[Row], observer: str, control: str, figure: str) -> float:
    """Mean of a figure of merit over the three faulty conditions."""
    chosen = [r for r in rows if (r.observer, r.controller) == (observer, control) and r.condition != "healthy"]
    return float(np.mean([getattr(r, figure) for r in chosen]))
