"""Artifacts against ``jaxftc.step``, tick by tick, in closed-loop runs with every kind of fault."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.compile.jit import jit
from jaxftc.export.artifact import Artifact, Leaves
from jaxftc.export.tick import DTYPES, Tick, precision
from jaxftc.scenarios import reference
from jaxftc.scenarios.faults import Actuator, Sensor
from jaxftc.scenarios.scenario import ENCODER_NOISE, Scenario, healthy_scenario, stack, trail
from jaxftc.simulation import closed_loop

TICKS = 10_000  # of each kind of fault
RUN = 500  # ticks of a run
TOLERANCE = {"double": 1e-9, "float": 1e-4}  # of a signal, over its largest size in the check
# What is learned of the arm comes from innovations. A reading in single precision is good to 3e-8 rad, and on the PUMA that
# count alone moves the learned numbers by up to 7e-4 of their size, so nothing in single precision can agree any better.
LEARNED = "state.adaptation_phi"
LEARNED_TOLERANCE = {"double": 1e-9, "float": 1e-3}
# Share of ticks in which a counter may differ. Statistics agree to TOLERANCE, so that one which is closer than that to its
# threshold may be over it in one program and not in another; in the next tick both start from the same state again.
COUNTED = {"double": 0.0, "float": 1e-5}
SIZES: dict[str, tuple[float, float]] = {  # of a fault, in its unit; of a torque's bias over the joint's limit
    "actuator bias": (0.05, 0.3),
    "actuator loss": (0.3, 0.9),
    "actuator stuck": (0.0, 0.0),
    "actuator saturation": (0.02, 0.2),
    "actuator gain": (-0.5, 0.5),
    "actuator ripple": (0.02, 0.1),
    "actuator friction": (0.02, 0.1),
    "actuator locked": (0.0, 0.0),
    "actuator delay": (1.0, 5.0),
    "sensor bias": (0.003, 0.1),
    "sensor drift": (0.1, 1.0),
    "sensor scale": (0.02, 0.1),
    "sensor freeze": (0.0, 0.0),
    "sensor noise": (20.0, 100.0),
    "sensor dropout": (0.0, 0.0),
    "sensor rounding": (0.001, 0.02),
    "sensor wrap": (0.5, 3.0),
    "sensor delay": (1.0, 5.0),
    "sensor crosstalk": (0.02, 0.2),
}
KINDS = ("healthy", *SIZES, "both")
CHANNELS = {"actuator": ("fault_tau", Actuator), "sensor": ("fault_q", Sensor)}


class Compared(NamedTuple):
    """How far an artifact is from ``jaxftc.step``."""

    ticks: int  # of each kind of fault
    error: dict[str, float]  # by kind: the largest difference of a signal over its largest size; LEARNED and counters apart
    worst: str  # the signal with the largest of them
    verdicts: int  # that differ
    alarms: int  # joints with a verdict that is not normal, so that equal verdicts say something
    tolerance: float
    learned: float = 0.0  # the largest difference of what is learned of the arm, over its largest size
    learned_tolerance: float = 0.0
    counted: int = 0  # ticks in which a counter or flag, whose numbers are all whole, differs
    counted_tolerance: int = 0

    @property
    def met(self) -> bool:
        """Whether all is within the tolerance, and every verdict equal."""
        close = max(self.error.values()) <= self.tolerance and self.learned <= self.learned_tolerance
        return self.verdicts == 0 and self.counted <= self.counted_tolerance and close


def compare(
    tick: Tick,
    artifacts: Mapping[str, Artifact],
    *,
    ticks: int = TICKS,
    run: int = RUN,
    seed: int = 0,
    done: Callable[[int], object] = int,
) -> dict[str, Compared]:
    """Ticks of closed-loop runs with every kind of fault: each artifact's from the state that ``jaxftc.step`` had.

    Outputs and next states are compared, and what ``init`` makes of the place where each run begins.

    Args:
        tick: What was exported.
        artifacts: What it became, by name.
        ticks: Of each kind of fault; as many whole runs as it takes.
        run: Ticks of a run.
        seed: Of motions, faults and noise.
        done: Is told after each tick how many were compared.
    """
    runs = -(-ticks // run)
    names = [kind for kind in KINDS for _ in range(runs)]
    leaves = tick.leaves()
    labels = [f"{signal}.{leaf.name}" for signal in ("state", "out") for leaf in leaves[signal]]
    verdict = labels.index("out.verdict")
    size, gaps = np.zeros(len(labels)), {name: np.zeros((len(labels), len(names))) for name in artifacts}
    whole, off = np.arange(len(labels)) != verdict, {name: np.zeros(len(labels), int) for name in artifacts}
    different, alarms = dict.fromkeys(artifacts, 0), 0
    with precision(tick.real):
        for k, (before, signals, after, out) in enumerate(_reference(tick, names, run, seed)):
            if k == 0:
                for name, artifact in artifacts.items():
                    made = artifact.init(np.asarray(signals[0]))
                    gaps[name][: len(made)] = [_apart(a, b) for a, b in zip(made, before, strict=True)]
            wanted = [*after, *out]
            size = np.maximum(size, [_size(leaf) for leaf in wanted])
            whole &= [bool((leaf == np.round(leaf)).all()) for leaf in wanted]
            alarms += int((wanted[verdict] != 0).sum())
            for name, artifact in artifacts.items():
                made = [leaf for part in artifact.step(before, signals) for leaf in part]
                different[name] += int((made[verdict] != wanted[verdict]).sum())
                gap = np.array([_apart(a, b) for a, b in zip(made, wanted, strict=True)])
                gaps[name], off[name] = np.maximum(gaps[name], gap), off[name] + (gap > 0).sum(1)
            done(len(names))
    found, counters = {}, whole & (size >= 1)
    for name, gap in gaps.items():
        share = gap / np.where(size > 0, size, 1.0)[:, None]
        learned = np.array([label.startswith(LEARNED) for label in labels])
        of_learned, share[learned] = float(share[learned].max(initial=0.0)), 0.0
        share[counters] = 0.0
        error = {kind: float(share[:, np.array(names) == kind].max()) for kind in KINDS}
        worst = labels[int(share.max(1).argmax())]
        allowed = TOLERANCE[tick.real], of_learned, LEARNED_TOLERANCE[tick.real]
        counted = int(off[name][counters].sum()), int(COUNTED[tick.real] * runs * run * len(KINDS))
        found[name] = Compared(runs * run, error, worst, different[name], alarms, *allowed, *counted)
    return found


def _size(leaf: np.ndarray) -> float:
    """The largest number of a signal, those that are not finite left out."""
    return float(np.abs(np.where(np.isfinite(leaf), leaf, 0)).max())


def _apart(have: np.ndarray, want: np.ndarray) -> np.ndarray:
    """Largest difference [B] in a signal [B, ...]; numbers that are equal count as such, NaN and infinities too."""
    have, want = (np.asarray(x, float).reshape(len(x), -1) for x in (have, want))
    same = (have == want) | (np.isnan(have) & np.isnan(want))
    with np.errstate(invalid="ignore"):
        return np.where(same, 0.0, np.nan_to_num(np.abs(have - want), nan=np.inf)).max(1)


def _reference(tick: Tick, names: list[str], run: int, seed: int) -> Iterator[tuple[Leaves, Leaves, Leaves, Leaves]]:
    """State, signals, next state and output of ``jaxftc.step`` for every tick, arms first; it begins at rest."""
    config = dataclasses.replace(tick.config, engine="chain", t_final=run * tick.config.dt, duration=None)
    scenario = trail(jax.tree.map(_cast(tick), scenarios(config, names, seed)))
    advance = jit(closed_loop.advance, static_argnums=0)
    noise = closed_loop.encoder_noise(config, scenario, jax.random.key(seed))
    loop = closed_loop.start(config, tick.gains, scenario)
    desired = jax.jit(lambda t: reference.cubic(scenario.q_start, scenario.q_goal, config.t_final, t))
    for k in range(run):
        t = jnp.asarray(k * config.dt, DTYPES[tick.real])
        after, trace = advance(config, tick.gains, scenario, loop, t, noise[k])
        told = [*desired(t), trace.y, loop.tau]
        yield _first(loop.controller), _first(told), _first(after.controller), _first(trace.out)
        loop = after


def _first(tree: Any) -> Leaves:
    return [np.moveaxis(np.asarray(leaf), -1, 0) for leaf in jax.tree.leaves(tree)]


def _cast(tick: Tick) -> Callable[[Any], Any]:
    return lambda leaf: leaf.astype(DTYPES[tick.real]) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf


def scenarios(config: Any, names: list[str], seed: int) -> Scenario:
    """A scenario for each kind named, leading axis: motion, joint, size and onset drawn."""
    draw = np.random.default_rng(seed)
    limit = np.where(np.isfinite(config.robot.torque_limit), config.robot.torque_limit, 10.0)
    made = []
    for k, name in enumerate(names):
        start = config.robot.q_zero + draw.uniform(-0.5, 0.5, config.n)
        goal = start + draw.uniform(-1.0, 1.0, config.n) * min(config.t_final, 1.0)
        one = healthy_scenario(config, q_start=start, q_goal=goal, noise=ENCODER_NOISE, scenario_id=k)
        for kind in {"healthy": (), "both": ("actuator bias", "sensor bias")}.get(name, (name,)):
            channel, kinds = CHANNELS[kind.split()[0]]
            joint = draw.integers(config.n)
            size = draw.uniform(*SIZES[kind]) * draw.choice((-1.0, 1.0) if kind.split()[1] in SIGNED else (1.0,))
            size *= limit[joint] if kind == "actuator bias" else 1.0
            fault = getattr(one, channel)
            values = {"kind": kinds[kind.split()[1].upper()], "magnitude": size}
            values |= {"onset": draw.uniform(0.1, 0.5) * config.t_final}
            new = {field: getattr(fault, field).at[joint].set(value) for field, value in values.items()}
            one = one._replace(**{channel: fault._replace(**new)})
        made.append(one)
    return stack(made)


SIGNED = ("bias", "drift", "scale")
