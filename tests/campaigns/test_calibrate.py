"""Thresholds for a share of healthy runs with an alarm."""

import dataclasses

import jax
import numpy as np
import pytest

import jaxftc
from jaxftc import logs
from jaxftc.campaigns import calibrate as module
from jaxftc.campaigns import patience, run
from jaxftc.campaigns.calibrate import (
    LEAST_Q,
    Peaks,
    allowed,
    calibrate,
    thresholds,
    with_thresholds,
    without_faults,
)
from jaxftc.io.tables import write_parquet
from jaxftc.scenarios.scenario import paper_scenario
from tests.arms import two_hinges


@pytest.fixture(scope="module")
def config(puma):
    return jaxftc.Config(puma, engine="chain", duration=0.4)


@pytest.fixture(scope="module")
def small():
    return jaxftc.Config(two_hinges(), engine="chain", duration=0.4)


@pytest.fixture(scope="module")
def scenarios(small):
    return jaxftc.sample_scenarios(jax.random.key(60), 480, config=small)


@pytest.fixture(scope="module")
def found(small, scenarios):
    with jax.enable_x64(False):
        return calibrate(small, jaxftc.default_gains(small), scenarios, jax.random.key(61), false_alarms=0.05)


def test_fresh_runs_alarm_as_often_as_wanted(found):
    assert found.met and found.settled
    assert found.runs == found.fresh == 240
    assert found.reached.value <= 0.1 and found.reached.low <= 0.05


def test_thresholds_are_no_larger_than_they_need_be(small, scenarios, found):
    """A tenth lower, and more runs alarm than are allowed: it is the threshold of this rate, not merely a large one."""
    learn = without_faults(jax.tree.map(lambda x: np.asarray(x)[:240], scenarios))
    lower = with_thresholds(found.gains, 0.9 * found.gains.diagnosis.alpha_tau, found.gains.diagnosis.alpha_q)
    with jax.enable_x64(False):
        alarms = [(run.scores(small, g, learn, jax.random.key(61)).false_ticks > 0).sum() for g in (found.gains, lower)]
    assert alarms[0] <= 2 * allowed(240, 0.05, 0.95) + 1 < alarms[1]


def peaks(runs=2000, seed=0):
    """Peaks of independent joints with very different scales, and a quiet encoder channel."""
    scale = np.array([4.0, 3.0, 1.0, 0.2, 0.1, 0.05])[:, None]
    torque = scale * np.random.default_rng(seed).gamma(20, 0.05, (6, runs))
    return Peaks(torque, np.full((6, runs), 1e-6), np.zeros(runs, bool))


def test_the_share_holds_for_runs_as_a_whole_with_its_confidence(puma):
    config = jaxftc.Config(puma)
    exceed = []
    for seed in range(200):
        alpha_tau, alpha_q = thresholds(config, peaks(seed=seed), 0.02, 0.9)
        fresh = peaks(20000, seed=1000 + seed)
        exceed.append(((fresh.tau >= alpha_tau[:, None]).any(0) | (fresh.q >= alpha_q[:, None]).any(0)).mean())
    assert (np.array(exceed) <= 0.02).mean() >= 0.82, "with 90 % confidence; quantiles by joint come from the same runs"
    assert np.mean(exceed) > 0.01, "and not by being far too careful"


def test_every_joint_shares_the_alarms(puma):
    alpha_tau, alpha_q = thresholds(jaxftc.Config(puma), peaks(), 0.02, 0.95)
    rates = (peaks(50000, seed=9).tau >= alpha_tau[:, None]).mean(1)
    assert rates.max() < 4 * rates.min() + 1e-3
    np.testing.assert_allclose(alpha_q, LEAST_Q)


def test_too_few_runs_are_refused_with_the_number_that_would_do():
    assert allowed(299, 0.01, 0.95) == 0
    with pytest.raises(ValueError, match=r"298 healthy runs.*1 %.*95 %.*at least 299"):
        allowed(298, 0.01, 0.95)
    with pytest.raises(ValueError, match=r"false_alarms must lie in \(0, 1\), got 0"):
        allowed(100, 0, 0.95)


def test_a_single_scenario_is_refused(small):
    one = jaxftc.healthy_scenario(small)
    with pytest.raises(ValueError, match="scenarios must have one leading axis"):
        calibrate(small, jaxftc.default_gains(small), one, jax.random.key(0))


