"""Scenarios over devices: the same values and gradients as on one."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.compile.devices import over_scenarios

PROGRAM = """
import jax
jax.config.update("jax_num_cpu_devices", 3)
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp, numpy as np
from jaxftc.compile.devices import over_scenarios

def fun(shared, split):
    return {"a": shared * split["x"] ** 2, "b": split["x"].sum(0) + split["id"]}

for count in (3, 4, 6, 7):  # over 3, 2, 3 and 1 devices
    split = {"x": jnp.arange(2.0 * count).reshape(2, count), "id": jnp.arange(count)}
    plain, spread = fun(3.0, split), jax.jit(over_scenarios(fun, count))(3.0, split)
    for a, b in zip(jax.tree.leaves(plain), jax.tree.leaves(spread), strict=True):
        np.testing.assert_array_equal(a, b)
    assert len(spread["a"].sharding.device_set) == {3: 3, 4: 2, 6: 3, 7: 1}[count], spread["a"].sharding
    slope = jax.jit(jax.grad(lambda x: (over_scenarios(fun, count)(3.0, split | {"x": x})["a"]).sum()))(split["x"])
    np.testing.assert_allclose(slope, 6.0 * split["x"])
print("fine")
"""


def test_three_devices_give_what_one_gives():
    environment = os.environ | {"JAX_PLATFORMS": "cpu"}
    run = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, env=environment, check=False)
    assert run.stdout == "fine\n", run.stderr


def test_one_device_is_the_function_itself():
    split = jnp.arange(6.0).reshape(2, 3)
    whole = over_scenarios(lambda shared, s: shared * s, 3)(2.0, split)
    np.testing.assert_array_equal(whole, 2 * split)
    assert jax.local_device_count() == 1
