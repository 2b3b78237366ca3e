"""Training of the learned decision: random arms, campaigns through the closed loop, a small network.

    python -m tuning.decision --out decision.toml
    python -m tuning.decision --slower --arms 36 --out slower_decision.toml

make the weights that come with the library (in ``jaxftc/diagnosis``): for loops of 1 kHz, and for slower ones. Each arm
gets default gains and thresholds for 1 % of healthy runs with an alarm, for each preset. The runs have every kind of fault
of the presets, and all of them together, on one joint or two. What the network is shown is recorded by the function that
shows it in the tick. It is trained on moments between alarm and clearance, to say of each joint which channels are at fault;
the two moments at which campaigns score a verdict are always among them.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import tomli_w

import jaxftc
from jaxftc.compile.jit import jit
from jaxftc.decision_gains import DecisionGains
from jaxftc.diagnosis import decision_memory, decision_network, threshold
from jaxftc.diagnosis.statistics import Statistics
from jaxftc.evaluation import online
from jaxftc.evaluation.metrics import SETTLE
from jaxftc.gains import align
from jaxftc.io.files import write_text
from jaxftc.scenarios.distributions import Uniform
from jaxftc.scenarios.preset import Preset, Shares
from jaxftc.scenarios.preset_file import load_preset
from jaxftc.scenarios.sample import draw_all
from jaxftc.scenarios.scenario import Scenario, take, trail
from jaxftc.simulation import closed_loop, noise
from jaxftc.types import Array
from tuning.random_arms import random_arm

ARMS = 24  # in training; of each twelve the last six are learned while they run
SLOWER = 0.002, 0.004, 0.01  # s, sample times of slower loops, in turn; every third arm has one then
UNKNOWN = 0.3, 1.5  # times what arms differ by in the presets, drawn for each arm: thresholds are lower or higher by that
RUNS = {"standard": 512, "hard": 2048, "doubles": 512, "uncommon": 512, "mixed": 768}  # of each arm; mostly single faults
HEALTHY = 1024  # runs that thresholds are set on and checked on, half each
FALSE_ALARMS = 0.01
WIDTH = 256  # runs side by side
MOMENTS = 6  # of a run, beside the two at which a verdict is scored
LATEST = 0.45  # s after the alarm
STEPS, BATCH, RATE, DECAY = 60_000, 2048, 3e-3, 1e-4
DOUBT = np.log(0.64 / 0.36)  # log odds: a bit that is held to be set with 36 to 64 % is unsure
MARGIN = 0.1  # of the range of what was shown, by which a moment may lie outside of it


class Moments(NamedTuple):
    """What the network is shown at some moments, a row a joint, and what is right."""

    seen: np.ndarray  # [rows, inputs]
    wanted: np.ndarray  # [rows, 2] 1 where the actuator, where the encoder is at fault
    weight: np.ndarray  # [rows] 1 over the number of joints


def mixed() -> Preset:
    """Every kind of fault that there is, in all pairs, with the arms and times of ``hard``."""
    hard, rare = load_preset("hard"), load_preset("uncommon")

    def both(one: Any, other: Any) -> Any:
        lacking = [field.name for field in dataclasses.fields(one) if getattr(other, field.name) is None]
        return dataclasses.replace(other, **{name: getattr(one, name) for name in lacking})

    sensor = both(hard.sensor, rare.sensor)
    return dataclasses.replace(
        hard,
        shares=Shares(healthy=0.0, actuator=0.4, sensor=0.4, both=0.2),
        actuator=both(hard.actuator, rare.actuator),
        sensor=sensor,
        sensor_in_both=sensor,
        joints=dataclasses.replace(hard.joints, at_once=1),
    )


def differing(preset: Preset, factor: float) -> Preset:
    """The preset with arms that differ so many times as much from their model."""
    plant, wider = preset.plant, {}
    for field in dataclasses.fields(plant):
        law = getattr(plant, field.name)
        if isinstance(law, Uniform):
            usual = 0.0 if field.name == "payload_kg" else 1.0
            wider[field.name] = Uniform(
                (usual + factor * (law.uniform[0] - usual), usual + factor * (law.uniform[1] - usual))
            )
    return dataclasses.replace(preset, plant=dataclasses.replace(plant, **wider))


def moments(config: jaxftc.Config, seed: int, runs: dict[str, int]) -> list[Moments]:
    """Moments of one arm, of each preset."""
    found, program, set_for = [], _program(config), {}
    unknown = float(np.exp(np.random.default_rng([seed, 1]).uniform(*np.log(UNKNOWN))))
    for k, (name, count) in enumerate(runs.items()):
        preset = differing(mixed() if name == "mixed" else load_preset(name), unknown)
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), k), 4)
        laws = preset.motion, preset.plant, preset.encoder  # of healthy runs: presets that share them share thresholds
        if laws not in set_for:
            healthy = draw_all(preset, config, keys[0], jnp.arange(HEALTHY))
            alone = jaxftc.default_gains(dataclasses.replace(config, adaptive=False))  # faults compensated by psi alone
            gains = alone.replace({"diagnosis.lead": jaxftc.default_gains(config).diagnosis.lead})
            set_for[laws] = jaxftc.calibrate(config, gains, healthy, keys[1], false_alarms=FALSE_ALARMS).gains
        scenarios = draw_all(preset, config, keys[2], jnp.arange(count))
        for first in range(0, count, WIDTH):
            some = take(scenarios, np.arange(first, first + WIDTH) % count)
            seen, alarmed, true = jax.tree.map(np.asarray, program(set_for[laws], trail(some), keys[3]))
            found.append(_pick(config, seen, alarmed, true, np.random.default_rng([seed, k, first])))
    return found


def _program(config: jaxftc.Config) -> Any:
    """(gains, scenarios with a trailing axis, key) to what is shown [asks, inputs, n, runs], alarms [asks, runs], truth."""
    every = decision_memory.period(config)

    def run(gains: jaxftc.Gains, scenarios: Scenario, key: Array) -> tuple[Array, Array, online.Truth]:
        """Runs of a batch, asked every ``every`` ticks."""
        gains, stream = threshold.known_constant(gains), noise.streams(key, scenarios.id)
        loop = closed_loop.start(config, gains, scenarios)
        memory = decision_memory.blank(loop.q)

        def tick(loop: closed_loop.Loop, k: Array) -> tuple[closed_loop.Loop, closed_loop.Trace]:
            error = scenarios.noise * noise.normal(stream, k, config.n)
            return closed_loop.advance(config, gains, scenarios, loop, k * jnp.float32(config.dt), error)

        def ask(carry: Any, k: Array) -> tuple[Any, Any]:
            loop, memory = carry
            loop, ticks = jax.lax.scan(tick, loop, every * k + jnp.arange(every))
            out = jax.tree.map(lambda leaf: leaf[-1], ticks.out)
            inputs, own = _inputs(loop.controller, out), align(gains, 1)
            memory, now = decision_memory.remember(config, own, memory, inputs)
            seen = decision_network.shown(config, own, memory, now, inputs)
            return (loop, memory), (seen.astype(jnp.float16), out.detected)

        _, (seen, alarmed) = jax.lax.scan(ask, (loop, memory), jnp.arange(config.ticks // every))
        return seen, alarmed, online.truth(config, scenarios)

    return jit(run)


def _inputs(state: Any, out: jaxftc.Output) -> decision_memory.Inputs:
    """What the decision took in, of the state after a tick and what that said."""
    return decision_memory.Inputs(
        statistics=Statistics(out.statistic_tau, out.statistic_q),
        threshold_tau=out.threshold_tau,
        residual_tau=out.residual_tau,
        e=state.observer.e,
        absent=jnp.zeros(out.suspect.shape, bool),
        alarm=state.decision.alarm,
        check=state.decision.check,
        suspect=out.suspect,
        verdict=out.verdict,
    )


def _pick(
    config: jaxftc.Config, seen: np.ndarray, alarmed: np.ndarray, true: online.Truth, random: np.random.Generator
) -> Moments:
    """Moments of the runs that raised an alarm in time."""
    step = decision_memory.period(config) * config.dt
    t = config.dt * (decision_memory.period(config) - 1) + step * np.arange(len(seen))  # s, at which it was asked
    last = np.minimum(true.clear, t[-1])
    up = alarmed & (t[:, None] >= true.onset) & (t[:, None] <= last) & ~true.healthy
    runs = np.flatnonzero(up.any(0) & np.isfinite(seen).all((0, 1, 2)))
    alarm, last = t[up.argmax(0)[runs]], last[runs]
    end = np.maximum(alarm, np.minimum(alarm + LATEST, last))
    scored = [np.minimum(alarm + SETTLE, t[-1]), np.maximum(alarm, np.minimum(alarm + online.SETTLED, last))]
    times = [*scored, *(alarm + random.uniform(size=len(runs)) * (end - alarm) for _ in range(MOMENTS))]
    rows = [np.moveaxis(seen[np.searchsorted(t, at + 1e-6) - 1, :, :, runs], 1, 2) for at in times]  # [runs, n, inputs]
    wanted = np.stack([true.wanted[:, runs] & 1, true.wanted[:, runs] >> 1 & 1], -1).swapaxes(0, 1)  # [runs, n, 2]
    flat = lambda parts: np.concatenate([part.reshape(-1, part.shape[-1]) for part in parts])  # noqa: E731
    right = flat([wanted] * len(times)).astype(np.float32)
    return Moments(flat(rows), right, np.full(len(right), 1 / config.n, np.float32))


def train(parts: Sequence[Moments], seed: int = 0, steps: int = STEPS) -> tuple[DecisionGains, float]:
    """Weights, and the mean loss of the last tenth of the steps."""
    data = Moments(*(np.concatenate(leaves) for leaves in zip(*parts, strict=True)))
    weights = _start(data, seed)
    fixed = {name: getattr(weights, name) for name in ("centre", "width", "low", "high", "doubt")}
    layers = {f.name: getattr(weights, f.name) for f in dataclasses.fields(weights) if f.name not in fixed}
    optimiser = optax.adamw(optax.cosine_decay_schedule(RATE, steps), weight_decay=DECAY)

    def loss(layers: dict[str, Array], some: Moments) -> Array:
        seen = jnp.asarray(some.seen.T, jnp.float32)[:, None]
        said = decision_network.logits(DecisionGains(**fixed, **layers), seen)[:, 0]
        wrong = optax.sigmoid_binary_cross_entropy(said, some.wanted.T).sum(0)
        return (wrong * some.weight).sum() / some.weight.sum()

    @jax.jit
    def step(layers: dict[str, Array], state: Any, some: Moments) -> tuple[Any, ...]:
        value, slope = jax.value_and_grad(loss)(layers, some)
        change, state = optimiser.update(slope, state, layers)
        return optax.apply_updates(layers, change), state, value

    state, random, losses = optimiser.init(layers), np.random.default_rng(seed), []
    for _ in range(steps):
        rows = random.integers(0, len(data.seen), BATCH)
        layers, state, value = step(layers, state, Moments(*(leaf[rows] for leaf in data)))
        losses.append(value)
    return DecisionGains(**fixed, **layers), float(np.mean(losses[-max(1, steps // 10) :]))


def _start(data: Moments, seed: int) -> DecisionGains:
    """Random layers, and the centre, width and range of what is shown."""
    seen = data.seen.astype(np.float32)
    low, high = seen.min(0), seen.max(0)
    room = MARGIN * (high - low) + 1e-3
    found: dict[str, Any] = {"centre": seen.mean(0), "width": seen.std(0) + 0.05, "low": low - room, "high": high + room}
    found["doubt"] = np.array([DOUBT])
    keys = jax.random.split(jax.random.key(seed), len(dataclasses.fields(DecisionGains)))
    for key, field in zip(keys, dataclasses.fields(DecisionGains), strict=True):
        size = tuple(int(axis) for axis in field.metadata["spec"].axes)
        drawn = jax.random.normal(key, size) * np.sqrt(1.5 / size[0]) if len(size) == 2 else jnp.zeros(size)
        found.setdefault(field.name, drawn)
    return DecisionGains(**{name: jnp.asarray(value) for name, value in found.items()})


def as_toml(weights: DecisionGains) -> str:
    """The weights as a gains file has them, to five digits."""
    short = np.vectorize(lambda x: float(f"{x:.5g}"))
    table = {
        field.name: {"unit": field.metadata["spec"].unit, "value": short(np.asarray(getattr(weights, field.name))).tolist()}
        for field in dataclasses.fields(weights)
    }
    return "# Weights of the learned decision, made by python -m tuning.decision\n" + tomli_w.dumps({"decision": table})


def collect(arms: Sequence[int], seed: int, runs: dict[str, int], *, slower: bool = False) -> list[Moments]:
    """Moments of random arms, two arms at a time, in loops of 1 kHz, or some of them in ``slower`` ones.

    An arm whose healthy runs raise alarms whatever the thresholds is left out: nobody would run it like that.
    """
    began = time.perf_counter()

    def one(k: int) -> list[Moments]:
        dt = SLOWER[k // 3 % len(SLOWER)] if slower and k % 3 == 2 else 1e-3
        config = jaxftc.Config(random_arm(arms[k]), dt=dt, engine="chain", adaptive=k // 6 % 2 == 1)
        said = f"arm {arms[k]}, {config.n} joints, {1e3 * dt:g} ms"
        try:
            found = moments(config, seed * 1000 + arms[k], runs)
        except ValueError as error:
            print(f"{said}, left out: {error}", flush=True)
            return []
        said += f": {sum(len(part.seen) for part in found) // config.n} moments"
        print(f"{said}, {time.perf_counter() - began:.0f} s", flush=True)
        return found

    with ThreadPoolExecutor(2) as pool:
        return [part for parts in pool.map(one, range(len(arms))) for part in parts]


def main(words: Sequence[str] | None = None) -> None:
    """Collect, train, write."""
    parser = argparse.ArgumentParser(prog="python -m tuning.decision", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("decision.toml"), help="file for the weights")
    parser.add_argument(
        "--arms",
        type=int,
        default=ARMS,
        help="number of random arms; of each twelve the last six are learned while they run",
    )
    parser.add_argument("--slower", action="store_true", help=f"every third arm at {SLOWER} s in turn, not 0.001 s")
    parser.add_argument("--steps", type=int, default=STEPS, help="steps of training")
    parser.add_argument("--seed", type=int, default=0, help="of arms, runs and training")
    given = parser.parse_args(words)
    jaxftc.configure_xla()
    parts = collect(range(100 * given.seed, 100 * given.seed + given.arms), given.seed, RUNS, slower=given.slower)
    weights, loss = train(parts, given.seed, given.steps)
    write_text(given.out, as_toml(weights))
    print(f"loss {loss:.4f}; written to {given.out}")


if __name__ == "__main__":
    main()