def test_alarms_that_no_threshold_prevents_are_told(puma):
    noisy = peaks()._replace(by_check=np.arange(2000) < 100)
    with pytest.raises(ValueError, match=r"100 of 2000.*no threshold.*observer.jump"):
        thresholds(jaxftc.Config(puma), noisy, 0.02, 0.95)
    thresholds(jaxftc.Config(puma), peaks()._replace(by_check=np.arange(2000) < 5), 0.02, 0.95)


def test_faults_are_left_out(scenarios):
    healthy = without_faults(scenarios)
    assert not healthy.fault_tau.kind.any() and not healthy.fault_q.kind.any()
    np.testing.assert_array_equal(healthy.q_goal, scenarios.q_goal)


def test_it_goes_on_until_the_thresholds_stay(small, scenarios, monkeypatch):
    """The fuzzy stage reads the thresholds, so that new ones change the statistics."""
    monkeypatch.setattr(module, "ROUNDS", 1)
    with jax.enable_x64(False):
        once = calibrate(small, jaxftc.default_gains(small), scenarios, jax.random.key(61), false_alarms=0.05)
    assert not once.settled and once.rounds == 1
    assert (
        dataclasses.asdict(once.gains.diagnosis).keys() == dataclasses.asdict(jaxftc.default_gains(small).diagnosis).keys()
    )


@pytest.mark.parametrize(("each", "lines"), [(1.0, 0), (15.0, 1)])  # s a piece, and lines that are said
def test_who_waits_long_is_told_once(each, lines, monkeypatch):
    """Compiling, before the first piece, does not count: 4 pieces of 256 runs, of 8192 / 2 in a round."""
    clock = iter(600.0 + each * np.arange(5))
    monkeypatch.setattr(patience.time, "perf_counter", lambda: next(clock))
    counted, said = [], []
    done = patience.told(counted.append, said.append, "ekf", 8192)
    for _ in range(5):
        done(256)
    assert counted == [256] * 5 and len(said) == lines
    if said:
        assert said == ["ekf: 4,096 healthy runs take 4.0 min; the thresholds take 3 to 9 times as many"]


# On recorded logs; thresholds from them are in test_diagnoser.py.


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    """A simulated healthy run as a user would have it: a log of 1 s at 1 kHz."""
    config = jaxftc.Config(two_hinges(), engine="chain", duration=1.0)
    trace = jaxftc.simulate(config, jaxftc.default_gains(config), paper_scenario("healthy", config), jax.random.key(63))
    columns = {"t": np.asarray(trace.t)}
    columns |= {f"q{j + 1}": np.ascontiguousarray(trace.y[:, j]) for j in range(config.n)}
    columns |= {f"tau{j + 1}": np.ascontiguousarray(trace.out.tau[:, j]) for j in range(config.n)}
    path = tmp_path_factory.mktemp("logs") / "log.parquet"
    write_parquet(path, columns)
    return config, trace, path


@pytest.mark.thorough
def test_a_log_is_diagnosed_as_the_arm_was(logged):
    """The nominal arm leaves no torque over, whoever drives it."""
    config, _, path = logged
    out = logs.diagnose(config, jaxftc.default_gains(config), logs.read(path, config))
    assert not np.asarray(out.detected).any()
    assert np.abs(np.asarray(out.statistic_tau)[600:]).max() < 0.5


@pytest.mark.thorough
def test_a_log_of_another_rate_is_brought_to_the_sample_time(logged, tmp_path):
    config, _, path = logged
    whole = logs.read(path, config)
    t = np.arange(0, 1, 0.002)
    rows = {"t": t}
    for j in range(config.n):
        rows |= {f"q{j + 1}": whole.q[::2, j], f"tau{j + 1}": whole.tau[::2, j]}
    write_parquet(tmp_path / "half.parquet", rows)
    half = logs.read(tmp_path / "half.parquet", config)
    assert len(half.q) == 999
    np.testing.assert_allclose(half.q[::2], whole.q[::2])
    np.testing.assert_allclose(half.q, whole.q[:999], atol=2e-4)
    np.testing.assert_allclose(half.tau[::2], whole.tau[::2], atol=1e-6)
