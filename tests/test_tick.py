"""The packed tick says what ``step`` says."""

import dataclasses

import jax
import numpy as np
import pytest

import jaxftc
from jaxftc.compile import native
from tests.arms import three_hinges

needs_c = pytest.mark.skipif(native.compiler() is None, reason="no C compiler on this machine")
BACKENDS = ["xla", pytest.param("c", marks=needs_c)]


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
@pytest.mark.parametrize("scheme", ["momentum", "ekf", "computed_torque"])
def test_every_scheme_has_one(config, scheme, backend):
    config = dataclasses.replace(config, scheme=scheme)
    tick = jaxftc.Tick(config, jaxftc.default_gains(config), backend=backend)
    still = np.zeros(config.n)
    state, out = tick.step(tick.init(still), jaxftc.Reference(still, still, still), jaxftc.Measurement(still, still))
    assert np.isfinite(out.tau).all() and np.isfinite(jax.device_get(state)).all()


def test_what_is_not_one_arm_is_refused(config, loop):
    tick, _, reference, angles = loop
    state = tick.init(angles[0])
    with pytest.raises(ValueError, match=r"measurement.q must have shape \[3\], one arm's joints, got \[2\]"):
        tick.step(state, reference, jaxftc.Measurement(angles[0, :2], angles[0]))
    with pytest.raises(ValueError, match=r"q must have shape \[3\]"):
        tick.init(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="q must be finite"):
        tick.init(angles[7])
    with pytest.raises(ValueError, match=r"state must come from Tick.init, shape \[\d+\], got \[1\]"):
        tick.step(state[:1], reference, jaxftc.Measurement(angles[0], angles[0]))


def test_an_unknown_backend_and_a_missing_compiler_are_refused(config, loop, monkeypatch):
    gains = loop[1]
    with pytest.raises(ValueError, match="backend must be one of 'xla', 'c', got 'gcc'"):
        jaxftc.Tick(config, gains, backend="gcc")
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(ValueError, match="no C compiler: CC is 'no-such-compiler'"):
        jaxftc.Tick(config, gains, backend="c")
