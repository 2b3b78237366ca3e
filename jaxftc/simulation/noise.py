"""Encoder noise, tick by tick: the standard normal numbers of a scenario are a function of the key and its id alone.

The numbers are those of ``jax.random.normal(jax.random.fold_in(key, id), (ticks, n), jnp.float32)``, to 1e-5 of each (JAX's
inverse error function is no more exact), for JAX's own keys with ``jax_threefry_partitionable`` on, as it is. That call
would draw all of them before the loop, scenario by scenario, and store them; the same generator (threefry2x32, a hash of a
counter) written out gives those of one tick where they are needed, [n, ...] as everything else is. Of a key of another kind
the first two words are the generator's key.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxftc.numerics.barrier import store
from jaxftc.numerics.trigonometry import polynomial
from jaxftc.types import Array

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
# Polynomials, highest power first: the inverse error function over x, in w = -log(1 - x^2), near 0 and far out (Giles,
# Approximating the erfinv function, 2011); the logarithm less its first two terms over r^3 (Moshier's Cephes, logf).
_NEAR = (2.81022636e-8, 3.43273939e-7, -3.5233877e-6, -4.39150654e-6, 2.1858087e-4, -1.25372503e-3, -4.17768164e-3)
_NEAR += (0.246640727, 1.50140941)
_FAR = (-2.00214257e-4, 1.00950558e-4, 1.34934322e-3, -3.67342844e-3, 5.73950773e-3, -7.6224613e-3, 9.43887047e-3)
_FAR += (1.00167406, 2.83297682)
_LOG = (7.0376836292e-2, -1.1514610310e-1, 1.1676998740e-1, -1.2420140846e-1, 1.4249322787e-1, -1.6668057665e-1)
_LOG += (2.0000714765e-1, -2.4999993993e-1, 3.3333331174e-1)


def streams(key: Array, ids: Array) -> Array:
    """The generator's key [2, ...] uint32 of each scenario from ``ids`` [...]."""
    words = jax.vmap(lambda one: jax.random.key_data(jax.random.fold_in(key, one)))(ids.reshape(-1))
    return jnp.moveaxis(words, 0, -1)[:2].reshape(2, *ids.shape)


def normal(stream: Array, k: Array, n: int) -> Array:
    """Standard normal numbers [n, ...] float32 of tick k, from the streams [2, ...]."""
    joints = lax.iota(jnp.uint32, n).reshape(n, *[1] * (stream.ndim - 1))
    bits = _threefry(stream[0], stream[1], k.astype(jnp.uint32) * jnp.uint32(n) + joints)
    unit = lax.bitcast_convert_type((bits >> 9) | jnp.uint32(0x3F800000), jnp.float32) - 1  # [0, 1)
    low = np.nextafter(np.float32(-1), np.float32(0))
    return store(math.sqrt(2) * _erf_inv(store(jnp.maximum(low, unit * (np.float32(1) - low) + low))))


def _threefry(key_0: Array, key_1: Array, counter: Array) -> Array:
    """Thirty-two random bits from a key and a counter below 2^32: both halves of threefry2x32's block, xored."""
    schedule = (key_0, key_1, key_0 ^ key_1 ^ jnp.uint32(0x1BD11BDA))
    x, y = jnp.broadcast_to(key_0, jnp.broadcast_shapes(key_0.shape, counter.shape)), counter + key_1
    for group in range(5):
        for turn in _ROTATIONS[group % 2]:
            x = x + y
            y = x ^ ((y << turn) | (y >> (32 - turn)))
        x = x + schedule[(group + 1) % 3]
        y = y + schedule[(group + 2) % 3] + jnp.uint32(group + 1)
    return x ^ y


def _erf_inv(x: Array) -> Array:
    """Inverse error function of float32 numbers between -1 and 1; XLA's own takes a logarithm of eight at a time at most."""
    w = -_log((1 - x) * (1 + x))
    near = w < 5
    v = jnp.where(near, w - 2.5, jnp.sqrt(jnp.maximum(w, 5.0)) - 3)
    total = jnp.where(near, np.float32(_NEAR[0]), np.float32(_FAR[0]))
    for close, away in zip(_NEAR[1:], _FAR[1:], strict=True):
        total = total * v + jnp.where(near, np.float32(close), np.float32(away))
    return total * x


def _log(x: Array) -> Array:
    """Natural logarithm of positive, normal float32 numbers."""
    bits = lax.bitcast_convert_type(x, jnp.int32)
    exponent = (bits - 0x3F3504F3) >> 23  # so that what is left is between the roots of 1/2 and 2
    r = lax.bitcast_convert_type(bits - (exponent << 23), jnp.float32) - 1
    square = r * r
    return exponent.astype(jnp.float32) * np.float32(math.log(2)) + (r - 0.5 * square + square * r * polynomial(_LOG, r))
