"""The runs whose numbers are kept in ``numbers.npz``: every scheme, the rows of a campaign, the gains of a tune.

Make them anew only for a change that is meant to change numbers, and say so in the changelog::

    python -m tests.golden.runs
"""

import dataclasses
from pathlib import Path

import jax
import numpy as np

import jaxftc
from tests.arms import three_hinges

FILE = Path(__file__).with_name("numbers.npz")
SCHEMES = {
    "afesmc": {},
    "compensated": {},
    "esmc": {"control": "esmc"},
    "smc": {"control": "smc"},
    "eso": {"observer": "eso"},
    "printed": {"observer": "eso_printed"},
    "pi": {"observer": "pi"},
    "hard": {"sign": "hard"},
    "torque": {"input": "torque"},
    "computed_torque": {"scheme": "computed_torque"},
    "momentum": {"scheme": "momentum"},
    "ekf": {"scheme": "ekf"},
}
GAINS = {"compensated": {"control.rate": 150.0, "control.speed_weight": 0.08}}  # beside the defaults
EVERY = 7  # th tick of a trace is kept


def config() -> jaxftc.Config:
    """A small arm; a run long enough for a fault and its verdict."""
    return jaxftc.Config(three_hinges(), engine="chain", t_final=0.06)


def traces(name: str) -> dict[str, np.ndarray]:
    """A run of a scheme in which both channels of two joints become faulty."""
    own = dataclasses.replace(config(), **SCHEMES[name])
    scenario = jaxftc.paper_scenario("both", own)
    early = [fault._replace(onset=0.02 + 0.0 * fault.onset) for fault in (scenario.fault_tau, scenario.fault_q)]
    scenario = scenario._replace(fault_tau=early[0], fault_q=early[1])
    gains = jaxftc.default_gains(own).replace(GAINS.get(name, {}))
    trace = jaxftc.simulate(own, gains, scenario, jax.random.key(0))
    found = {key: value for key, value in trace._asdict().items() if key != "out"} | trace.out._asdict()
    return {key: np.asarray(value)[::EVERY] for key, value in found.items()}


def rows() -> dict[str, np.ndarray]:
    """Rows of a campaign of the preset ``standard``."""
    own = config()
    scenarios = jaxftc.sample_scenarios(jax.random.key(1), 6, config=own)
    return jaxftc.campaign(own, jaxftc.default_gains(own), scenarios, jax.random.key(2))


def tuned() -> dict[str, np.ndarray]:
    """All gains after two steps."""
    import tuning

    own = config()
    scenarios = jaxftc.sample_scenarios(jax.random.key(3), 8, config=own)
    settings = tuning.Settings(steps=2, batch=2)
    result = tuning.fit(own, jaxftc.default_gains(own), scenarios, key=jax.random.key(4), settings=settings)
    leaves = jax.tree_util.tree_leaves_with_path(result.gains)
    return {jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in leaves}


def every() -> dict[str, np.ndarray]:
    """All numbers by their names in the file."""
    parts = {f"traces.{name}": traces(name) for name in SCHEMES} | {"rows": rows(), "tuned": tuned()}
    return {f"{part}/{key}": value for part, numbers in parts.items() for key, value in numbers.items()}


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    np.savez_compressed(FILE, **every())
