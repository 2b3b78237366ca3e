"""Alarms, verdicts and the sensor check, on signals made for the purpose and in the closed loop."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxftc
from jaxftc.diagnosis import decision
from jaxftc.diagnosis.statistics import Statistics
from jaxftc.evaluation import metrics
from jaxftc.observer.cascade import Estimate
from jaxftc.observer.takagi_sugeno import Jump
from jaxftc.scenarios.faults import Actuator, Sensor
from jaxftc.scenarios.scenario import paper_scenario, stack


def blank(n):
    """An estimate in which nothing happens."""
    none, no = jnp.zeros(n), jnp.zeros(n, bool)
    return Estimate(none, none, none, Jump(none, none, none, none), none, none, none, none, none, no, no, none)


def judge(config, s_tau, s_q=None, y=None, h_s=None, speed=1.0, r_tau=None):
    """Verdicts [T, n] for statistics [T, n] in units of the threshold; the residual is the statistic if not given."""
    gains = jaxftc.default_gains(config)
    ticks, n = len(s_tau), config.n
    zero = np.zeros((ticks, n))
    s_q, h_s = zero if s_q is None else s_q, zero if h_s is None else h_s
    y = np.cumsum(np.full((ticks, n), 1e-3), 0) if y is None else y
    seen = blank(n)
    state, verdicts = decision.init(config, gains, jnp.asarray(y[0]) - 1e-3), []
    for k in range(ticks):
        now = seen._replace(
            y=jnp.asarray(y[k]),
            jump=seen.jump._replace(h_s=jnp.abs(h_s[k]), side=jnp.sign(h_s[k])),
            absent=jnp.isnan(y[k]),
            missing=jnp.isnan(y[k]),
        )
        own = gains.diagnosis
        statistics = Statistics(s_tau[k] * own.alpha_tau, s_q[k] * own.alpha_q)
        residual = (s_tau if r_tau is None else r_tau)[k] * own.alpha_tau
        inputs = decision.Inputs(statistics, own.alpha_tau, residual, now, jnp.full(n, float(speed)), jnp.zeros(n))
        state, said = _decide(config, gains, state, inputs)
        verdicts.append(np.asarray(said.verdict))
    return np.array(verdicts)


_decide = jax.jit(decision.step, static_argnums=0)


@pytest.fixture(scope="module")
def two():
    """A two-joint arm is enough for logic."""
    from jaxftc.robot.model_file import compile_robot

    inertial = '<inertial pos="0 0 .1" mass="1" diaginertia=".1 .1 .1"/>'
    return jaxftc.Config(
        compile_robot(
            "two",
            (
                f'<mujoco><worldbody><body><joint axis="0 1 0"/>{inertial}'
                f'<body pos="0 0 .3"><joint axis="0 1 0"/>{inertial}</body></body>'
                "</worldbody></mujoco>"
            ),
        )
    )


def pulse(ticks, start, stop, size=1.5, joint=0):
    s = np.zeros((ticks, 2))
    s[start:stop, joint] = size
    return s


def test_torque_alarm_needs_persistence_and_keeps_through_a_dip(two):
    s = pulse(200, 10, 150)
    s[60:65, 0] = 0.1  # shorter than release_ticks, but later than a velocity transient would be
    two = dataclasses.replace(two, transient_ticks=0)
    verdict = judge(two, s)
    assert verdict[:12, 0].max() == 0 and verdict[12, 0] == jaxftc.Verdict.ACTUATOR
    assert (verdict[12:159, 0] == 1).all() and (verdict[160:, 0] == 0).all() and (verdict[:, 1] == 0).all()


def test_negative_statistics_alarm_too_and_only_beyond_the_threshold(two):
    assert (judge(two, -pulse(60, 10, 60))[20:, 0] == 1).all()
    assert (judge(two, pulse(60, 10, 60, size=0.99)) == 0).all()


def test_hysteresis(two):
    s = pulse(200, 10, 100)
    s[100:, 0] = 0.8  # below the threshold, above the release level
    assert (judge(two, s)[12:, 0] == 1).all()


def test_encoder_alarm_is_immediate_and_both_bits_make_both(two):
    verdict = judge(two, pulse(60, 10, 60), s_q=pulse(60, 5, 60))
    assert verdict[5, 0] == jaxftc.Verdict.SENSOR and (verdict[12:, 0] == jaxftc.Verdict.BOTH).all()


def test_a_statistic_ahead_of_its_residual_makes_no_velocity_transient(two):
    """The lead overshoots where a torque sets in; what tells a velocity transient is the residual without it."""
    residual = pulse(200, 10, 200, size=2.0)
    ahead = residual + pulse(200, 10, 20, size=8.0)
    assert (judge(two, ahead, r_tau=residual)[12:, 0] == 1).all()
    assert (judge(two, ahead)[45:, 0] == 2).all()


def test_a_torque_that_vanishes_at_once_was_a_velocity_transient(two):
    verdict = judge(two, pulse(200, 10, 40, size=8.0))
    assert verdict[20, 0] == 1 and (verdict[45:, 0] == 2).all()
    longer = judge(two, pulse(200, 10, 100, size=8.0))
    assert longer[90, 0] == 1 and (longer[115:, 0] == 0).all()
    off = judge(dataclasses.replace(two, transient_ticks=0), pulse(200, 10, 40, size=8.0))
    assert (off[60:, 0] == 0).all()


def test_of_two_velocity_transients_at_once_only_the_larger_counts(two):
    verdict = judge(two, pulse(200, 10, 40, size=8.0) + pulse(200, 10, 40, size=2.0, joint=1))
    assert (verdict[60:, 0] == 2).all() and (verdict[60:, 1] == 0).all()


def test_equal_readings_are_a_freeze_only_while_the_arm_moves(two):
    y = np.cumsum(np.full((60, 2), 1e-3), 0)
    y[20:] = y[20]
    moving, resting = (judge(two, pulse(60, 30, 60), y=y, speed=v) for v in (1.0, 0.01))
    assert (moving[26:] == 2).all()  # sensor, although the torque channel is up: the frozen reading explains it
    assert (resting[26:30] == 0).all() and (resting[40:, 0] == 1).all()  # an encoder at rest repeats itself


def test_readings_that_do_not_come_are_a_sensor_fault_even_at_rest(two):
    y = np.cumsum(np.full((60, 2), 1e-3), 0)
    y[20:24, 0] = np.nan  # a glitch
    y[40:, 0] = np.nan
    verdict = judge(two, np.zeros((60, 2)), y=y, speed=0.0)
    assert (verdict[:44] == 0).all() and (verdict[44:, 0] == 2).all() and (verdict[:, 1] == 0).all()


def test_one_reading_that_does_not_come_to_an_arm_at_rest_is_no_fault(two):
    y = np.full((60, 2), 0.3)
    y[30, 0] = np.nan
    assert (judge(two, np.zeros((60, 2)), y=y, speed=0.0) == 0).all()


def test_a_velocity_transient_is_forgotten_when_all_has_been_quiet(two):
    verdict = judge(two, pulse(700, 10, 40, size=8.0))
    assert (verdict[60:500, 0] == 2).all() and (verdict[560:, 0] == 0).all()
    again = judge(two, pulse(800, 10, 40, size=8.0) + pulse(800, 650, 800))
    assert (again[660:, 0] == 1).all()  # an actuator fault is not hidden by it for ever


def test_many_jumps_are_noise(two):
    h = np.zeros((60, 2))
    h[10:40:2, 0] = 1.0
    verdict = judge(two, np.zeros((60, 2)), h_s=h)
    assert (verdict[:24, 0] == 0).all() and (verdict[30:50, 0] == 2).all() and (verdict[:, 1] == 0).all()


def test_jumps_to_and_fro_are_noise_and_jumps_one_way_a_drift(two):
    h = np.zeros((40, 2))
    h[10:40, 0], h[10:40, 1] = 1.0, np.resize([1.0, -1.0], 30)
    gains, zero = jaxftc.default_gains(two), jnp.zeros(2)
    state = decision.init(two, gains, zero)
    for k in range(40):
        jump = Jump(jnp.abs(h[k]), jnp.sign(h[k]), jnp.zeros(2), jnp.zeros(2))
        seen = blank(2)._replace(y=jnp.full(2, 1e-3 * k), jump=jump)
        inputs = decision.Inputs(Statistics(zero, zero), gains.diagnosis.alpha_tau, zero, seen, jnp.ones(2), zero)
        state, said = _decide(two, gains, state, inputs)
    np.testing.assert_array_equal(said.sensors.noisy, [0, 1])
    np.testing.assert_array_equal(said.sensors.suspect, [1, 1])


def resolution(config, readings):
    """Resolution [T, n] rad that the sensor check finds in readings [T, n] rad."""
    gains, zero = jaxftc.default_gains(config), jnp.zeros(config.n)

    def step(state, reading):
        seen = blank(config.n)._replace(y=reading, reading=reading)
        inputs = decision.Inputs(Statistics(zero, zero), gains.diagnosis.alpha_tau, zero, seen, jnp.ones(config.n), zero)
        state, said = decision.step(config, gains, state, inputs)
        return state, said.sensors.resolution

    return np.asarray(jax.lax.scan(step, decision.init(config, gains, readings[0]), jnp.asarray(readings))[1])


SWING = 0.3 * np.sin(np.arange(400) * 0.02)  # up to 6 rad/s


def test_coarse_counts_are_found_with_their_size_and_forgotten_when_they_end(two):
    count = np.deg2rad(0.2)
    q = np.stack([SWING, np.where(np.arange(400) < 200, np.round(SWING / count) * count, SWING)], 1)
    found = resolution(two, q)
    np.testing.assert_array_equal(found[:, 0], 0)
    np.testing.assert_allclose(found[50:200, 1], count, rtol=1e-9)
    np.testing.assert_array_equal(found[210:, 1], 0)


@pytest.mark.parametrize("bits", [14, 16, 20])
def test_a_fine_encoder_a_jump_and_a_drift_have_no_coarse_counts(two, bits):
    count, k = 2 * np.pi / 2**bits, np.arange(400)
    jumps = SWING + 0.05 * (k > 100) - 0.05 * (k > 200) + 0.1 * (k > 300)
    drift = SWING + 2e-3 * np.maximum(k - 100, 0)
    at_rest = 0.3 + 0.05 * ((k > 100) & (k < 200))
    for readings in (np.stack([jumps, drift], 1), np.stack([at_rest, SWING], 1)):
        np.testing.assert_array_equal(resolution(two, np.round(readings / count) * count), 0)


@given(st.lists(st.floats(-3, 3), min_size=30, max_size=60), st.floats(1.0, 3.0))
def test_a_larger_statistic_never_alarms_later(two, values, factor):
    s = np.repeat(np.array(values)[:, None], 2, 1)
    first = [np.flatnonzero(judge(two, f * s).any(1)) for f in (1.0, factor)]
    if first[0].size:
        assert first[1].size and first[1][0] <= first[0][0]


def encoder_fault(config, kind, magnitude):
    scenario = paper_scenario("sensor", config)
    only = jnp.arange(6) == 2
    law = scenario.fault_q._replace(
        kind=jnp.where(only, int(kind), 0).astype(jnp.int32),
        magnitude=jnp.where(only, magnitude, 0.0),
        clear=jnp.full(6, jnp.inf),
    )
    return scenario._replace(fault_q=law)


COARSE = [(0, 0.1), (2, 0.1), (4, 0.1), (4, 0.2), (4, 0.35), (1, 0.5), (2, 0.5), (0, 1.0)]  # (joint from 0, count in deg)
ROBUST = 8 + len(COARSE)  # robust_cases


@pytest.mark.thorough
def test_slow_encoder_faults_in_the_closed_loop(paper_arm):
    """Drift slow and fast, freeze, scale, noise on joint 3: called a sensor fault of joint 3 and of no other."""
    config = jaxftc.Config(paper_arm, engine="chain")
    cases = [(Sensor.DRIFT, 0.15), (Sensor.DRIFT, -0.8), (Sensor.FREEZE, 0.0), (Sensor.SCALE, 0.05), (Sensor.NOISE, 60.0)]
    padded = (cases * 4)[: ROBUST - 1]
    rounded = paper_scenario("healthy", config).with_encoder_rounding(1, np.deg2rad(COARSE[0][1]), 0.2)
    # A batch of the same size and structure as in the test below: one program.
    batch = stack([*(encoder_fault(config, kind, size) for kind, size in padded), rounded])
    gains = jaxftc.default_gains(config)
    tight = gains.replace({"diagnosis.alpha_q": np.deg2rad(0.02)})
    verdict = metrics.columns(jaxftc.simulate(config, tight, batch, jax.random.key(0)))["verdict"]
    for c, (kind, size) in enumerate(cases):
        first = np.flatnonzero(verdict[c].any(1))[0]
        assert first >= 100, (kind, size)
        np.testing.assert_array_equal(verdict[c, first + 60], [0, 0, 2, 0, 0, 0], err_msg=f"{kind!r} {size}")


def robust_cases(config):
    """(name, scenario, largest tracking error deg and largest error of the encoder-fault estimate deg at the end)."""
    healthy = paper_scenario("healthy", config)

    def faulty(channel, kind, size, joints, start=0.2, stop=0.4):
        there = jnp.isin(jnp.arange(6), jnp.array(joints))
        law = getattr(healthy, channel)._replace(
            kind=jnp.where(there, int(kind), 0).astype(jnp.int32),
            magnitude=jnp.where(there, float(size), 0.0),
            onset=jnp.full(6, start),
            clear=jnp.full(6, stop),
        )
        return healthy._replace(**{channel: law})

    def plant(scenario, **leaves):
        return scenario._replace(plant=scenario.plant._replace(**{k: jnp.asarray(v, float) for k, v in leaves.items()}))

    everywhere = list(range(6))
    return [
        ("ten times the encoder noise", healthy._replace(noise=jnp.asarray(3e-4)), 1.0, 0.2),
        ("noise on one encoder", faulty("fault_q", Sensor.NOISE, 60.0, [3], stop=jnp.inf), 2.0, 1.0),
        ("dropout, payload", plant(faulty("fault_q", Sensor.DROPOUT, 0.0, everywhere, stop=0.3), payload=1.0), 0.5, 0.1),
        ("dropout, masses", plant(faulty("fault_q", Sensor.DROPOUT, 0.0, everywhere), mass=np.full(6, 1.1)), 0.5, 0.1),
        ("knock", faulty("fault_tau", Actuator.BIAS, 40.0, [4], stop=0.25), 0.1, 0.1),
        ("drift that clears", faulty("fault_q", Sensor.DRIFT, np.deg2rad(20), [2]), 0.1, 0.1),
        ("freeze that clears", faulty("fault_q", Sensor.FREEZE, 0.0, [2]), 0.1, 0.1),
        ("freeze that stays", faulty("fault_q", Sensor.FREEZE, 0.0, [2], stop=jnp.inf), 1.0, 1.0),
    ] + [
        (f"counts of {count} deg", healthy.with_encoder_rounding(joint + 1, np.deg2rad(count), 0.2), 2 * count, 2 * count)
        for joint, count in COARSE
    ]


@pytest.mark.thorough
def test_nothing_runs_away_and_what_has_passed_leaves_no_trace(paper_arm):
    """The observer must not take its own corrections for encoder faults, whatever the encoder or the model does."""
    config = jaxftc.Config(paper_arm, engine="chain")
    cases = robust_cases(config)
    assert len(cases) == ROBUST
    batch = stack([scenario for _, scenario, _, _ in cases])
    trace = metrics.columns(jaxftc.simulate(config, jaxftc.default_gains(config), batch, jax.random.key(0)))
    for c, (name, _, tracking, estimate) in enumerate(cases):
        assert np.isfinite(trace["tau"][c]).all(), name
        assert np.rad2deg(np.abs(trace["q"] - trace["q_ref"])[c, -50:]).max() < tracking, name
        assert np.rad2deg(np.abs(trace["fault_q_hat"] - trace["fault_q"])[c, -50:]).max() < estimate, name
