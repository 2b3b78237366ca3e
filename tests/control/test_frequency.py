"""The observer in the frequency domain, against its own recursion in time and against what must be true of any loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc import stages
from jaxftc.diagnosis import sensor_check
from jaxftc.observer import cascade
from jaxftc.observer.frequency import frequency_response, margins
from jaxftc.observer.stability import spectral_radius
from tests.arms import three_hinges


@pytest.fixture(scope="module")
def pi():
    """Three joints with gains that differ, on the linear observer."""
    config = jaxftc.Config(three_hinges(), engine="chain", observer="pi")
    factors = jnp.asarray([0.5, 1.0, 1.5])
    gains = jaxftc.default_gains(config)
    return config, gains.replace({"observer.alpha_i": factors * gains.observer.alpha_i})


def run(config, gains, y, d):
    """Innovation and psi [T, n] of the cascade's own recursion, for reading errors and unknown accelerations [T, n]."""
    on, still = stages.of(config), jnp.zeros(config.n)
    calm = sensor_check.nothing_found(still)

    def tick(carry, told):
        state, angle, speed = carry
        reading, fault = told
        state, seen = cascade.correct(config, gains, state, cascade.Reading(angle + reading, still, calm), on)
        state = cascade.adapt(config, gains, state, seen, still, gains.diagnosis.alpha_tau, on)
        state = cascade.apply_input(gains, state, seen.psi)
        speed = speed + config.dt * fault
        return (state, angle + config.dt * speed, speed), (seen.e, seen.psi)

    start = cascade.init(config, gains, still), still, still
    return [np.asarray(x) for x in jax.jit(jax.lax.scan, static_argnums=0)(tick, start, (y, d))[1]]


def amplitude(signal, frequency, dt):
    """Complex amplitude of a settled sine over whole periods."""
    turns = np.exp(-2j * np.pi * frequency * dt * np.arange(len(signal)))
    whole = round(1 / (frequency * dt))
    last = slice(len(signal) - whole * (len(signal) // (2 * whole)), None)
    return 2 * (signal * turns[:, None])[last].mean(0)


@pytest.mark.parametrize("frequency", [10.0, 40.0])
def test_responses_are_those_of_the_recursion(pi, frequency):
    config, gains = pi
    response = frequency_response(config, gains, [frequency])
    sine = np.sin(2 * np.pi * frequency * config.dt * np.arange(600))[:, None] * np.ones(config.n)
    unit = amplitude(sine, frequency, config.dt)
    e, psi = run(config, gains, 1e-3 * sine, 0 * sine)
    np.testing.assert_allclose(amplitude(e, frequency, config.dt) / (1e-3 * unit), response.innovation[:, 0], rtol=0.01)
    np.testing.assert_allclose(amplitude(psi, frequency, config.dt) / (1e-3 * unit), response.noise[:, 0], rtol=0.01)


def test_an_unknown_acceleration_ends_in_psi(pi):
    """In time, a step; in frequency, F tends to 1 at low frequency and to 0 at high."""
    config, gains = pi
    _, psi = run(config, gains, np.zeros((600, config.n)), np.ones((600, config.n)))
    np.testing.assert_allclose(psi[-1], 1.0, atol=1e-3)
    fault = frequency_response(config, gains, [0.01, 499.0]).fault
    np.testing.assert_allclose(fault[:, 0], 1.0, atol=0.02)
    assert (np.abs(fault[:, 1]) < 0.01).all()


def test_margins_are_where_the_poles_leave_the_circle(pi):
    """The integral's gain alone is raised until the spectral radius is 1; the loop has to lose all its margin there."""
    config, gains = pi
    found = margins(config, gains)
    assert (found.gain_up > 1).all() and (found.gain_down < 1).all() and (found.phase > 5).all()
    assert (spectral_radius(config, gains) < 1).all()

    def raised(factor):
        return gains.replace({"observer.alpha_i": factor * gains.observer.alpha_i})

    low, high = np.ones(config.n), np.full(config.n, 1e3)
    for _ in range(40):
        middle = np.sqrt(low * high)
        stable = spectral_radius(config, raised(middle)) < 1
        low, high = np.where(stable, middle, low), np.where(stable, high, middle)
    at = margins(config, raised(low))
    assert (at.modulus < 0.02).all() and (at.phase < 2).all()
    assert (np.minimum(at.gain_up - 1, 1 - at.gain_down) < 0.02).all()


def test_sensitivity_and_loop_belong_together(pi):
    config, gains = pi
    response = frequency_response(config, gains, np.geomspace(1, 400, 50))
    np.testing.assert_allclose(response.innovation, 1 / (1 + response.loop), rtol=1e-9)
    assert (margins(config, gains).modulus <= 1 / np.abs(response.innovation).max(1) + 1e-9).all()


def test_the_fuzzy_stage_is_quicker_and_bears_less_loss_of_gain(pi):
    config, gains = pi
    config = jaxftc.Config(config.robot, engine="chain")
    off, on = (margins(config, gains, fuzzy=fuzzy) for fuzzy in (False, True))
    slow, quick = (frequency_response(config, gains, [20.0], fuzzy=fuzzy).fault for fuzzy in (False, True))
    assert (np.abs(quick) > np.abs(slow)).all() and (on.gain_down > off.gain_down).all() and (on.phase < off.phase).all()


@pytest.mark.parametrize("frequency", [0.0, 500.0, np.nan, [[1.0]]])
def test_a_frequency_outside_its_range_is_refused(pi, frequency):
    with pytest.raises(ValueError, match="below 500 Hz"):
        frequency_response(*pi, frequency)
