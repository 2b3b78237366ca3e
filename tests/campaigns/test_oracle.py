"""What nobody could see: the oracle on made-up faults, and ceilings beside shares."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc.campaigns import run
from jaxftc.evaluation import comparison, oracle, summary, verdicts
from jaxftc.evaluation.table import columns
from jaxftc.simulation.closed_loop import blank_trace
from tests.arms import two_hinges

DT, N, TICKS = 1e-3, 3, 100


def seen(fault_tau, fault_q, until, until_late, y=None, contact_tau=None, wanted=(0, 0, 0)):
    """What an oracle has seen of one run [TICKS, N], thresholds 2 N m and 0.1 rad."""
    contact_tau = 0 * fault_tau if contact_tau is None else contact_tau
    level = jnp.ones((N,))
    blank = blank_trace()
    out = blank.out._replace(threshold_tau=2.0 * level, threshold_q=0.1 * level)
    sight = oracle.init(level)
    y = np.zeros((TICKS, N)) if y is None else y
    for k in range(TICKS):
        signals = {"fault_tau": fault_tau[k], "fault_q": fault_q[k], "contact_tau": contact_tau[k], "y": y[k]}
        tick = blank._replace(t=jnp.asarray(k * DT), out=out, **{name: jnp.asarray(x) for name, x in signals.items()})
        sight = oracle.step(sight, tick, jnp.asarray(wanted, jnp.int32), until, until_late)
    return jax.tree.map(np.asarray, sight)


def test_a_fault_is_visible_once_it_is_as_large_as_its_threshold_and_is_not_forgotten():
    tau, q = np.zeros((2, TICKS, N))
    tau[10:30, 0], tau[30:40, 0] = 1.99, 2.0
    tau[10:, 1] = -1.99
    q[50:, 2] = -0.1
    found = seen(tau, q, until=0.045, until_late=0.08)
    assert found.at == pytest.approx(0.030)
    np.testing.assert_array_equal(found.early, [1, 0, 0])
    np.testing.assert_array_equal(found.late, [1, 0, 2])
    never = seen(0.9 * tau / 1.5, 0.9 * q, np.inf, np.inf)
    assert np.isinf(never.at) and not never.early.any() and not never.late.any()


def test_a_contact_that_one_joint_shows_is_known_of_all_that_bear_it():
    none, pushed = np.zeros((TICKS, N)), np.zeros((TICKS, N))
    pushed[20:, 0], pushed[60:, 1] = 1.99, -2.0
    found = seen(none, none, 0.07, 0.08, contact_tau=pushed, wanted=(8, 8, 0))
    assert found.at == pytest.approx(0.060)
    np.testing.assert_array_equal([found.early, found.late], [[8, 8, 0]] * 2)


def test_a_reading_that_is_absent_is_visible():
    none, y = np.zeros((TICKS, N)), np.zeros((TICKS, N))
    y[20:, 1] = np.nan
    found = seen(none, none, np.inf, np.inf, y)
    assert found.at == pytest.approx(0.020)
    np.testing.assert_array_equal(found.early, [0, 2, 0])


@pytest.fixture(scope="module")
def rows():
    config = jaxftc.Config(two_hinges(), engine="chain", duration=0.4)
    gains = jaxftc.default_gains(config)
    scenarios = jaxftc.sample_scenarios(jax.random.key(5), 200, "hard", config=config)
    scores = run.scores(config, gains, scenarios, jax.random.key(6))
    return columns(config, scenarios, scores), scores, gains, config, scenarios


@pytest.mark.thorough
def test_an_oracle_names_no_healthy_joint_and_sees_no_less_with_lower_thresholds(rows):
    table, scores, gains, config, scenarios = rows
    wanted = np.asarray((scenarios.fault_tau.kind > 0) + 2 * (scenarios.fault_q.kind > 0)).T
    assert (np.asarray(scores.visible) & ~wanted == 0).all() and (np.asarray(scores.visible_late) & ~wanted == 0).all()
    healthy = table["kind"] == "normal"
    assert np.isnan(table["visible_s"][healthy]).all() and np.isnan(table["complete_s"][healthy]).all()
    assert table["joint_visible"][healthy].all(), "it sees that nothing is wrong"
    lower = gains.replace({"diagnosis.alpha_tau": 0.5 * gains.diagnosis.alpha_tau})
    sooner = columns(config, scenarios, run.scores(config, lower, scenarios, jax.random.key(6)))["visible_s"]
    assert (sooner[~healthy] <= table["visible_s"][~healthy] + 1e-9).all() and (sooner < table["visible_s"]).any()


def test_all_is_told_no_sooner_than_the_first_alarm_and_no_later_than_it_is_isolated(rows):
    table = rows[0]
    clean = (table["kind"] != "normal") & ~table["false_alarm"]  # no alarm is up before there is a fault
    told, delay, isolated = (table[name][clean] for name in ("complete_s", "delay_s", "isolated_s"))
    ends = np.isfinite(told) & np.isfinite(delay)
    assert ends.sum() > 10 and (told >= delay - 1e-9)[ends].all() and (told > delay)[ends].any()
    both = np.isfinite(isolated) & np.isfinite(told)
    assert (told <= isolated + 1e-9)[both].all()
    lasts = (table["clear_s"] - table["onset_s"])[clean] > delay + 0.06
    assert np.isfinite(told[table["verdict_right"][clean] & lasts]).all()


def test_ceilings_and_what_nobody_could_see_by_hand():
    """Five faults: one missed that was visible, one missed that was not, three found."""
    flag = lambda *values: np.array(values, bool)  # noqa: E731
    rows = {"detected": flag(0, 0, 1, 1, 1), "visible_s": np.array([0.1, np.inf, 0.0, 0.0, np.inf])}
    for part in summary.ISOLATION:
        for when in ("", "_settled"):
            rows |= {f"{part}_right{when}": flag(0, 0, 1, 0, 0), f"{part}_visible{when}": flag(1, 0, 1, 1, 0)}
    rows |= {name: flag(0, 0, 0, 1, 1) for name in ("unsure", "unsure_settled")}
    found = summary._detection(rows)
    assert found["detection"] == 0.6 and found["detection_ceiling"] == 0.6 and found["detection_unseen"] == 0.5
    for name in ("isolation_kind", "isolation_joint", "isolation", "isolation_settled"):
        assert found[name] == pytest.approx(1 / 3)
        assert found[f"{name}_ceiling"] == pytest.approx(2 / 3)
        assert found[f"{name}_unseen"] == pytest.approx(1 / 2)
    assert found["unsure"] == pytest.approx(2 / 3)
    assert (found["isolation_kind_unsure"], found["isolation_kind_sure"]) == (0, 1)
    (said,) = verdicts.guesses(found)
    assert said.startswith(
        "Fault, kind unknown: of 66.7 % at 60 ms (their kind is right in 0.0 %, that of the others in 100.0 %)"
    )
    assert verdicts.guesses(found | {"unsure": 0.0, "unsure_settled": 0.0}) == []
    all_right = {name: np.ones(2, bool) if name != "visible_s" else np.zeros(2) for name in rows}
    assert summary._detection(all_right)["detection_unseen"] is None, "nothing was missed"


def test_the_table_of_verdicts_has_the_oracle_under_every_scheme(rows):
    found = {name: summary.summarise(rows[0], name) for name in ("one", "other")}
    lines = verdicts.cells(found)
    assert [line[0] for line in lines] == ["one", "oracle, one", "other", "oracle, other"]
    assert {len(line) for line in lines} == {len(verdicts.HEAD)} == {len(verdicts.UNITS)}
    result = found["one"]
    assert lines[0][2] == f"{100 * result['isolation_kind']:.2f}"
    assert lines[1][5] == f"{100 * result['isolation_kind_settled_ceiling']:.2f}"
    told = result["complete_median_s"]["both"]
    assert lines[1][-1] == "-" and lines[0][-1] == ("never" if told is None else f"{1e3 * told:.0f}")
    text = comparison.as_text({"one": result | {"calibration": None}})
    assert "oracle, one" in text and verdicts.NOTE in text
