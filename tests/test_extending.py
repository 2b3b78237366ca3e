"""Adding to the house takes one file and one line of a table."""

import sys
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc import variants
from jaxftc.campaigns import spec
from jaxftc.schemes import computed_torque
from tests.arms import three_hinges
from tuning import transform


@pytest.fixture
def damped(monkeypatch):
    """A scheme of one's own, as its file would be: gravity compensation and a damper."""
    module = types.ModuleType("damped")
    module.State, module.init, module.DIAGNOSES = computed_torque.State, computed_torque.init, False
    module.gains_used = lambda config: {"baseline.kd"}

    def step(config, gains, state, reference, measurement):
        still = jaxftc.Reference(state.q, jnp.zeros_like(state.q), jnp.zeros_like(state.q))
        only_kd = gains.replace({"baseline.kp": 0.0, "baseline.speed_weight": 1.0})
        return computed_torque.step(config, only_kd, state, still, measurement)

    module.step = step
    monkeypatch.setitem(sys.modules, "damped", module)
    monkeypatch.setitem(variants.SCHEMES, "damped", "damped")


def test_a_scheme_is_a_module_and_a_line(damped):
    robot = three_hinges()
    config = spec.variant(jaxftc.Config(robot, engine="chain", t_final=0.05), "damped")
    assert config.scheme == "damped" and transform.tunable(config) == ("baseline.kd",)
    gains, q = jaxftc.default_gains(config), jnp.full(robot.n, 0.3)
    state = jaxftc.init(config, gains, q)
    held = jaxftc.inverse_dynamics(robot, q, 0 * q, 0 * q)
    out = jax.jit(lambda s: jaxftc.step(config, gains, s, jaxftc.Reference(q, q, q), jaxftc.Measurement(q, held)))(state)[1]
    np.testing.assert_allclose(out.tau, held, rtol=1e-5, atol=1e-6)
