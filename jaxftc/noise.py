"""Encoder noise, tick by tick: the standard normal numbers of a scenario are a function of the key and its id alone.

The numbers are those of ``jax.random.normal(jax.random.fold_in(key, id), (ticks, n), jnp.float32)``, to rounding, for JAX's
own keys with ``jax_threefry_partitionable`` on, as it is. That call would draw all of them before the loop, scenario by
scenario, and store them; the same generator (threefry2x32, a hash of a counter) written out gives those of one tick where
they are needed, [n, ...] as everything else is. Of a key of another kind the first two words are the generator's key.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxftc.types import Array

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))


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
    return math.sqrt(2) * lax.erf_inv(jnp.maximum(low, unit * (np.float32(1) - low) + low))


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
