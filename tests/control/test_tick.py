"""The packed tick says what ``step`` says."""

import dataclasses
import multiprocessing

import jax
import numpy as np
import pytest

import jaxftc
from tests.arms import three_hinges
from tests.backends import BACKENDS


@pytest.fixture(scope="module")
def config() -> jaxftc.Config:
    return jaxftc.Config(three_hinges(), engine="chain")


@pytest.fixture(scope="module")
def loop(config):
    """(tick, gains, reference, readings [T, n] with one that did not come)."""
    gains = jaxftc.default_gains(config)
    angles = 0.01 * np.sin(np.arange(20)[:, None] / 3 + np.arange(config.n))
    angles[7, 2] = np.nan
    reference = jaxftc.Reference(*(np.full(config.n, value) for value in (0.1, 0.0, 0.0)))
    return jaxftc.Tick(config, gains), gains, reference, angles


@pytest.mark.parametrize("backend", BACKENDS)
def test_it_is_step_bit_for_bit_in_shape_and_to_rounding_in_value(config, loop, backend):
    tick, gains, reference, angles = loop
    tick = tick if backend == "xla" else jaxftc.Tick(config, gains, backend=backend)
    step = jax.jit(jaxftc.step, static_argnums=0)
    packed, plain = tick.init(np.zeros(config.n)), jaxftc.init(config, gains, np.zeros(config.n))
    tau = np.zeros(config.n)
    for reading in angles:
        packed, ours = tick.step(packed, reference, jaxftc.Measurement(reading, tau))
        plain, theirs = step(config, gains, plain, reference, jaxftc.Measurement(reading, tau))
        for name, a, b in zip(ours._fields, ours, theirs, strict=True):
            assert (a.shape, a.dtype) == (b.shape, b.dtype), name
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12, err_msg=name)
        tau = np.asarray(ours.tau)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("scheme", ["momentum", pytest.param("ekf", marks=pytest.mark.thorough), "computed_torque"])
def test_every_scheme_has_one(config, scheme, backend):
    config = dataclasses.replace(config, scheme=scheme)
    tick = jaxftc.Tick(config, jaxftc.default_gains(config), backend=backend)
    still = np.zeros(config.n)
    state, out = tick.step(tick.init(still), jaxftc.Reference(still, still, still), jaxftc.Measurement(still, still))
    assert np.isfinite(out.tau).all() and np.isfinite(jax.device_get(state)).all()


@pytest.mark.parametrize("decision, most", [("rule", 8), pytest.param("learned", 24, marks=pytest.mark.thorough)])
def test_few_reductions_are_in_it(config, loop, decision, most):
    """XLA allocates three buffers a call for each: one for every array of the state took as long as all the rest."""
    config = dataclasses.replace(config, decision=decision)
    tick = loop[0] if decision == "rule" else jaxftc.Tick(config, jaxftc.default_gains(config))
    assert 0 < tick._step.as_text().count(" reduce(") <= most


def test_what_is_not_one_arm_is_refused(config, loop):
    tick, _, reference, angles = loop
    state = tick.init(angles[0])
    with pytest.raises(ValueError, match=r"measurement.q.*\[3\].*got \[2\]"):
        tick.step(state, reference, jaxftc.Measurement(angles[0, :2], angles[0]))
    with pytest.raises(ValueError, match=r"q must have shape \[3\]"):
        tick.init(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="q must be finite"):
        tick.init(angles[7])
    with pytest.raises(ValueError, match=r"Tick.init.*\[\d+\], got \[1\]"):
        tick.step(state[:1], reference, jaxftc.Measurement(angles[0], angles[0]))


def test_a_torque_that_is_not_known_is_the_last_command_and_a_masked_value_is_not_read(config, loop):
    tick, _, reference, _ = loop
    angles, state = np.zeros(config.n), tick.init(np.zeros(config.n))
    masked = np.ma.masked_array(np.full(config.n, 0.3), mask=[False, True, False])

    def torque(q, tau=None):
        told = reference, jaxftc.Measurement(q, tau)
        return tick.step(tick.step(state, *told)[0], *told)[1].tau

    nan = np.full(config.n, np.nan)
    np.testing.assert_array_equal(torque(angles), torque(angles, nan))
    np.testing.assert_array_equal(torque(angles, np.ma.masked_all(config.n)), torque(angles, nan))
    assert not np.array_equal(torque(angles, 0 * angles), torque(angles, nan))
    np.testing.assert_array_equal(torque(masked), torque(np.where(masked.mask, np.nan, 0.3)))


