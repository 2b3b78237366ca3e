"""What the control law takes out as the actuator fault: its own recursion, its bandwidth, and the loop it closes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

import jaxftc
from jaxftc import stages
from jaxftc.control import compensation
from jaxftc.diagnosis import sensor_check
from jaxftc.observer import adaptation
from jaxftc.observer.frequency import frequency_response
from jaxftc.observer.stability import bank_matrices
from jaxftc.schemes import cascade
from tests.arms import three_hinges
from tests.control.test_frequency import amplitude, run

RATES = (0.25e-3, 0.5e-3, 1e-3, 2e-3, 4e-3, 5e-3, 8e-3, 10e-3, 20e-3)  # s


def config(dt=1e-3, **more):
    return jaxftc.Config(three_hinges(), dt=dt, t_final=1.0, engine="chain", **more)


def signals(ticks=30):
    random = np.random.default_rng(3)
    return random.normal(0, 5, (2, ticks, 3))


def compensated(gains, psi, left):
    """psi_c [T, n] of the block."""
    made, found = config(), []
    state = compensation.init(made, gains, jnp.zeros(3))
    for inputs in zip(jnp.asarray(psi), jnp.asarray(left), strict=True):
        state, psi_c = compensation.step(made, gains, state, compensation.Inputs(*inputs))
        found.append(psi_c)
    return jnp.stack(found)


def test_it_is_psi_and_a_low_pass_of_what_is_left():
    gains, (psi, left) = jaxftc.default_gains(config()).replace({"control.rate": np.array([20.0, 150.0, 1e6])}), signals()
    left = np.clip(left, -compensation.MOST, compensation.MOST)
    ahead, want = np.zeros(3), []
    for one, rest in zip(psi, left, strict=True):
        ahead = np.exp(-np.array([0.02, 0.15, 1e3])) * ahead + (1 - np.exp(-np.array([0.02, 0.15, 1e3]))) * rest
        want.append(one + ahead)
    found = compensated(gains, psi, left)
    np.testing.assert_allclose(found, want, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found[:, 2], (psi + left)[:, 2], rtol=1e-12)  # at once


def test_what_is_left_is_compensated_up_to_a_bound():
    """Whatever winds it up, it is back as soon as the cause has gone."""
    gains, left = jaxftc.default_gains(config()).replace({"control.rate": 150.0}), np.repeat([[1e4, -1e4, 2.0]], 60, 0)
    left[40:] = 0.0
    found = compensated(gains, 0 * left, left)
    np.testing.assert_allclose(found[39], [compensation.MOST, -compensation.MOST, 2.0], rtol=0.01)
    np.testing.assert_allclose(found[-1], np.exp(-0.15 * 20) * found[39], rtol=1e-6)


def test_at_rate_0_it_is_psi_to_the_last_bit():
    psi, left = signals()
    found = compensated(jaxftc.default_gains(config()).replace({"control.rate": 0.0}), psi, left)
    np.testing.assert_array_equal(found, psi)


@pytest.mark.parametrize("rate", [0.0, 150.0])
def test_its_gradient_is_that_of_differences(rate):
    gains, (psi, left) = jaxftc.default_gains(config()), signals(8)

    def last(rate):
        return compensated(gains.replace({"control.rate": rate * jnp.ones(3)}), psi, left)[-1]

    check_grads(last, (jnp.asarray(rate),), order=1, modes=("fwd", "rev"), rtol=1e-5)
    assert (jnp.abs(jax.jacobian(last)(rate)) > 0).all()


def test_a_suspect_reading_says_nothing_of_the_torque():
    made = config()
    gains, calm = jaxftc.default_gains(made), sensor_check.nothing_found(jnp.zeros(3))
    estimate = jaxftc.observer.cascade.Estimate(*[jnp.full(3, 0.01)] * 12)._replace(b=jnp.array([0.0, 0.0, 9e-4]))
    suspect = calm._replace(suspect=jnp.array([0.0, 1.0, 0.0]))
    found = cascade._to_compensate(made, gains, suspect, estimate, stages.of(made))
    weight = np.asarray(adaptation.not_in_psi(made, gains))
    np.testing.assert_allclose(found.left, 0.01 * weight * np.array([1, 0, 1]))
    faulty = estimate._replace(b=jnp.array([0.0, -0.01, 1.1e-3]))  # rad; the third is just more than a jump
    found = cascade._to_compensate(made, gains, calm, faulty, stages.of(made))
    np.testing.assert_allclose(found.left, 0.01 * weight * np.array([1, 0, 0]))
    torque = jaxftc.Config(three_hinges(), engine="chain", input="torque")  # psi holds gravity there
    for part in cascade._to_compensate(torque, jaxftc.default_gains(torque), calm, estimate, stages.of(torque)):
        np.testing.assert_array_equal(part, 0.0)
    blind = config(observer="eso")  # without an estimate of encoder faults
    left = cascade._to_compensate(blind, jaxftc.default_gains(blind), calm, estimate, stages.of(blind)).left
    np.testing.assert_array_equal(left, 0.0)


@pytest.fixture(scope="module")
def linear():
    """PI, whose recursion is that of every stage while the others are quiet; the config that compensates; gains."""
    made = config(observer="pi")
    return made, config(), jaxftc.default_gains(made).replace({"control.rate": np.array([0.0, 50.0, 300.0])})


@pytest.mark.parametrize("frequency", [10.0, 40.0])
def test_its_response_is_that_of_the_recursion(linear, frequency):
    made, whole, gains = linear
    sine = np.sin(2 * np.pi * frequency * made.dt * np.arange(600))[:, None] * np.ones(3)
    e, psi = run(made, gains, 0 * sine, sine)
    found = np.asarray(compensated(gains, psi, e * np.asarray(adaptation.not_in_psi(made, gains))))
    share = amplitude(found, frequency, made.dt) / amplitude(sine, frequency, made.dt)
    response = frequency_response(whole, gains, np.array([frequency]))
    np.testing.assert_allclose(share, response.compensated[:, 0], rtol=0.02)
    np.testing.assert_allclose(response.compensated[0], response.fault[0])  # at rate 0
    alone = frequency_response(made, gains, np.array([frequency]))
    np.testing.assert_array_equal(alone.compensated, alone.fault)


def test_the_rate_raises_the_bandwidth_and_leaves_the_diagnosis_alone(linear):
    _, whole, gains = linear
    response = frequency_response(whole, gains, np.geomspace(0.1, 3.0, 30))
    reaches = np.abs(1 - response.compensated)  # the arm
    assert (reaches[1] < reaches[0]).all() and (reaches[2] < reaches[1]).all()
    np.testing.assert_array_equal(response.fault[0], response.fault[2])
    np.testing.assert_allclose(frequency_response(whole, gains, np.array([0.01])).compensated, 1.0, atol=0.01)


def loop(made, gains, inertia, fuzzy, reaching, most=np.inf):
    """One tick of joint 1 under ESMC in its boundary layer, and the size of its state; the arm's inertia is off by a factor.

    An acceleration v is commanded, v / inertia is made. ``reaching`` 1/s is alpha / eps. Linear where l is not bounded.
    """
    dt, own, control = made.dt, gains.observer, gains.control
    one = lambda x: float(np.asarray(x).reshape(made.n, -1)[0, 0])  # noqa: E731
    xi, alpha_p, rate = one(gains.arx.xi_a), one(own.alpha_p), one(control.rate)
    (a, b_a), (b, b_b) = (map(np.asarray, bank_matrices(xi, order)) for order in (made.order_a, made.order_b))
    kappa_a, kappa_b = np.asarray(gains.arx.kappa_a)[0], np.asarray(gains.arx.kappa_b)[0, 0]
    share, weight = 1 - np.exp(-rate * dt), alpha_p * ((1 - xi) / dt) ** 2

    def tick(state):
        q, qd, psi_i, psi_f, ahead, speed, before, v, psi = state[:9]
        x_a, x_b = state[9 : 9 + made.order_a], state[9 + made.order_a :]
        acceleration = v + psi + ahead
        x_b = b @ x_b + b_b * (v + psi)
        y_hat = kappa_a @ x_a + kappa_b @ x_b
        e, psi = q - y_hat, psi_i + fuzzy * psi_f
        ahead = np.clip(ahead + share * (weight * e - ahead), -most, most)
        predicted = speed + dt * acceleration
        measured = (q - before) / dt + 0.5 * dt * acceleration
        speed = predicted + one(control.speed_weight) * (measured - predicted)
        s = one(control.lam) * q + speed
        v = -one(control.lam) * speed - reaching * s - psi - ahead
        x_a = a @ x_a + b_a * (y_hat + alpha_p * e)
        drives = one(own.alpha_i), fuzzy * one(own.alpha_f1)
        psi_i, psi_f = psi_i + drives[0] * e, fuzzy * (1 - one(own.leak)) * psi_f + drives[1] * e
        turned = qd + dt * v / inertia
        return np.concatenate([[q + dt * turned, turned, psi_i, psi_f, ahead, speed, q, v, psi], x_a, x_b])

    return tick, 9 + made.order_a + made.order_b


def closed_loop(made, gains, inertia, fuzzy, reaching):
    """Largest modulus of a pole of that loop."""
    tick, size = loop(made, gains, inertia, fuzzy, reaching)
    matrix = np.stack([tick(row) for row in np.eye(size)], axis=1)
    if float(gains.control.rate[0]) == 0:  # l stays 0 then: no pole
        matrix = np.delete(np.delete(matrix, 4, 0), 4, 1)
    return np.abs(np.linalg.eigvals(matrix)).max()


@pytest.mark.parametrize("dt", RATES)
def test_the_loop_is_stable_at_every_rate_with_another_inertia(dt):
    made = config(dt)
    gains = jaxftc.default_gains(made)
    for rate in (0.0, 150.0, 1e4):
        tried = gains.replace({"control.rate": rate})
        for inertia in (0.6, 1.0, 1.6):
            for fuzzy in (0.0, 1.0):
                reaching = 1.5 * float(gains.control.alpha_sm2[0] / gains.control.eps[0])
                assert closed_loop(made, tried, inertia, fuzzy, reaching) < 1, (rate, inertia, fuzzy)


@pytest.mark.parametrize("dt", RATES)
def test_at_80_per_second_the_inertia_may_be_off_by_more_than_a_factor_of_two(dt):
    made = config(dt)
    gains = jaxftc.default_gains(made).replace({"control.rate": 80.0})
    reaching = 1.5 * float(gains.control.alpha_sm2[0] / gains.control.eps[0])
    for inertia in (0.5, 1.0, 2.3):
        for fuzzy in (0.0, 1.0):
            assert closed_loop(made, gains, inertia, fuzzy, reaching) < 1, (inertia, fuzzy)


def test_beyond_that_the_bound_keeps_the_loop_from_running_away():
    """An inertia of four times the model's: with psi alone the loop is stable, and with l it shakes within the bound."""
    made = config()
    gains, ends = jaxftc.default_gains(made).replace({"control.rate": 80.0}), {}
    assert closed_loop(made, gains.replace({"control.rate": 0.0}), 4.0, 1.0, 30.0) < 1
    for most in (compensation.MOST, np.inf):
        tick, size = loop(made, gains, 4.0, 1.0, 30.0, most)
        state, errors = np.zeros(size), []
        state[0] = 0.01
        for _ in range(3000):
            state = tick(state)
            errors.append(abs(state[0]))
        ends[most] = max(errors[-500:])
    assert ends[compensation.MOST] < np.deg2rad(1)
    assert ends[np.inf] > np.deg2rad(100)


def test_compensation_moves_no_pole_of_an_arm_that_is_as_modelled():
    """The command that holds l is known to the observer, so its poles and the law's stay; l adds its own."""
    made = config()
    gains = jaxftc.default_gains(made)
    slowest = [closed_loop(made, gains.replace({"control.rate": rate}), 1.0, 0.0, 30.0) for rate in (0.0, 100.0, 1e4)]
    np.testing.assert_allclose(slowest, slowest[0], rtol=1e-6)
