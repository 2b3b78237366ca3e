"""Scores kept in the loop: against a slow twin on stored traces, and properties that any scoring must have."""

import functools

import chex
import hypothesis
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import strategies as st
from twins import score as twin

import jaxftc
from jaxftc.campaigns import run
from jaxftc.evaluation import metrics, online, table
from jaxftc.scenarios.contact import no_contact
from jaxftc.scenarios.faults import Actuator, Sensor
from tests.arms import three_hinges

pytestmark = pytest.mark.thorough  # half a minute to compile

TICKS, N = 200, three_hinges().n


@pytest.fixture(scope="module")
def setting():
    """A config of 0.4 s, and scenarios of every preset with faults early enough to clear and to come to an end."""
    config = jaxftc.Config(three_hinges(), engine="chain", duration=0.4, contact=1)
    parts = []
    for k, preset in enumerate(("standard", "hard", "doubles", "contact")):
        drawn = jaxftc.sample_scenarios(jax.random.key(40 + k), 12, preset, config=config)
        drawn = drawn._replace(contact=drawn.contact or no_contact((12,)))
        early = {
            name: fault._replace(onset=0.4 * fault.onset, clear=0.4 * fault.clear)
            for name, fault in (("fault_tau", drawn.fault_tau), ("fault_q", drawn.fault_q), ("contact", drawn.contact))
        }
        parts.append(drawn._replace(id=drawn.id + 100 * k, **early))
    scenarios = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)
    dropout = scenarios.fault_q._replace(kind=scenarios.fault_q.kind.at[0, 1].set(Sensor.DROPOUT))
    gains = jaxftc.default_gains(config).replace({"diagnosis.follow_speed": 0.2, "diagnosis.follow_torque": 0.05})
    return config, gains, scenarios._replace(fault_q=dropout, uncommon=())


@pytest.fixture(scope="module")
def scores(setting):
    return run.scores(*setting, jax.random.key(7))


@pytest.fixture(scope="module")
def trace(setting):
    config, gains, scenarios = setting
    return jax.tree.map(np.asarray, jaxftc.simulate(config, gains, scenarios, jax.random.key(7)))


@pytest.fixture(scope="module")
def twins(setting, trace):
    """Scores of every run, written down tick by tick."""
    config, gains, scenarios = setting
    at_rest, one = np.asarray(gains.diagnosis.alpha_tau), lambda k: jax.tree.map(lambda x: np.asarray(x)[k], scenarios)
    return [twin.score(config, one(k), metrics.columns(trace, k), at_rest) for k in range(len(scenarios.id))]


@pytest.mark.parametrize("field", online.Score._fields)
def test_every_score_equals_its_twin(setting, scores, twins, field):
    expected = [score[field] for score in twins]
    got = np.moveaxis(getattr(scores, field), -1, 0)
    assert not scores.lost.any() and np.isfinite(np.asarray(expected, float)[:, ...] if field == "ise" else 0.0).all()
    np.testing.assert_allclose(got, np.array(expected, float), rtol=1e-7, atol=1e-12, err_msg=field)


def test_the_scenarios_exercise_every_score(scores):
    """A twin agrees easily on what never happens."""
    for field in ("false_at", "alarm_at", "isolated_at"):
        happened = np.isfinite(getattr(scores, field))
        assert happened.any() and not happened.all(), field
    assert np.isfinite(scores.quiet_at).any() and (scores.false_ticks > 0).any() and np.isfinite(scores.crossed[-1]).any()
    assert set(np.unique(scores.verdict)) >= {0, 1, 2, 3, 8} and (scores.force > 0).any()


def test_rows_do_not_depend_on_order_or_number(setting):
    config, gains, scenarios = setting
    everything = run.campaign(config, gains, scenarios, jax.random.key(7))
    picked = np.array([30, 2, 17, 2])
    some = run.campaign(config, gains, jax.tree.map(lambda x: np.asarray(x)[picked], scenarios), jax.random.key(7))
    for name, column in everything.items():
        np.testing.assert_array_equal(some[name], column[picked], err_msg=name)


def test_a_replay_is_the_row_and_its_trace(setting):
    config, gains, scenarios = setting
    rows = run.campaign(config, gains, scenarios, jax.random.key(7))
    for k in (0, 20):
        row, trace = run.replay(config, gains, jax.tree.map(lambda x, k=k: np.asarray(x)[k], scenarios), jax.random.key(7))
        for name, column in rows.items():
            np.testing.assert_array_equal(row[name], column[k : k + 1], err_msg=name)
        chex.assert_shape([trace.q, trace.t], [(config.ticks, N), (config.ticks,)])
        error = np.rad2deg(metrics.rms(np.asarray(trace.q - trace.q_ref)))
        assert error == pytest.approx(rows["tracking_rmse_deg"][k], rel=1e-6)


def test_figures_of_a_stored_run_and_of_a_campaign_are_the_same(setting, scores, trace):
    """``metrics.evaluate``, which simulate and demo print, against the columns of a campaign."""
    config, _, scenarios = setting
    rows = table.columns(config, scenarios, scores)
    for k in range(len(scenarios.id)):
        merits = metrics.evaluate(config, metrics.columns(trace, k))
        assert merits.tracking_rms_deg == pytest.approx(rows["tracking_rmse_deg"][k], rel=1e-6)
        assert merits.fault_tau_rms_nm == pytest.approx(rows["fault_tau_rmse_nm"][k], rel=1e-6)
        assert merits.fault_q_rms_deg == pytest.approx(rows["fault_q_rmse_deg"][k], rel=1e-6)
        assert merits.chattering == pytest.approx(rows["chattering"][k], rel=1e-6)
        if rows["law"][k] != "incipient":  # a ramp starts from nothing: what is there is seen a tick after it began
            delay = np.nan if merits.delay_s is None else merits.delay_s
            np.testing.assert_allclose(delay, rows["delay_s"][k], atol=1e-9)


