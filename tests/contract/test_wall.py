"""The wall: a tick knows the reference, the reading, its last command and its own past, and nothing else."""

import dataclasses
import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc.scenarios.faults import Actuator, Sensor
from jaxftc.scenarios.reference import cubic
from jaxftc.variants import SCHEMES
from tests.arms import two_hinges

N, KEY = two_hinges().n, 11
ONSET = 30  # tick

# A size for every kind of fault, in its own unit.
TORQUES = {
    Actuator.BIAS: 5.0,
    Actuator.LOSS: 0.5,
    Actuator.STUCK: 0.0,
    Actuator.SATURATION: 0.05,
    Actuator.GAIN: -0.3,
    Actuator.RIPPLE: 5.0,
    Actuator.FRICTION: 5.0,
    Actuator.LOCKED: 0.0,
    Actuator.DELAY: 4.0,
}
ANGLES = {
    Sensor.BIAS: 0.03,
    Sensor.DRIFT: 1.0,
    Sensor.SCALE: 0.05,
    Sensor.FREEZE: 0.0,
    Sensor.NOISE: 50.0,
    Sensor.DROPOUT: 0.0,
    Sensor.ROUNDING: 0.01,
    Sensor.WRAP: 0.001,
    Sensor.DELAY: 4.0,
    Sensor.CROSSTALK: 0.1,
}
FAULTS = [("fault_tau", kind, size) for kind, size in TORQUES.items()] + [("fault_q", k, size) for k, size in ANGLES.items()]


@pytest.fixture(scope="module")
def config() -> jaxftc.Config:
    """In place of the PUMA that other tests share."""
    return jaxftc.Config(two_hinges(), engine="chain", duration=0.06)


@pytest.fixture(scope="module")
def gains(config) -> jaxftc.Gains:
    return jaxftc.default_gains(config)


@pytest.fixture(scope="module")
def healthy(config) -> jaxftc.Scenario:
    return jaxftc.paper_scenario("healthy", config)


@pytest.fixture(scope="module")
def run(config, gains):
    return lambda scenario: jax.tree.map(np.asarray, jaxftc.simulate(config, gains, scenario, jax.random.key(KEY)))


def with_fault(scenario: jaxftc.Scenario, channel: str, kind: int, size: float, onset: float) -> jaxftc.Scenario:
    """That fault on all joints from onset s on, for good."""
    fault = getattr(scenario, channel)
    fault = fault._replace(
        kind=jnp.full(N, kind, jnp.int32), magnitude=jnp.full(N, float(size)), onset=jnp.full(N, onset - 1e-6)
    )
    return scenario._replace(**{channel: fault})


def told(config, scenario: jaxftc.Scenario, gains, trace: jaxftc.Trace) -> tuple[jaxftc.Reference, jaxftc.Measurement]:
    """All that crossed the wall in a run: reference, reading and last command, [T, n]."""
    reference = jax.vmap(lambda t: cubic(scenario.q_start, scenario.q_goal, config.t_final, t))(trace.t)
    first = np.asarray(jaxftc.init(config, gains, scenario.q_start).command.tau)
    limit = config.robot.torque_limit
    return reference, jaxftc.Measurement(trace.y, np.vstack([np.clip(first, -limit, limit), trace.out.tau[:-1]]))


@pytest.fixture(scope="module")
def replay(config, gains, healthy):
    """Outputs [T, ...] of the tick alone, on what it was told: one program for every log."""

    @jax.jit
    def outputs(reference, measurement):
        def body(state, x):
            return jaxftc.step(config, gains, state, *x)

        start = jaxftc.init(config, gains, healthy.q_start)
        return jax.lax.scan(body, start, (reference, measurement))[1]

    return lambda log: jax.tree.map(np.asarray, outputs(*log))


def assert_same(one, other) -> None:
    """Bit for bit."""
    jax.tree.map(np.testing.assert_array_equal, one, other)


def differ(one, other) -> bool:
    return any(
        not np.array_equal(a, b, equal_nan=True) for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    )


def test_the_tick_takes_no_scenario_and_no_truth():
    assert list(inspect.signature(jaxftc.step).parameters) == ["config", "gains", "state", "reference", "measurement"]
    assert list(inspect.signature(jaxftc.init).parameters) == ["config", "gains", "q"]
    assert jaxftc.Measurement._fields == ("q", "tau")
    assert jaxftc.Reference._fields == ("q", "qd", "qdd")


@pytest.mark.parametrize("signal", ["reference", "reading", "torque"])
def test_no_output_depends_on_what_comes_later(config, gains, healthy, run, replay, signal):
    reference, measurement = told(config, healthy, gains, run(healthy))
    before = replay((reference, measurement))
    if signal == "reference":
        reference = jax.tree.map(lambda x: x.at[ONSET:].add(0.1), reference)
    elif signal == "reading":
        measurement = measurement._replace(q=measurement.q + 0.01 * (np.arange(config.ticks) >= ONSET)[:, None])
    else:
        measurement = measurement._replace(tau=measurement.tau + 1.0 * (np.arange(config.ticks) >= ONSET)[:, None])
    after = replay((reference, measurement))
    assert_same(*(jax.tree.map(lambda x: x[:ONSET], out) for out in (before, after)))
    assert differ(*(jax.tree.map(lambda x: x[ONSET], out) for out in (before, after))), "the change must reach its own tick"