def test_a_state_that_is_lost_starts_anew_and_says_so(config, loop):
    tick, _, reference, _ = loop
    still = np.zeros(config.n)
    state = np.array(tick.init(still))
    _, healthy = tick.step(state, reference, jaxftc.Measurement(still))
    for number in (np.nan, np.inf, -1e30):
        for place in range(0, len(state), 7):
            spoilt = state.copy()
            spoilt[place] = number
            after, out = tick.step(spoilt, reference, jaxftc.Measurement(still))
            assert (out.verdict == jaxftc.Verdict.UNKNOWN).all() and out.detected
            assert out.verdict.dtype == np.int32 and jaxftc.Verdict(out.verdict[0]).label == "unknown"
            assert np.isfinite(np.asarray(after)).all()
            np.testing.assert_allclose(out.tau, healthy.tau)  # it was at rest there
            assert (tick.step(after, reference, jaxftc.Measurement(still, out.tau))[1].verdict == 0).all()
    _, out = tick.step(np.full_like(state, np.nan), reference, jaxftc.Measurement(np.full(config.n, np.nan)))
    assert np.isfinite(out.tau).all() and (out.verdict == jaxftc.Verdict.UNKNOWN).all()


def test_arguments_of_another_kind_are_refused(config, loop):
    tick, gains, reference, angles = loop
    measurement, state = jaxftc.Measurement(angles[0], angles[0]), tick.init(angles[0])
    for step in (tick.step, lambda *told: jaxftc.step(config, gains, jaxftc.init(config, gains, angles[0]), *told[1:])):
        with pytest.raises(ValueError, match=r"Reference, got a Measurement.*order"):
            step(state, measurement, reference)
        with pytest.raises(ValueError, match="measurement must be a Measurement, got a tuple"):
            step(state, reference, (angles[0],))
        with pytest.raises(ValueError, match="reference must be a Reference, got a NoneType"):
            step(state, None, measurement)
    with pytest.raises(ValueError, match=r"Tick.init.*\[\d+\], got a NoneType"):
        tick.step(None, reference, measurement)
    for call in (jaxftc.Tick, lambda c, g: jaxftc.init(c, g, angles[0]), lambda c, g: jaxftc.identify.fit_batch(c, g, None)):
        with pytest.raises(ValueError, match="config must be a Config, got a NoneType"):
            call(None, gains)
        with pytest.raises(ValueError, match=r"Config, got a Gains.*order"):
            call(gains, config)
        with pytest.raises(ValueError, match="gains must be a Gains, got a NoneType"):
            call(config, None)
    with pytest.raises(ValueError, match="log must be a Log, got a tuple"):
        jaxftc.identify.fit_batch(config, gains, (angles, angles))


@pytest.mark.parametrize("change", [{"adaptive": True}, {"decision": "learned"}, {"order_b": 3}])
def test_a_state_of_another_config_is_refused(config, loop, change):
    _, _, reference, angles = loop
    configs = config, dataclasses.replace(config, **change)
    both = [(config, jaxftc.default_gains(config)) for config in configs]
    for (mine, gains), (its, other) in (both, both[::-1]):
        state = jaxftc.init(its, other, angles[0])
        with pytest.raises(ValueError, match=r"state\.\S+ is (of shape|absent).*must be.*init with the same config"):
            jaxftc.step(mine, gains, state, reference, jaxftc.Measurement(angles[0]))
    with pytest.raises(ValueError, match="state must be a State, got a tuple; arguments in another order"):
        jaxftc.Diagnoser(*both[0]).step((), angles[0], angles[0])


def _in_a_child(pipe, calls):
    for call in calls:
        try:
            pipe.send(str(call()))
        except RuntimeError as error:
            pipe.send(str(error))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="this system cannot fork")
@pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning", "ignore:.*fork:DeprecationWarning")
def test_a_forked_process_is_refused_at_once(config, loop):
    tick, gains, reference, angles = loop
    state = tick.init(angles[0])
    measurement = jaxftc.Measurement(angles[0])
    calls = (
        lambda: tick.step(state, reference, measurement),
        lambda: tick.init(angles[0]),
        lambda: jaxftc.Tick(config, gains),
    )
    here, there = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=_in_a_child, args=(there, calls))
    child.start()
    try:
        for _ in calls:
            assert here.poll(20), "hangs"
            assert "this process was forked" in (said := here.recv()) and "spawn" in said
    finally:
        child.kill()
        child.join()


def test_an_unknown_backend_and_a_missing_compiler_are_refused(config, loop, monkeypatch):
    gains = loop[1]
    with pytest.raises(ValueError, match="backend must be one of 'xla', 'c', got 'gcc'"):
        jaxftc.Tick(config, gains, backend="gcc")
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(ValueError, match="no C compiler: CC is 'no-such-compiler'"):
        jaxftc.Tick(config, gains, backend="c")