# Properties, on made-up signals: a score is a function of what the controller said, whatever said it.


@functools.cache
def scoring():
    """(config, compiled score of made-up runs): alarm [T, B] bool of joint 1, statistic [T, B], onset and clear [B]."""
    config = jaxftc.Config(three_hinges(), engine="chain", duration=TICKS * 1e-3)
    gains = jaxftc.default_gains(config)
    blank = jaxftc.paper_scenario("healthy", config)

    def call(alarm, statistic, onset, clear):
        count = onset.shape[0]
        scenarios = jax.tree.map(lambda x: jnp.broadcast_to(x[..., None], (*x.shape, count)), blank)
        kind = jnp.zeros((N, count), jnp.int32).at[0].set(Actuator.BIAS)
        fault = scenarios.fault_tau._replace(
            kind=kind, onset=jnp.broadcast_to(onset, (N, count)), clear=jnp.broadcast_to(clear, (N, count))
        )
        scenarios = scenarios._replace(fault_tau=fault)
        true = online.truth(config, scenarios)
        zero = jnp.zeros((N, count))
        first = jnp.zeros((N, 1)).at[0].set(1.0)

        def body(state, x):
            t, up, size = x
            out = jaxftc.Output(**{name: zero for name in jaxftc.Output._fields})
            out = out._replace(
                verdict=(first * up).astype(jnp.int32), detected=up, statistic_tau=first * size,
                threshold_tau=zero + 1.0, threshold_q=zero + 1.0,
            )  # fmt: skip
            tick = jaxftc.Trace(
                t=t, q=zero, qd=zero, y=zero, q_ref=zero, tau_applied=zero, fault_tau=zero, fault_q=zero,
                contact_tau=zero, out=out,
            )  # fmt: skip
            return online.step(config, gains, true, state, tick), None

        ticks = jnp.arange(TICKS) * config.dt
        return online.total(jax.lax.scan(body, online.init(config, zero), (ticks, alarm, statistic))[0])

    return config, jax.jit(call)


def found(alarm, statistic=None, onset=0.05, clear=np.inf):
    """Scores of made-up runs [T, B]."""
    count = alarm.shape[1]
    statistic = np.zeros(alarm.shape) if statistic is None else statistic
    return jax.tree.map(np.asarray, scoring()[1](alarm, statistic, np.full(count, onset), np.full(count, clear)))


def up_from(starts, length=30):
    """Alarms [T, B] that rise at the given ticks."""
    k = np.arange(TICKS)[:, None]
    return (k >= starts) & (k < starts + length)


@hypothesis.given(st.lists(st.integers(0, TICKS - 1), min_size=8, max_size=8))
def test_a_later_alarm_never_lowers_the_delay(starts):
    """An alarm that comes later never makes the first alarm after onset earlier; rising before onset is not later."""
    starts = np.sort(np.maximum(np.array(starts), 50))
    delays = found(up_from(starts)).alarm_at
    assert (np.diff(delays) >= 0).all()
    np.testing.assert_allclose(delays, starts * 1e-3)


@hypothesis.given(st.permutations(range(8)), st.integers(0, 2**16))
def test_permuting_scenarios_permutes_scores(order, seed):
    alarm = np.random.default_rng(seed).random((TICKS, 8)) < 0.05
    one, other = found(alarm), found(alarm[:, list(order)])
    for mine, theirs in zip(one, other, strict=True):
        np.testing.assert_array_equal(mine[..., list(order)], theirs)


@hypothesis.given(st.integers(0, 2**16), st.integers(0, len(online.LEVELS) - 1))
def test_a_scaled_statistic_moves_along_the_levels(seed, shift):
    """Twice the signal against twice the threshold is the same: crossings shift by as many levels as the factor has."""
    random = np.random.default_rng(seed)
    statistic = np.cumsum(random.normal(0, 0.1, (TICKS, 8)), axis=0)
    none = np.zeros((TICKS, 8), bool)
    factor = online.LEVELS[shift] * (1 + 1e-12)  # away from ties
    base, scaled = found(none, statistic * (1 + 1e-12)).crossed, found(none, factor * statistic).crossed
    middle = len(online.LEVELS) // 2
    for k in range(len(online.LEVELS)):
        other = k + shift - middle
        if 0 <= other < len(online.LEVELS):
            np.testing.assert_array_equal(scaled[other], base[k])


def test_alarms_before_and_after_a_fault_are_false_and_excused():
    starts = np.array([10, 60, 95, 130, 230])
    s = found(up_from(starts, 5), clear=0.08)
    np.testing.assert_allclose(s.false_at, [0.010, np.inf, np.inf, np.inf, np.inf])
    np.testing.assert_allclose(s.alarm_at, [np.inf, 0.060, 0.095, 0.130, np.inf])
    np.testing.assert_array_equal(s.false_ticks, [5, 0, 0, 0, 0])
    np.testing.assert_allclose(s.quiet_at, [0.081, 0.081, 0.081, 0.081, 0.081])
    lasting = found(up_from(np.array([60]), 40), clear=0.08)
    np.testing.assert_allclose(lasting.quiet_at, [0.100])
    late = found(up_from(np.array([190]), 5), clear=0.08)
    np.testing.assert_allclose(late.false_at, [0.190])
    assert np.isinf(late.alarm_at).all(), "long after it has gone nothing is detected any more"
