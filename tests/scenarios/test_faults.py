"""Faults as data: every kind does what its comment says, laws in time, and batches that depend on ids alone."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxftc
from jaxftc import checks
from jaxftc.scenarios.faults import Actuator, Fault, Sensor, no_fault
from jaxftc.scenarios.scenario import CONDITIONS, paper_scenario, stack, trail
from jaxftc.simulation import fault_injection, fault_profiles
from jaxftc.simulation.closed_loop import encoder_noise
from tests.arms import three_hinges, two_hinges

LIMIT = jnp.array([10.0, jnp.inf])


def fault(kind, magnitude, onset=0.1, clear=0.3, rise=0.0, period=jnp.inf, duty=1.0) -> Fault:
    return Fault(
        jnp.full(2, int(kind), jnp.int32), *(jnp.full(2, float(v)) for v in (magnitude, onset, clear, rise, period, duty))
    )


MOTION = fault_injection.Motion(jnp.array([0.01, 0.03]), jnp.array([0.1, -0.2]), jnp.array([2.0, 3.0]), 1e-3)


def start(tau=0.0, y=0.0):
    return fault_injection.init(jnp.full(2, float(tau)), jnp.full(2, float(y)), jnp.zeros(2))


@jax.jit
def delivered(law, state, t, tau):
    return fault_injection.deliver(law, state, t, tau, LIMIT, MOTION)


was_read = jax.jit(fault_injection.read)  # once for all kinds and times: they are data


def deliver(law, tau, t, last=3.0):
    return np.asarray(delivered(law, start(last), jnp.asarray(t), jnp.full(2, float(tau)))[1])


def read(law, q, t, noise=0.0, last=0.7):
    _, y, truth = was_read(law, start(y=last), jnp.asarray(t), jnp.full(2, float(q)), jnp.full(2, float(noise)))
    return np.asarray(y), np.asarray(truth)


@pytest.mark.parametrize(
    ("kind", "magnitude", "tau", "want"),
    [
        (Actuator.NONE, 9.0, 8.0, [8.0, 8.0]),
        (Actuator.BIAS, 2.0, 8.0, [10.0, 10.0]),
        (Actuator.LOSS, 0.25, 8.0, [6.0, 6.0]),
        (Actuator.STUCK, 0.0, 8.0, [3.0, 3.0]),
        (Actuator.SATURATION, 0.5, 8.0, [5.0, 8.0]),  # a joint without a limit has none to lose
        (Actuator.GAIN, -0.25, 8.0, [6.0, 6.0]),
        (Actuator.RIPPLE, 2.0, 8.0, 8.0 + 2.0 * np.sin([0.6, 1.8])),
        (Actuator.FRICTION, 2.0, 8.0, 8.0 - 2.0 * np.tanh([1.0, -2.0])),
        (Actuator.LOCKED, 0.0, 8.0, [-2.0 * 50 * (0.5 + 0.2), -3.0 * 50 * (1.5 - 0.4)]),
        (Actuator.DELAY, 1.0, 8.0, [3.0, 3.0]),
    ],
)
def test_actuator_kinds(kind, magnitude, tau, want):
    law = fault(kind, magnitude)
    np.testing.assert_allclose(deliver(law, tau, 0.2), want)
    np.testing.assert_allclose(deliver(law, tau, 0.05), tau)
    np.testing.assert_allclose(deliver(law, tau, 0.35), tau)


@pytest.mark.parametrize(
    ("kind", "magnitude", "want"),
    [
        (Sensor.NONE, 9.0, 0.51),
        (Sensor.BIAS, 0.2, 0.71),
        (Sensor.DRIFT, 2.0, 0.51 + 2.0 * 0.1),
        (Sensor.SCALE, 0.1, 0.51 + 0.05),
        (Sensor.FREEZE, 0.0, 0.7),
        (Sensor.NOISE, 30.0, 0.5 + 0.3),
        (Sensor.ROUNDING, 0.2, 0.6),
        (Sensor.WRAP, 0.4, 0.51 - 0.8),
        (Sensor.DELAY, 1.0, 0.7),
        (Sensor.CROSSTALK, 0.1, 0.51 + 0.05),
    ],
)
def test_sensor_kinds(kind, magnitude, want):
    law = fault(kind, magnitude)
    y, truth = read(law, 0.5, 0.2, noise=0.01)
    np.testing.assert_allclose(y, want)
    np.testing.assert_allclose(truth, want - 0.51, atol=1e-12)
    np.testing.assert_allclose(read(law, 0.5, 0.05, noise=0.01)[0], 0.51)


def test_dropout_is_no_reading_and_no_false_truth():
    y, truth = read(fault(Sensor.DROPOUT, 0.0), 0.5, 0.2)
    assert np.isnan(y).all()
    np.testing.assert_array_equal(truth, 0.0)


def test_stuck_and_frozen_keep_what_was_there_at_onset():
    law, state = fault(Actuator.STUCK, 0.0), start()
    for k in range(30):
        state, tau = delivered(law, state, jnp.asarray(k * 0.01), jnp.full(2, float(k)))
    np.testing.assert_array_equal(tau, 9.0)  # onset at 0.1 s: the tick before carried 9


def test_a_healthy_encoder_reads_in_counts():
    """Beside one that does not; the truth of its fault is what the fault adds."""
    config = jaxftc.Config(two_hinges(), engine="chain", duration=0.05)
    count = 2.0**-10
    coarse = jaxftc.healthy_scenario(config, resolution=count)
    runs = stack([coarse.with_encoder_bias(1, 0.3 * count, onset=0.02), jaxftc.healthy_scenario(config)])
    trace = jaxftc.simulate(config, jaxftc.default_gains(config), runs, jax.random.key(0))
    counts, error = np.asarray(trace.y) / count, np.asarray(trace.y - trace.q)
    assert (counts[0] == counts[0].round()).all() and (counts[1] != counts[1].round()).any()
    assert (np.abs(error[0, :20]) <= 0.5 * count + 5 * 3e-5).all() and len(np.unique(counts[0])) > 10
    np.testing.assert_allclose(trace.fault_q[0, 20:, 0], 0.3 * count, rtol=1e-3)
    assert not np.asarray(trace.fault_q)[0, :20].any()


@given(st.floats(0, 1), st.floats(0, 0.5), st.floats(0.01, 0.3), st.floats(0.02, 0.3), st.floats(0.1, 1))
def test_size_is_a_share_and_zero_outside_its_window(t, onset, rise, period, duty):
    law = fault(Actuator.BIAS, 1.0, onset=onset, clear=onset + 0.4, rise=rise, period=period, duty=duty)
    size = np.asarray(fault_profiles.size(law, jnp.asarray(t)))
    assert ((size >= 0) & (size <= 1)).all()
    if not onset <= t <= onset + 0.4:
        assert (size == 0).all()
    abrupt = np.asarray(fault_profiles.size(law._replace(rise=jnp.zeros(2)), jnp.asarray(t)))
    assert (abrupt >= size).all()


def test_intermittent_fault_comes_and_goes():
    law = fault(Actuator.BIAS, 1.0, onset=0.1, clear=jnp.inf, period=0.1, duty=0.4)
    there = [bool(fault_profiles.present(law, jnp.asarray(t))[0]) for t in (0.05, 0.11, 0.139, 0.15, 0.19, 0.21, 0.25)]
    assert there == [False, True, True, False, False, True, False]


def test_magnitudes_have_gradients():
    def torque(size, law):
        return delivered(law._replace(magnitude=size), start(1.0, 1.0), jnp.asarray(0.2), jnp.full(2, 8.0))[1].sum()

    slope = jax.jit(jax.grad(torque))
    for kind in (Actuator.BIAS, Actuator.LOSS, Actuator.SATURATION, Actuator.GAIN, Actuator.RIPPLE, Actuator.FRICTION):
        gradient = slope(jnp.full(2, 0.5), fault(kind, 0.5))
        assert np.isfinite(gradient).all() and gradient[0] != 0


@pytest.mark.parametrize("ticks", range(6))
def test_a_late_signal_is_the_one_of_that_many_ticks_ago(ticks):
    commands, readings = fault(Actuator.DELAY, ticks, onset=0.0), fault(Sensor.DELAY, ticks, onset=0.0)
    state, clear = start(-1.0, -1.0), jnp.inf
    for k in range(12):
        now, t = jnp.full(2, float(k)), jnp.asarray(k * 0.01)
        state, tau = delivered(commands._replace(clear=clear), state, t, now)
        state, y, _ = was_read(readings._replace(clear=clear), state, t, now, jnp.zeros(2))
        wanted = k - ticks if k >= ticks else -1.0
        np.testing.assert_array_equal((tau, y), wanted)


@pytest.fixture(scope="module")
def moved():
    """Runs of a small arm with faults that depend on how it moves."""
    config = jaxftc.Config(three_hinges(), engine="chain", t_final=0.3, duration=0.3)
    goal = config.robot.q_zero + np.array([0.3, -0.3, 0.3])
    healthy = jaxftc.healthy_scenario(config, q_start=config.robot.q_zero, q_goal=goal, noise=0.0)
    runs = [healthy, healthy.with_locked_joint(2, 0.15), healthy.with_joint_friction(2, 1.0, 0.05, rise=0.1)]
    trace = jaxftc.simulate(config, jaxftc.default_gains(config), stack(runs), jax.random.key(0))
    return config, jax.tree.map(np.asarray, trace)


@pytest.mark.thorough
def test_a_locked_joint_stays_where_it_was(moved):
    config, trace = moved
    onset = round(0.15 / config.dt)
    assert np.abs(trace.qd[0, onset, 1]) > 0.5, "it was moving"
    left = np.abs(trace.q[1, onset:, 1] - trace.q[1, onset, 1])
    assert left.max() < 0.02 and np.abs(trace.qd[1, -10:, 1]).max() < 0.02
    assert np.abs(trace.q[0, -1, 1] - trace.q[0, onset, 1]) > 0.1


def test_friction_takes_energy_from_the_arm(moved):
    _, trace = moved
    power = trace.fault_tau[2, :, 1] * trace.qd[2, :, 1]
    assert (power <= 0).all() and power.min() < -0.1
    np.testing.assert_array_equal(trace.fault_tau[0], 0.0)


@pytest.mark.parametrize("dt", [1e-3, 1e-2])
@pytest.mark.parametrize("size", [0.1, 30.0])
def test_friction_of_any_size_ends_a_motion_and_turns_none_round(dt, size):
    law, inertia = fault(Actuator.FRICTION, size, onset=0.0, clear=jnp.inf), jnp.array([0.05, 0.2])

    def tick(speed, t):
        motion = fault_injection.Motion(jnp.zeros(2), speed, inertia, dt)
        after = speed + dt * fault_injection.deliver(law, start(), t, jnp.zeros(2), LIMIT, motion)[1] / inertia
        return after, after

    speeds = np.asarray(jax.jit(lambda v: jax.lax.scan(tick, v, dt * jnp.arange(2000)))(jnp.array([1.0, -0.5]))[1])
    assert np.diff(np.abs(speeds), axis=0).max() < 1e-15 and np.abs(speeds[-1]).max() < 1e-2
    assert (speeds * [1, -1] >= -1e-15).all(), "turned round"


def test_paper_conditions(config):
    scenario = stack([paper_scenario(condition, config) for condition in CONDITIONS])
    assert np.asarray(scenario.fault_tau.kind)[:, 0].tolist() == [0, 1, 0, 1]
    assert np.asarray(scenario.fault_q.kind)[:, 0].tolist() == [0, 0, 1, 1]
    np.testing.assert_allclose(scenario.fault_tau.magnitude[1], 5.0)
    np.testing.assert_allclose(np.rad2deg(scenario.fault_q.magnitude[2]), 1.5)


def test_sampled_scenarios_have_a_leading_axis_and_their_ids(config):
    scenarios = jaxftc.sample_scenarios(jax.random.key(0), 10, preset="paper", config=config)
    assert {leaf.shape[0] for leaf in jax.tree.leaves(scenarios)} == {10}
    np.testing.assert_array_equal(scenarios.id, np.arange(10))


@pytest.mark.thorough
def test_noise_depends_on_the_id_not_on_the_place(config):
    scenarios = jaxftc.sample_scenarios(jax.random.key(0), 8, preset="paper", config=config)
    key = jax.random.key(5)
    whole = encoder_noise(config, trail(scenarios), key)
    part = encoder_noise(config, trail(jax.tree.map(lambda leaf: leaf[jnp.array([6, 2])], scenarios)), key)
    np.testing.assert_array_equal(part, whole[..., jnp.array([6, 2])])
    one = encoder_noise(config, jax.tree.map(lambda leaf: leaf[6], scenarios), key)
    np.testing.assert_array_equal(one, whole[..., 6])
    np.testing.assert_allclose(np.std(whole), 3e-5, rtol=0.1)


def test_refusals(config):
    with pytest.raises(ValueError, match=r"condition.*'sensor'.*got 'actuators'; did"):
        paper_scenario("actuators", config)
    with pytest.raises(ValueError, match=r"preset.*'uncommon'.*got 'papers'; did"):
        jaxftc.sample_scenarios(jax.random.key(0), 4, preset="papers", config=config)
    with pytest.raises(ValueError, match=r"n must.*at least 1, got 0"):
        jaxftc.sample_scenarios(jax.random.key(0), 0, config=config)
    with pytest.raises(ValueError, match=r"key.*random key.*got 0"):
        jaxftc.sample_scenarios(0, 4, config=config)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"key": 0}, "key must be one random key, such as jax.random.key(0), got 0"),
        ({"key": jax.random.split(jax.random.key(0))}, "key must be one random key"),
        ({"config": None}, "config must be a Config, got a NoneType; arguments in another order?"),
        ({"gains": None}, "gains must be a Gains, got a NoneType; arguments in another order?"),
        ({"scenario": None}, "scenario must be a Scenario, got a NoneType; arguments in another order?"),
    ],
)
def test_what_is_no_argument_of_a_run_is_refused(config, change, words):
    arguments = {"config": config, "gains": jaxftc.default_gains(config), "scenario": paper_scenario("both", config)}
    with pytest.raises(ValueError, match=re.escape(words)):
        jaxftc.simulate(*(arguments | {"key": jax.random.key(0)} | change).values())


@pytest.mark.parametrize(
    ("scenarios", "key", "words"),
    [
        ("one", jax.random.key(0), "scenarios must have one leading axis, as sample_scenarios gives them"),
        ("list", jax.random.key(0), "scenarios must be a Scenario, got a list; arguments in another order?"),
        ("many", 0, "key must be one random key, such as jax.random.key(0), got 0"),
    ],
)
def test_what_is_no_argument_of_a_campaign_is_refused(config, scenarios, key, words):
    one = paper_scenario("both", config)
    with pytest.raises(ValueError, match=re.escape(words)):
        given = {"one": one, "list": [one], "many": stack([one, one])}[scenarios]
        jaxftc.campaign(config, jaxftc.default_gains(config), given, key)


@pytest.mark.parametrize("key", [jax.random.key(0), jax.random.key(0, impl="rbg"), jax.random.PRNGKey(0)])
def test_keys_of_every_kind_pass(key):
    checks.random_key("key", key)
    checks.random_key("key", np.asarray(jax.random.PRNGKey(0)))
    jax.jit(lambda key: checks.random_key("key", key))(key)
    jax.vmap(lambda key: checks.random_key("key", key))(jax.random.split(key))


def test_no_fault_is_healthy():
    healthy = no_fault(2)
    for t in (0.0, 0.5, 100.0):
        np.testing.assert_array_equal(deliver(healthy, 4.0, t), 4.0)
        np.testing.assert_array_equal(read(healthy, 0.5, t)[0], 0.5)


@pytest.mark.parametrize("preset", ["standard", "hard", "doubles"])
def test_no_random_key_is_used_twice(preset):
    """JAX's own check, where scenarios are drawn: what is drawn again from the same key is the same again."""
    config = jaxftc.Config(three_hinges(), engine="chain", duration=1.1)
    with jax.debug_key_reuse(True):
        with pytest.raises(jax.errors.KeyReuseError):
            jax.jit(lambda key: jax.random.normal(key) + jax.random.uniform(key))(jax.random.key(0))
        jaxftc.sample_scenarios(jax.random.key(0), 2, preset, config=config)