@pytest.mark.parametrize(("channel", "kind", "size"), FAULTS, ids=lambda value: getattr(value, "name", str(value)))
def test_nothing_is_known_of_a_fault_before_it_comes(config, run, healthy, channel, kind, size):
    """Everything until then is bit for bit the healthy run: nobody looks ahead into the scenario."""
    well, ill = run(healthy), run(with_fault(healthy, channel, kind, size, ONSET * config.dt))
    assert_same(*(jax.tree.map(lambda x: x[:ONSET], trace) for trace in (well, ill)))
    # A wrong torque acts on the arm after the tick in which it comes, a wrong reading in that tick.
    if channel == "fault_tau":
        assert_same(*(jax.tree.map(lambda x: x[ONSET], trace.out) for trace in (well, ill)))
    assert differ(*(jax.tree.map(lambda x: x[ONSET:], trace.out) for trace in (well, ill))), "the fault must do something"


@pytest.mark.parametrize(("channel", "kind", "size"), FAULTS, ids=lambda value: getattr(value, "name", str(value)))
def test_what_it_was_told_explains_every_output(config, gains, run, replay, healthy, channel, kind, size):
    """A run's outputs follow from its log alone, so nothing else can have reached the tick."""
    scenario = with_fault(healthy, channel, kind, size, ONSET * config.dt)
    trace = run(scenario)
    again = replay(told(config, scenario, gains, trace))
    for name, mine, theirs in zip(trace.out._fields, again, trace.out, strict=True):
        if np.issubdtype(theirs.dtype, np.floating):
            scale = np.abs(theirs).max() + 1e-9
            np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-9 * scale, err_msg=name)
        else:
            np.testing.assert_array_equal(mine, theirs, err_msg=name)


@pytest.mark.parametrize(
    "scheme",
    [pytest.param(name, marks=[pytest.mark.slow] * (name == "ekf")) for name in SCHEMES if name != "cascade"],
)
def test_the_wall_stands_for_every_scheme(config, gains, healthy, scheme):
    """Outputs follow from the log alone, and from nothing that comes later; both kinds of fault at once."""
    config = dataclasses.replace(config, scheme=scheme)
    ill = with_fault(healthy, "fault_tau", Actuator.BIAS, 5.0, ONSET * config.dt)
    ill = with_fault(ill, "fault_q", Sensor.BIAS, 0.03, (ONSET + 5) * config.dt)
    trace = jax.tree.map(np.asarray, jaxftc.simulate(config, gains, ill, jax.random.key(KEY)))
    reference, measurement = told(config, ill, gains, trace)

    @jax.jit
    def replay(reference, measurement):
        start = jaxftc.init(config, gains, healthy.q_start)
        return jax.lax.scan(lambda state, x: jaxftc.step(config, gains, state, *x), start, (reference, measurement))[1]

    again = replay(reference, measurement)
    for name, mine, theirs in zip(trace.out._fields, again, trace.out, strict=True):
        scale = np.abs(theirs[np.isfinite(theirs)]).max(initial=0.0) + 1e-9
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-9 * scale, err_msg=name)
    later = (np.arange(config.ticks) >= ONSET)[:, None]
    other = replay(
        jax.tree.map(lambda x: x + 0.1 * later, reference),
        jaxftc.Measurement(measurement.q + 0.01 * later, measurement.tau + 1.0 * later),
    )
    assert_same(*(jax.tree.map(lambda x: x[:ONSET], out) for out in (again, other)))
    assert differ(*(jax.tree.map(lambda x: x[ONSET], out) for out in (again, other)))


def test_two_worlds_that_look_the_same_get_the_same_answer(run, healthy):
    """Half of every torque lost, or motors half as strong: other truths, the same readings, the same outputs bit for bit.

    Of all shares a half is exact: whether a product is rounded before it is added to something is up to the compiler.
    """
    quiet = healthy._replace(noise=jnp.zeros(()))
    lossy = with_fault(quiet, "fault_tau", Actuator.LOSS, 0.5, 0.0)._replace(id=jnp.asarray(7, jnp.int32))
    weak = quiet._replace(plant=quiet.plant._replace(torque_constant=jnp.full(N, 0.5)))
    one, other = run(lossy), run(weak)
    assert np.abs(one.fault_tau).max() > 1.0 and not np.any(other.fault_tau), "the truths differ"
    assert_same((one.y, one.out), (other.y, other.out))


def test_true_values_stay_with_the_trace(run, healthy):
    """With noise only the reading, not the angle, is what the tick had: its estimate starts from the reading."""
    trace = run(healthy)
    assert np.abs(trace.y - trace.q).max() > 1e-5
    np.testing.assert_allclose(trace.out.q_hat[0] + trace.out.fault_q_hat[0], trace.y[0], rtol=0, atol=1e-12)
