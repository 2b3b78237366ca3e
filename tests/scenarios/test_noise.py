"""Encoder noise drawn tick by tick: JAX's own numbers, whatever the shape of the scenarios and the kind of key."""

import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special

from jaxftc.simulation import noise

TICKS = 40


@functools.partial(jax.jit, static_argnums=2)
def run(key, ids, n):
    """All noise [T, n, ...] of some scenarios, as the loop draws it."""
    stream = noise.streams(key, ids)
    return jax.vmap(lambda k: noise.normal(stream, k, n))(jnp.arange(TICKS))


@given(st.integers(0, 2**63 - 1), st.integers(0, 2**32 - 1), st.sampled_from([1, 6, 7]))
def test_the_numbers_are_those_of_jax(seed, scenario, n):
    key = jax.random.key(seed)
    theirs = jax.random.normal(jax.random.fold_in(key, jnp.uint32(scenario)), (TICKS, n), jnp.float32)
    np.testing.assert_allclose(run(key, jnp.uint32(scenario), n), theirs, rtol=1e-5, atol=1e-7)  # as exact as JAX's


def test_the_inverse_error_function_is_exact_to_rounding():
    ends = np.nextafter(np.float32([-1, 1]), np.float32(0))
    x = np.concatenate([ends, np.linspace(-1, 1, 200_003, dtype=np.float32)[1:-1]])
    exact = special.erfinv(x.astype(float))
    np.testing.assert_allclose(noise._erf_inv(jnp.asarray(x)), exact, rtol=5e-7, atol=1e-12)


@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_each_scenario_has_its_own_whatever_is_beside_it(shape):
    ids = 7 * jnp.arange(np.prod(shape, dtype=int)).reshape(shape)
    together = run(jax.random.key(1), ids, 6)
    chex.assert_shape(together, (TICKS, 6, *shape))
    for index in np.ndindex(shape):
        np.testing.assert_allclose(together[:, :, *index], run(jax.random.key(1), ids[index], 6), rtol=1e-6, atol=1e-7)


def test_old_keys_and_other_generators_work():
    ids = jnp.arange(3)
    np.testing.assert_array_equal(run(jax.random.PRNGKey(4), ids, 6), run(jax.random.key(4), ids, 6))
    other = run(jax.random.key(4, impl="rbg"), ids, 6)
    assert abs(float(other.std()) - 1) < 0.1 and np.unique(other).size > 0.99 * other.size


def test_they_are_normal_and_independent():
    drawn = np.asarray(run(jax.random.key(0), jnp.arange(200), 6), float)
    count = drawn.size
    assert abs(drawn.mean()) < 4 / count**0.5
    assert abs(drawn.std() - 1) < 4 / (2 * count) ** 0.5
    assert abs(np.mean(drawn**4) - 3) < 4 * (96 / count) ** 0.5
    for axis in range(3):
        one, next_one = np.delete(drawn, 0, axis), np.delete(drawn, -1, axis)
        assert abs(np.mean(one * next_one)) < 4 / count**0.5
