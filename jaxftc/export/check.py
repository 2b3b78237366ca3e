"""The artifact against ``jaxftc.step``: ticks of closed-loop runs with every kind of fault, each from the same state."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.compile.xla import jit
from jaxftc.export.artifact import Native, records
from jaxftc.export.tick import DTYPES, Tick, precision
from jaxftc.scenarios import reference
from jaxftc.scenarios.faults import Actuator, Sensor
from jaxftc.scenarios.scenario import ENCODER_NOISE, Scenario, healthy_scenario, stack, trail
from jaxftc.simulation import closed_loop

TICKS = 10_000  # of each kind of fault
RUN = 500  # ticks of a run
TOLERANCE = {"double": 1e-9, "float": 1e-4}  # of a signal, over its largest size in the check
SIZES: dict[str, tuple[float, float]] = {  # of a fault, in its unit; of a torque's bias over the joint's limit
    "actuator bias": (0.05, 0.3),
    "actuator loss": (0.3, 0.9),
    "actuator stuck": (0.0, 0.0),
    "actuator saturation": (0.02, 0.2),
    "sensor bias": (0.003, 0.1),
    "sensor drift": (0.1, 1.0),
    "sensor scale": (0.02, 0.1),
    "sensor freeze": (0.0, 0.0),
    "sensor noise": (20.0, 100.0),
    "sensor dropout": (0.0, 0.0),
}
KINDS = ("healthy", *SIZES, "both")
CHANNELS = {"actuator": ("fault_tau", Actuator), "sensor": ("fault_q", Sensor)}


class Compared(NamedTuple):
    """How far the artifact is from ``jaxftc.step``."""

    ticks: dict[str, int]  # compared, by kind of fault
    error: dict[str, float]  # by kind: the largest difference of a signal over its largest size
    worst: str  # the signal with the largest of them
    verdicts: int  # that differ
    alarms: int  # joints with a verdict that is not normal, so that equal verdicts say something

    def holds(self, real: str) -> bool:
        """Whether it is within the tolerance, verdicts equal."""
        return self.verdicts == 0 and max(self.error.values()) <= TOLERANCE[real]


def compare(
    tick: Tick, artifact: Native, *, ticks: int = TICKS, run: int = RUN, seed: int = 0, done: Callable[[int], object] = int
) -> Compared:
    """Run every kind of fault for that many ticks and compare what the tick says, and its next state, tick by tick.

    Args:
        tick: What was exported.
        artifact: What it became.
        ticks: Of each kind of fault.
        run: Ticks of a run.
        seed: Of motions, faults and noise.
        done: Is told after each tick how many were compared.
    """
    runs = -(-ticks // run)
    names = [kind for kind in KINDS for _ in range(runs)]
    gap: dict[str, np.ndarray] = {}
    size: dict[str, np.ndarray] = {}
    different = alarms = 0
    with precision(tick.real):
        for before, signals, after, out in _reference(tick, names, run, seed):
            states = records(artifact.state, jax.tree.leaves(before))
            said = artifact.step(states, records(artifact.signals, signals))
            wanted = records(artifact.out, out), records(artifact.state, jax.tree.leaves(after))
            different += int((said["verdict"] != wanted[0]["verdict"]).sum())
            alarms += int((wanted[0]["verdict"] != 0).sum())
            for have, want in ((said, wanted[0]), (states, wanted[1])):
                for name in want.dtype.names or ():
                    apart, large = _apart(have[name], want[name])
                    gap[name] = np.maximum(gap.get(name, 0.0), apart)
                    size[name] = np.maximum(size.get(name, 0.0), large)
            done(len(names))
    share = {name: gap[name] / max(size[name].max(), np.finfo(artifact.real).tiny) for name in gap}
    worst = np.max(list(share.values()), axis=0)  # [B]
    error = {kind: float(worst[np.array(names) == kind].max()) for kind in KINDS}
    where = max(share, key=lambda name: share[name].max())
    return Compared(dict.fromkeys(KINDS, runs * run), error, where, different, alarms)


def _apart(have: np.ndarray, want: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest difference and largest size [B] of a signal; what is equal counts as such, NaN and infinities too."""
    have, want = (x.astype(float).reshape(len(x), -1) for x in (have, want))
    same = (have == want) | (np.isnan(have) & np.isnan(want))
    with np.errstate(invalid="ignore"):
        gap = np.where(same, 0.0, np.nan_to_num(np.abs(have - want), nan=np.inf))
    return gap.max(1), np.where(np.isfinite(want), np.abs(want), 0.0).max(1)


def _reference(tick: Tick, names: list[str], run: int, seed: int) -> Iterator[tuple[Any, list[Any], Any, Any]]:
    """(state, signals, next state, output) of ``jaxftc.step`` for every tick, arms on the last axis."""
    config = dataclasses.replace(tick.config, engine="chain", t_final=run * tick.config.dt, duration=None)
    scenario = trail(jax.tree.map(_cast(tick), scenarios(config, names, seed)))
    advance = jit(closed_loop.advance, static_argnums=0)
    noise = closed_loop.encoder_noise(config, scenario, jax.random.key(seed))
    loop = closed_loop.start(config, tick.gains, scenario)
    desired = jax.jit(lambda t: reference.cubic(scenario.q_start, scenario.q_goal, config.t_final, t))
    for k in range(run):
        t = jnp.asarray(k * config.dt, DTYPES[tick.real])
        after, trace = advance(config, tick.gains, scenario, loop, t, noise[k])
        yield loop.controller, [*desired(t), trace.y, loop.tau], after.controller, trace.out
        loop = after


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
