"""What healthy arms show of torque faults, joint by joint, with the model as it is and with an arm that is learned.

``python -m benchmarks.healthy_spread [GAINS]`` prints a table for ``standard`` and ``hard``: quantiles over runs of the
largest torque residual and statistic of each joint, after SETTLED s, and of the tracking error. No thresholds are set: the
same gains run in both columns.
"""

from __future__ import annotations

import dataclasses
import sys

import jax
import numpy as np

import jaxftc
from jaxftc.campaigns.calibrate import without_faults
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.scenarios.scenario import take

RUNS, SIDE_BY_SIDE, SEED = 1024, 256, 77
SETTLED = 0.1  # s, the first onset of the presets
QUANTILES = (0.5, 0.95, 0.99)


def spread(config: Config, gains: Gains, preset: str) -> dict[str, np.ndarray]:
    """Quantiles over healthy runs: [QUANTILES, n] of residual and statistic in N m, and of the tracking rms in deg."""
    key, noise = jax.random.split(jax.random.key(SEED))
    scenarios = without_faults(jaxftc.sample_scenarios(key, RUNS, preset, config=config))
    first, found = round(SETTLED / config.dt), {"residual": [], "statistic": [], "tracking": []}
    for start in range(0, RUNS, SIDE_BY_SIDE):
        trace = jaxftc.simulate(config, gains, take(scenarios, slice(start, start + SIDE_BY_SIDE)), noise)
        found["residual"].append(np.abs(trace.out.residual_tau[:, first:]).max(1))
        found["statistic"].append(np.abs(trace.out.statistic_tau[:, first:]).max(1))
        found["tracking"].append(np.rad2deg(np.sqrt(((trace.q - trace.q_ref) ** 2).mean(1))))
    return {name: np.quantile(np.concatenate(parts), QUANTILES, axis=0) for name, parts in found.items()}


def main(path: str | None) -> None:
    """Print the table."""
    config = Config(jaxftc.puma560(), engine="chain")
    gains = jaxftc.default_gains(config) if path is None else jaxftc.load_gains(path, config)
    for preset in ("standard", "hard"):
        both = [spread(dataclasses.replace(config, adaptive=on), gains, preset) for on in (False, True)]
        for name in both[0]:
            for k, quantile in enumerate(QUANTILES):
                cells = [" ".join(f"{value:8.3f}" for value in found[name][k]) for found in both]
                print(f"{preset:9} {name:10} {quantile:4} {cells[0]}  ->  {cells[1]}", flush=True)


if __name__ == "__main__":
    jaxftc.configure_xla()
    main(sys.argv[1] if len(sys.argv) > 1 else None)
