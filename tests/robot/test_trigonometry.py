"""Cosine and sine by polynomials against the C library's, with their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jax.test_util import check_grads

from jaxftc.numerics.trigonometry import cos_sin

angles = st.floats(-6e3, 6e3, width=32, allow_subnormal=False)


@given(st.lists(angles, min_size=20, max_size=20))  # one shape: another one compiles again
def test_single_precision_is_right_to_two_units_in_the_last_place(x):
    x = np.array(x, np.float32)
    for ours, theirs in zip(cos_sin(jnp.asarray(x)), (np.cos(x.astype(float)), np.sin(x.astype(float))), strict=True):
        assert ours.dtype == jnp.float32
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1.2e-7)


def test_around_every_quarter_turn():
    x = (np.arange(-40, 41)[:, None] * np.pi / 4 + np.linspace(-1e-3, 1e-3, 7)).astype(np.float32)
    cosine, sine = cos_sin(jnp.asarray(x))
    np.testing.assert_allclose(cosine, np.cos(x.astype(float)), rtol=0, atol=1.2e-7)
    np.testing.assert_allclose(sine, np.sin(x.astype(float)), rtol=0, atol=1.2e-7)


def test_no_angle_gives_more_than_one_and_none_gives_none():
    cosine, sine = cos_sin(jnp.asarray([1e8, -3e20, 3e38, np.inf, np.nan], jnp.float32))
    assert (np.abs(cosine[:3]) <= 1).all() and (np.abs(sine[:3]) <= 1).all()
    assert np.isnan(cosine[3:]).all() and np.isnan(sine[3:]).all()


def test_double_precision_is_the_library_s():
    x = jnp.linspace(-9, 9, 50)
    np.testing.assert_array_equal(cos_sin(x), (jnp.cos(x), jnp.sin(x)))


@pytest.mark.parametrize("x", [-2.5, 0.0, 0.3, np.pi / 4, 10.0])
def test_derivatives(x):
    check_grads(cos_sin, (x,), order=2, modes=("fwd", "rev"), eps=1e-5, rtol=1e-5)
    slope = jax.jvp(cos_sin, (jnp.float32(x),), (jnp.float32(1.0),))[1]
    np.testing.assert_allclose(slope, (-np.sin(x), np.cos(x)), atol=2e-7)
