"""Every number of scenarios, ticks, joints and devices, with every observer, controller and scheme.

A few small programs of each entry point, in which every observer, controller and scheme but the filter, and both ends of
the other axes occur: those of ``simulate`` by default, the others among the thorough tests. With ``-m slow`` each entry
point goes through all of them. In float32, as the library runs.
The gradient of the cascade takes longest to compile: ``test_tuning_gradients.py`` has it in batches of 8,
``test_lower_bounds.py`` of 16; seven joints are in ``test_robot_doors.py``.
"""

import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxftc
from jaxftc.campaigns.run import replay
from jaxftc.config import CONTROLS, OBSERVERS
from jaxftc.scenarios.faults import Actuator
from jaxftc.scenarios.scenario import take
from jaxftc.variants import SCHEMES
from tests import grid
from tests.grid import Row
from tuning import OBJECTIVE, Problem

# Rows with the same joints, ticks, count and scheme are one program, and those of a campaign whatever their count is.
SIMULATE = [
    Row(2, 50, 4096, observer="pi", control="smc"),
    Row(2, 50, 4096, observer="eso", control="esmc"),
    Row(2, 50, 4096, observer="eso_printed", control="smc"),
    Row(2, 50, 4096, observer="ts", control="afesmc"),
    Row(3, 50, 1, "computed_torque"),
]
LARGER_SIMULATE = [
    *(Row(3, 500, count) for count in (1, 2, 3, 7, 8, 16, 255, 256, 257, 1000)),
    *(Row(joints, 1000, 64) for joints in (4, 5, 6, 7)),
    *(Row(2, 5000, 2, scheme) for scheme in SCHEMES),
    *(Row(0, 1000, 33, "cascade", observer, control) for observer in OBSERVERS for control in CONTROLS),
    *(Row(0, 5000, 8, scheme) for scheme in SCHEMES),
    Row(0, 250, 4096),
]
CAMPAIGN = [
    Row(2, 50, 1, observer="pi", control="smc"),
    Row(2, 50, 255, observer="eso", control="esmc"),
    Row(2, 50, 256, observer="eso_printed", control="smc"),
    Row(2, 50, 4096, observer="ts", control="afesmc"),
    Row(2, 5000, 2, "momentum"),
]
LARGER_CAMPAIGN = [
    Row(2, 50, 257, "computed_torque"),
    *(Row(joints, 1000, 257) for joints in (3, 4, 5, 6, 7)),
    Row(2, 5000, 2, "ekf"),
    *(Row(0, 1000, 300, "cascade", observer, control) for observer in OBSERVERS for control in CONTROLS),
    *(Row(0, 5000, 16, scheme) for scheme in SCHEMES),
    Row(0, 500, 4096),
]
FIT = [Row(2, 50, 16, "computed_torque")]
LARGER_FIT = [
    *(Row(2, 50, count) for count in (1, 8, 16)),
    *(Row(3, 200, count) for count in (2, 3, 4, 7, 8, 16, 32, 64, 256)),
    *(Row(joints, 200, count) for joints in (4, 5, 6, 7) for count in (8, 16)),
    *(Row(3, 200, 8, scheme) for scheme in SCHEMES if scheme != "cascade"),
    *(Row(2, 50, 8, "cascade", observer, control) for observer in OBSERVERS for control in CONTROLS),
    Row(2, 50, 4096),
    Row(2, 5000, 1),
    Row(0, 1000, 8),
    Row(0, 1000, 16, observer="eso", control="esmc"),
    Row(0, 5000, 4, "computed_torque"),
    Row(0, 500, 64, "momentum"),
    Row(0, 200, 8, "ekf"),
]

AGREE = 500  # ticks for which two programs tell the same of a run
LATE = 3  # ticks by which an alarm may come sooner in one of them; from there on the two runs are no longer the same
SHARE = 1e-2  # of what a signal reaches, by which rounding may move it
TORQUES = ("tau", "fault_tau_hat", "residual_tau", "statistic_tau")
# Of a campaign's columns, those that are numbers in every row.
NUMBERS = ["healthy_ratio", "fault_tau_rmse_nm", "fault_q_rmse_deg", "tracking_rmse_deg", "tracking_max_deg", "effort"]
NUMBERS += [
    "tracking_ise_deg2s",
    "tracking_iae_degs",
    "tracking_itae_degs2",
    "peak",
    "saturated_share",
    "chattering",
    "rough",
]


@pytest.fixture(autouse=True)
def float32():
    with jax.enable_x64(False):
        yield


