"""Runs of every size: what the tests of the grid go through, in their process or in one with more devices."""

import functools
import sys
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

import jaxftc
from benchmarks import arms
from jaxftc.campaigns.calibrate import Calibration
from jaxftc.campaigns.calibrate import calibrate as calibrate_on
from jaxftc.campaigns.run import campaign as campaign_of
from jaxftc.compile.devices import AXIS
from jaxftc.robot.model_file import compile_robot
from jaxftc.scenarios.scenario import Scenario, take
from jaxftc.simulation.closed_loop import Trace
from tuning import Result, Settings
from tuning import fit as fit_to

VALIDATION = 4
MOST = 4096 + VALIDATION  # scenarios of any row


class Row(NamedTuple):
    """One place in the grid."""

    joints: int  # of an arm of hinges; 0 is the built-in arm
    ticks: int
    count: int  # scenarios
    scheme: str = "cascade"
    observer: str = "ts"
    control: str = "afesmc"

    def __str__(self) -> str:
        kind = f"{self.observer}-{self.control}" if self.scheme == "cascade" else self.scheme
        return f"{kind}-{self.joints or 'puma'}-{self.ticks}-{self.count}"


@functools.cache
def arm(joints: int) -> jaxftc.Robot:
    return compile_robot(f"{joints} hinges", arms.serial(joints)) if joints else jaxftc.puma560()


def config(row: Row) -> jaxftc.Config:
    stages = {"scheme": row.scheme, "observer": row.observer, "control": row.control}
    return jaxftc.Config(arm(row.joints), engine="chain", t_final=1e-3 * row.ticks, **stages)


def key() -> jax.Array:
    return jax.random.key(7)


@functools.cache
def _drawn(joints: int, x64: bool) -> Scenario:
    settings = jaxftc.Config(arm(joints), engine="chain")
    return take(jaxftc.sample_scenarios(jax.random.key(3), MOST, config=settings), slice(None))


def scenarios(row: Row, first: int = 0) -> Scenario:
    """As many as the row says, with a leading axis; faults come and go as early as the run is short."""
    some = take(_drawn(row.joints, jax.config.read("jax_enable_x64")), slice(first, first + row.count))

    def sooner(fault: Any) -> Any:
        times = {name: getattr(fault, name) * np.float32(1e-3 * row.ticks) for name in ("onset", "clear", "period")}
        return fault._replace(**times)

    return some._replace(fault_tau=sooner(some.fault_tau), fault_q=sooner(some.fault_q))


def simulate(row: Row, some: Scenario | None = None) -> Trace:
    """A set of scenarios, or a single one; those of the row if none are given."""
    settings = config(row)
    return jaxftc.simulate(settings, jaxftc.default_gains(settings), scenarios(row) if some is None else some, key())


def campaign(row: Row, first: int = 0) -> dict[str, np.ndarray]:
    settings = config(row)
    return campaign_of(settings, jaxftc.default_gains(settings), scenarios(row, first), key())


def calibrate(row: Row) -> Calibration:
    """Thresholds that half of the runs may pass, so that two runs are enough."""
    settings = config(row)
    gains = jaxftc.default_gains(settings)
    return calibrate_on(settings, gains, scenarios(row), key(), false_alarms=0.5, confidence=0.5)


def fit(row: Row) -> Result:
    """Two gradient steps on batches of ``count`` scenarios; plain ones, which are as smooth as the gradient."""
    settings = config(row)
    return fit_to(
        settings,
        jaxftc.default_gains(settings),
        scenarios(row),
        key=key(),
        validation=scenarios(row._replace(count=VALIDATION), row.count),
        settings=Settings(steps=2, batch=row.count, validation=VALIDATION, optimizer="sgd", patience=1.0),
    )


def everything(row: Row, whole: bool) -> dict[str, np.ndarray]:
    """Results by name: a campaign's, or those of every entry point; a simulation, only of the cascade, over all devices."""
    tree: dict[str, Any] = {"rows": campaign(row)}
    if whole:
        fitted = fit(row)
        tree |= {"calibrated": calibrate(row).gains, "fitted": {"gains": fitted.gains, "history": fitted.history}}
    if whole and row.scheme == "cascade":
        mesh = Mesh(np.asarray(jax.local_devices()), (AXIS,))
        some = jax.device_put(scenarios(row), NamedSharding(mesh, PartitionSpec(AXIS)))
        tree["trace"] = simulate(row, some)
        assert len(tree["trace"].q.sharding.device_set) == len(jax.local_devices())
    return {jax.tree_util.keystr(at): np.asarray(leaf) for at, leaf in jax.tree_util.tree_leaves_with_path(tree)}


def main() -> None:
    """``python -c ... PATH WHOLE ROW``, in a process of its own with two devices: all results of the row as an .npz file."""
    path, whole, *fields = sys.argv[1:]
    assert len(jax.local_devices()) == 2
    np.savez(path, **everything(Row(*map(int, fields[:3]), *fields[3:]), whole == "True"))
