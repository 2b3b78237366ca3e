"""What JAX itself must get right here: jax 0.10.2 returns wrong numbers on the CPU for this program at these sizes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest


@pytest.mark.parametrize(("dtype", "batch", "tolerance"), [("float64", 16385, 1e-12), ("float32", 32769, 1e-4)])
@pytest.mark.parametrize("n", [3, 6])
def test_squared_norm_of_a_product_with_a_shared_matrix(dtype, batch, tolerance, n):
    draw = np.random.default_rng(0)
    matrix, x = draw.normal(size=(n, n)).astype(dtype), draw.normal(size=(batch, n)).astype(dtype)
    squared_norms = jax.jit(jax.vmap(lambda m, v: jnp.sum((m @ v) ** 2), (None, 0)))(matrix, x)
    np.testing.assert_allclose(squared_norms, ((x @ matrix.T) ** 2).sum(1), rtol=tolerance)
