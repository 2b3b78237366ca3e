"""The learned decision against the rule, on the same runs: ``python -m benchmarks.decisions puma560 --seeds 91 301``.

An arm is ``puma560``, a robot file, or ``random:K`` of ``tuning/random_arms.py``, of which training has those from 0 on.
Gains are the defaults, thresholds those for 1 % of healthy runs with an alarm. Motion and first alarms of the two are the
same, so what was said of the faults that the rule detected is compared. What the network alone misses counts as wrong.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import jax
import numpy as np

import jaxftc
from jaxftc.evaluation.intervals import bootstrap
from jaxftc.robot.arm_file import read_robot
from tuning.random_arms import random_arm

HEALTHY = 2048  # runs that thresholds are set on and checked on, half each
COLUMNS = ("kind_right", "joint_right", "verdict_right")


def arm(name: str) -> jaxftc.Robot:
    """The arm of a name; one without motor inertia or friction gets some, as faults would throw it about."""
    if name == "puma560":
        return jaxftc.puma560()
    if name.startswith("random:"):
        return random_arm(int(name.removeprefix("random:")))
    robot = read_robot(name)
    if not robot.frictionless:
        return robot
    limit = np.where(np.isfinite(robot.torque_limit), robot.torque_limit, 50.0)
    friction = {"coulomb_positive": 0.06 * limit, "coulomb_negative": 0.05 * limit}
    damping = {f"damping_{way}": 0.03 * limit for way in ("positive", "negative")}
    return robot.replace(armature=np.maximum(0.7 * robot.inertia_diagonal, 0.1), torque_limit=limit, **friction, **damping)


def compare(config: jaxftc.Config, preset: str, seed: int, n: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Kinds of the faults that were detected, and whether each was named rightly: [2, faults], rule and network."""
    keys = jax.random.split(jax.random.key(seed), 4)
    healthy = jaxftc.sample_scenarios(keys[0], HEALTHY, preset, config=config)
    learned = jaxftc.calibrate(config, jaxftc.default_gains(config), healthy, keys[1]).gains
    rule = learned.replace({"decision.last": 0.0, "decision.last_bias": -5.0})  # names nothing: one program runs both
    scenarios = jaxftc.sample_scenarios(keys[2], n, preset, config=config)
    rows = [jaxftc.campaign(config, gains, scenarios, keys[3]) for gains in (rule, learned)]
    moved = [name for name in ("tracking_max_deg", "false_alarm") if not np.array_equal(rows[0][name], rows[1][name])]
    if moved:
        raise RuntimeError(f"the decision must not move the arm or give healthy runs alarms, but {', '.join(moved)} differs")
    found, names = rows[0]["detected"], [f"{column}{when}" for when in ("", "_settled") for column in COLUMNS]
    right = {name: np.stack([one["detected"] & (one[name] == 1) for one in rows])[:, found].astype(float) for name in names}
    return rows[0]["fault"][found], right


def main(words: Sequence[str] | None = None) -> None:
    """A line for each arm, preset and seed: shares right of the rule, and what the learned decision adds, in points."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.decisions", description=__doc__)
    parser.add_argument("arms", nargs="+", metavar="ARM")
    parser.add_argument("--presets", nargs="+", default=["standard", "hard", "doubles"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[91])
    parser.add_argument("--adaptive", action="store_true", help="the arm is learned while it runs")
    parser.add_argument("--kinds", action="store_true", help="each kind of fault as well, once settled")
    parser.add_argument("-n", type=int, default=2048, help="scenarios of each preset and seed")
    given = parser.parse_args(words)
    jaxftc.configure_xla()
    print("kind, joint, both 60 ms after the alarm | settled: rule, and learned less rule with its 95 % interval, %")
    for name in given.arms:
        config = jaxftc.Config(arm(name), engine="chain", adaptive=given.adaptive, decision="learned")
        for preset in given.presets:
            for seed in given.seeds:
                kinds, found = compare(config, preset, seed, given.n)
                cells, count = [], 0
                for pair in found.values():
                    count = len(pair[0])
                    gain = bootstrap(pair, lambda x: 100 * (x[1] - x[0]).mean(-1))
                    cells.append(f"{100 * pair[0].mean():.1f} {gain.value:+.1f} [{gain.low:+.1f}, {gain.high:+.1f}]")
                said = " | ".join(", ".join(part) for part in (cells[:3], cells[3:]))
                print(f"{name} {preset} {seed}, {count} faults: {said}", flush=True)
                for kind in np.unique(kinds) if given.kinds else ():
                    these = kinds == kind
                    pairs = [100 * found[f"{column}_settled"][:, these].mean(1) for column in COLUMNS[:2]]
                    cells = ["{:.0f} to {:.0f}".format(*pair) for pair in pairs]
                    print(f"  {kind}, {these.sum()}: kind {cells[0]}, joint {cells[1]}", flush=True)


if __name__ == "__main__":
    main()