def through(rows, larger=()):
    return pytest.mark.parametrize("row", [*rows, *(pytest.param(row, marks=pytest.mark.slow) for row in larger)], ids=str)


def assert_finite(tree):
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        assert np.isfinite(np.asarray(leaf, float)).all(), jax.tree_util.keystr(path)


def assert_close(tree, like, share=SHARE, floor=1e-6):
    """Equal but for rounding that the loop has carried on: a small share of what a signal reaches."""
    for (path, a), b in zip(jax.tree_util.tree_leaves_with_path(tree), jax.tree.leaves(like), strict=True):
        a, b = np.asarray(a, float), np.asarray(b, float)
        reach = np.abs(b[np.isfinite(b)]).max(initial=0.0)
        np.testing.assert_allclose(a, b, rtol=0, atol=share * reach + floor, err_msg=jax.tree_util.keystr(path))


def assert_same_run(trace, like):
    """Two programs' traces of one run: equal but for rounding up to the first alarm that one of them has sooner.

    In a run without a fault torque estimates and the sliding variable are next to nothing, noise of readings whose last bits
    differ. They are held against a fifth of the command, and a twentieth of the speed, where those are more.
    """
    cut = lambda run: jax.tree.map(lambda leaf: np.asarray(leaf, float)[:AGREE], watched(run))  # noqa: E731
    one, other = cut(trace), cut(like)
    alarms = [(run.out["verdict"] > 0).any(1) | (run.out["detected"] > 0) for run in (one, other)]
    differ = (one.out["verdict"] != other.out["verdict"]) | (one.out["detected"] != other.out["detected"])[:, None]
    same = int(differ.any(1).argmax()) if differ.any() else len(differ)
    first = [int(up.argmax()) if up.any() else len(up) for up in alarms]
    assert abs(first[0] - first[1]) <= LATE, first
    least = {name: SHARE * 0.2 * np.abs(other.out["tau"]).max() for name in TORQUES}
    least["s"] = SHARE * 0.05 * np.abs(other.qd).max()
    one, other = (jax.tree.map(lambda leaf: leaf[:same], run) for run in (one, other))
    for name, floor in least.items():
        assert_close({name: one.out[name]}, {name: other.out[name]}, floor=floor)
    assert_close(*(run._replace(out={k: v for k, v in run.out.items() if k not in least}) for run in (one, other)))


def test_the_rows_cover_every_value_of_every_axis():
    for small, larger in ((SIMULATE, LARGER_SIMULATE), (CAMPAIGN, LARGER_CAMPAIGN), (FIT, LARGER_FIT)):
        rows = small + larger
        cascade = [row for row in rows if row.scheme == "cascade"]
        assert {row.joints for row in rows} == {0, *range(2, 8)}
        assert {row.scheme for row in rows} == set(SCHEMES)
        assert {row.observer for row in cascade} >= set(OBSERVERS) and {row.control for row in cascade} == set(CONTROLS)
        assert {1, 4096} <= {row.count for row in rows} and {50, 5000} <= {row.ticks for row in rows}
    default = [row for rows in (SIMULATE, CAMPAIGN, FIT) for row in rows]
    assert {row.scheme for row in default} == set(SCHEMES) - {"ekf"} and {8, 16} <= {row.count for row in FIT + LARGER_FIT}
    assert {row.observer for row in default} == {*OBSERVERS, "eso_printed"} and {row.control for row in default} == set(
        CONTROLS
    )


@through(SIMULATE, LARGER_SIMULATE)
def test_simulate(row):
    """Each run is finite, and what it is by itself.

    But for motors that are stuck at a torque on arms of seven hinges: nothing holds such a joint, and it has no end stops.
    """
    trace = grid.simulate(row)
    assert trace.t.shape == (row.count, row.ticks) and trace.q.dtype == np.float32
    assert trace.q.shape == trace.out.tau.shape == (row.count, row.ticks, grid.config(row).n)
    held = row.joints < 7 or ~np.any(np.asarray(grid.scenarios(row).fault_tau.kind) == Actuator.STUCK, axis=-1)
    assert_finite(jax.tree.map(lambda leaf: np.asarray(leaf)[held], watched(trace)))
    alone = grid.simulate(row, take(grid.scenarios(row), row.count - 1))
    assert_same_run(jax.tree.map(lambda leaf: leaf[-1], trace), alone)


def watched(trace):
    """A trace without thresholds: that of a channel which a scheme does not watch is infinite."""
    return trace._replace(out={k: v for k, v in trace.out._asdict().items() if not k.startswith("threshold")})


