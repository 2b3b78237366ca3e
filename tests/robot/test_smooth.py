"""Sign, magnitude root and saturation: values and gradients, above all at their kinks."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jax.test_util import check_grads

from jaxftc.numerics import smooth

numbers = st.floats(-1e6, 1e6, allow_subnormal=False)  # XLA's CPU code flushes subnormal numbers to zero
widths = st.floats(1e-6, 1e3)


def derivative(f, x: float) -> float:
    return float(jax.grad(f)(x))


def test_sign_goes_through_zero_with_the_slope_of_its_width():
    assert float(smooth.sign(0.0, 0.1)) == 0.0
    assert derivative(lambda x: smooth.sign(x, 0.1), 0.0) == pytest.approx(10.0)
    assert derivative(lambda w: smooth.sign(0.0, w), 0.1) == 0.0


@pytest.mark.parametrize("x", [-5.0, -0.05, 0.0, 0.05, 5.0])
def test_sign_has_the_right_derivatives(x):
    check_grads(smooth.sign, (x, 0.1), order=1, modes=("fwd", "rev"), eps=1e-6, rtol=1e-6)


@given(numbers, numbers, widths)
def test_sign_is_odd_bounded_and_monotone(x, other, width):
    low, high = sorted((x, other))
    assert float(smooth.sign(-x, width)) == -float(smooth.sign(x, width))
    assert abs(float(smooth.sign(x, width))) <= 1.0
    assert float(smooth.sign(low, width)) <= float(smooth.sign(high, width))


@given(numbers, widths)
def test_sign_far_from_zero_and_the_hard_sign_are_the_printed_one(x, width):
    assert float(smooth.sign(x, width, hard=True)) == np.sign(x)
    if abs(x) > 20 * width:
        assert float(smooth.sign(x, width)) == np.sign(x)


def test_hard_sign_has_no_slope_anywhere():
    assert [derivative(lambda x: smooth.sign(x, 0.1, hard=True), x) for x in (-1.0, 0.0, 1.0)] == [0.0, 0.0, 0.0]


def test_magnitude_root_has_a_finite_slope_at_zero_in_both_modes():
    slope, value = jax.value_and_grad(smooth.magnitude_root)(0.0)[::-1]
    assert (float(value), float(slope)) == (0.0, 0.0)
    assert float(jax.jvp(smooth.magnitude_root, (0.0,), (1.0,))[1]) == 0.0
    assert derivative(smooth.magnitude_root, -0.0) == 0.0
    assert derivative(jax.grad(smooth.magnitude_root), 0.0) == 0.0


@pytest.mark.parametrize("x", [-4.0, -1e-3, 1e-3, 4.0])
def test_magnitude_root_has_the_right_derivatives(x):
    assert float(smooth.magnitude_root(x)) == pytest.approx(abs(x) ** 0.5, rel=1e-15)
    assert derivative(smooth.magnitude_root, x) == pytest.approx(np.sign(x) / (2 * abs(x) ** 0.5), rel=1e-12)


@given(numbers, numbers)
def test_magnitude_root_is_even_and_grows_with_the_magnitude(x, other):
    near, far = sorted((x, other), key=abs)
    assert float(smooth.magnitude_root(-x)) == float(smooth.magnitude_root(x))
    assert 0.0 <= float(smooth.magnitude_root(near)) <= float(smooth.magnitude_root(far))


def test_smallest_numbers_give_finite_roots_and_slopes():
    tiny = np.finfo(np.float64).tiny
    assert np.isfinite([float(smooth.magnitude_root(tiny)), derivative(smooth.magnitude_root, tiny)]).all()


@given(numbers, numbers, st.floats(1e-3, 1e3))
def test_saturation_is_odd_bounded_and_monotone_and_leaves_the_inside_alone(x, other, limit):
    low, high = sorted((x, other))
    clipped = float(smooth.saturate(x, limit))
    assert clipped == -float(smooth.saturate(-x, limit))
    assert clipped == (x if abs(x) <= limit else np.copysign(limit, x))
    assert float(smooth.saturate(low, limit)) <= float(smooth.saturate(high, limit))


def test_saturation_slopes_are_one_inside_zero_outside_and_finite_at_the_limit():
    slopes = [derivative(lambda x: smooth.saturate(x, 2.0), x) for x in (-3.0, -1.9, 0.0, 1.9, 3.0)]
    assert slopes == [0.0, 1.0, 1.0, 1.0, 0.0]
    by_limit = jax.grad(smooth.saturate, argnums=1)
    assert [float(by_limit(x, 2.0)) for x in (-3.0, 0.0, 3.0)] == [-1.0, 0.0, 1.0]
    for x in (-2.0, 2.0):
        assert 0.0 <= derivative(lambda y: smooth.saturate(y, 2.0), x) <= 1.0


def test_an_infinite_limit_is_no_limit():
    assert float(smooth.saturate(1e9, jnp.inf)) == 1e9
    assert derivative(lambda x: smooth.saturate(x, jnp.inf), 1e9) == 1.0


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_precision_is_kept(dtype):
    x = jnp.ones(3, dtype)
    assert {smooth.sign(x, x).dtype, smooth.magnitude_root(x).dtype, smooth.saturate(x, x).dtype} == {jnp.dtype(dtype)}