@pytest.mark.thorough
@through(CAMPAIGN, LARGER_CAMPAIGN)
def test_campaign(row):
    """Each row is that of a replay and of a campaign of other scenarios, to the bit.

    No run diverges but by a motor that is stuck at a torque: nothing holds that joint, and it has no end stops.
    """
    rows = grid.campaign(row)
    assert all(column.shape == (row.count,) for column in rows.values())
    assert set(rows["fault_tau"][rows["diverged"]]) <= {"stuck"} and rows["diverged"].mean() < 0.05
    assert_finite({name: rows[name][~rows["diverged"]] for name in NUMBERS})
    np.testing.assert_array_equal(rows["scenario_id"], np.arange(row.count))
    last, settings = row.count - 1, grid.config(row)
    again, trace = replay(settings, jaxftc.default_gains(settings), take(grid.scenarios(row), last), grid.key())
    part = grid.campaign(row._replace(count=row.count - row.count // 2), row.count // 2)
    for name, column in rows.items():
        np.testing.assert_array_equal(column[last:], again[name], err_msg=name)
        np.testing.assert_array_equal(column[row.count // 2 :], part[name], err_msg=name)
    assert trace.q.shape == (row.ticks, settings.n)
    assert_finite(watched(trace))


@pytest.mark.thorough
@through([row for row in CAMPAIGN if row.count > 1], [row for row in LARGER_CAMPAIGN if row.observer == "ts"])
def test_calibrate(row):
    found = grid.calibrate(row)
    assert (found.runs, found.fresh) == ((row.count + 1) // 2, row.count // 2)
    assert_finite(found.gains)
    for level in (found.gains.diagnosis.alpha_tau, found.gains.diagnosis.alpha_q):
        assert level.shape == (grid.config(row).n,) and level.dtype == np.float32 and (level > 0).all()
    assert 0 <= found.reached.low <= found.reached.value <= found.reached.high <= 1


def test_below_one_scenario_it_is_told():
    """No scenario at all, and one where thresholds need another to be checked on."""
    none = Row(2, 50, 0)
    with pytest.raises(ValueError, match="scenarios must be at least one, got none"):
        grid.campaign(none)
    with pytest.raises(ValueError, match="scenarios must be at least one, got none"):
        grid.calibrate(none)
    with pytest.raises(ValueError, match=r"1 healthy run is too few: .* give at least 2"):
        grid.calibrate(none._replace(count=1))


@pytest.mark.thorough
@through(FIT, LARGER_FIT)
def test_fit(row):
    """Two steps that move the gains."""
    found = grid.fit(row)
    assert found.stopped == "all steps done" and found.history["step"].tolist() == [2]
    assert_finite((found.gains, found.history))
    assert found.history["gradient_norm"] > 0
    start, some = jaxftc.default_gains(grid.config(row)), grid.scenarios(row)
    assert jax.tree.map(np.shape, found.gains) == jax.tree.map(np.shape, start)
    terms = Problem(grid.config(row), OBJECTIVE, grid.key(), row.count).scores(start, some)
    assert terms.shape == (len(OBJECTIVE), row.count)
    assert_finite(terms)


@pytest.mark.thorough
def test_a_run_counts_the_same_in_batches_of_any_size():
    some, start = grid.scenarios(FIT[-1]), jaxftc.default_gains(grid.config(FIT[-1]))
    one, other = (Problem(grid.config(FIT[-1]), OBJECTIVE, grid.key(), batch).scores(start, some) for batch in (8, 16))
    np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-6)


@pytest.mark.thorough
@through([FIT[0]], [Row(2, 50, 8), Row(3, 200, 16, "momentum")])
def test_two_devices_give_what_one_gives(row, tmp_path):
    """A campaign and thresholds to the bit; what is spread over devices, but for rounding. By default the campaign alone."""
    whole = row != FIT[0]
    path, program = tmp_path / "results.npz", "from tests import grid; grid.main()"
    command = [sys.executable, "-c", program, str(path), str(whole), *map(str, row)]
    environment = os.environ | {"JAX_PLATFORMS": "cpu", "JAX_NUM_CPU_DEVICES": "2"}
    subprocess.run(command, check=True, cwd=Path(__file__).parents[2], env=environment)
    one = grid.everything(row, whole)
    with np.load(path) as two:
        assert set(two) == set(one)
        for name, leaf in one.items():
            if name.startswith(("['rows']", "['calibrated']")):
                np.testing.assert_array_equal(two[name], leaf, err_msg=name)
            elif not name.endswith("['seconds']"):
                floor = 1e-4 if "['history']" in name else 1e-6  # terms and norms, unit-free, in float32
                assert_close({name: two[name]}, {name: leaf}, floor=floor)
