"""``Gains.replace``: by block and name, in the gain's own shape and dtype, also under a trace; refused with a hint."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc.gains import NAMES
from jaxftc.scenarios.scenario import stack, trail
from jaxftc.simulation.closed_loop import rollout
from tests.arms import two_hinges


@pytest.fixture(scope="module")
def gains(config):
    return jaxftc.default_gains(config)


@pytest.fixture(scope="module")
def config():
    return jaxftc.Config(jaxftc.puma560(coulomb=False), engine="chain", duration=0.02)


def leaf(gains, path):
    block, name = path.split(".")
    return getattr(getattr(gains, block), name)


def test_only_what_is_named_changes(gains):
    changed = gains.replace({"control.lam": 30.0, "control.eps": np.arange(1, 7), "diagnosis.alpha_tau": jnp.full(6, 3.0)})
    np.testing.assert_array_equal(changed.control.lam, np.full(6, 30.0))
    np.testing.assert_array_equal(changed.control.eps, np.arange(1.0, 7.0))
    np.testing.assert_array_equal(changed.diagnosis.alpha_tau, np.full(6, 3.0))
    for path in set(NAMES) - {"control.lam", "control.eps", "diagnosis.alpha_tau"}:
        assert leaf(changed, path) is leaf(gains, path)
    assert leaf(gains, "control.lam")[0] == 20.0


@pytest.mark.parametrize(
    ("path", "value", "shape"),
    [
        ("control.lam", 1.0, (6,)),
        ("control.lam", np.ones((6, 4)), (6, 4)),
        ("control.lam", np.ones((1, 4, 2)), (6, 4, 2)),
        ("control.outputs", 1.0, (3,)),
        ("arx.kappa_a", np.ones((6, 1)), (6, 3)),
        ("arx.kappa_a", np.ones((1, 3, 5)), (6, 3, 5)),
        ("arx.kappa_b", 0.5, (6, 1, 2)),
    ],
)
def test_values_take_the_gains_own_shape_with_scenario_axes_behind(gains, path, value, shape):
    changed = leaf(gains.replace({path: value}), path)
    assert changed.shape == shape and (changed == np.max(value)).all()
    again = gains.replace({path: np.ones((*shape[: leaf(gains, path).ndim], 9))}).replace({path: value})
    assert leaf(again, path).shape == shape, "earlier scenario axes leave nothing behind"


def test_the_dtype_of_each_gain_is_kept(gains):
    with jax.enable_x64(False):
        single = jax.tree.map(lambda x: jnp.asarray(np.asarray(x, np.float32)), gains)
        changed = single.replace({"control.lam": np.float64(3.0), "observer.alpha_i": 4})
    assert {x.dtype for x in jax.tree.leaves(changed)} == {np.dtype("float32")}
    assert gains.replace({"control.lam": np.float32(3.0)}).control.lam.dtype == np.dtype("float64")


def test_it_composes_with_jit_grad_and_vmap(gains):
    def cost(lam, offset):
        changed = gains.replace({"control.lam": lam, "control.eps": 2.0 * offset})
        return (changed.control.lam * changed.control.eps).sum()

    lam, offset = jnp.arange(1.0, 7.0), jnp.asarray(0.5)
    assert jax.jit(cost)(lam, offset) == cost(lam, offset) == 21.0
    np.testing.assert_array_equal(jax.grad(cost)(lam, offset), np.ones(6))
    np.testing.assert_array_equal(jax.grad(cost, 1)(lam, offset), 42.0)
    many = jax.vmap(cost, (0, None))(jnp.stack([lam, 2 * lam]), offset)
    np.testing.assert_array_equal(many, [21.0, 42.0])


@pytest.mark.thorough
def test_gains_may_have_the_scenarios_axis():
    """Gains of two scenarios at once are those of one after the other."""
    config = jaxftc.Config(two_hinges(), engine="chain", duration=0.02)
    gains = jaxftc.default_gains(config)
    scenario = jaxftc.paper_scenario("actuator", config, scenario_id=3)
    two = trail(stack([scenario, scenario]))
    both = rollout(config, gains.replace({"control.lam": [[15.0, 30.0]]}), two, jax.random.key(0))
    for k, lam in enumerate((15.0, 30.0)):
        one = jaxftc.simulate(config, gains.replace({"control.lam": lam}), scenario, jax.random.key(0))
        np.testing.assert_allclose(both.q[..., k], one.q, rtol=1e-9)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"lam": 1.0}, "did you mean 'control.lam'"),
        ({"speed_weight": 1.0}, "did you mean 'control.speed_weight' or 'baseline.speed_weight'"),
        ({"control.lamb": 1.0}, "did you mean 'control.lam'"),
        ({"control": 1.0}, "gain must be one of 'arx.xi_a'"),
        ({3: 1.0}, "got 3"),
        ({"control.lam": np.ones(5)}, r"control.lam must be a number or have shape \[6\], .* got \[5\]"),
        ({"control.lam": np.ones((3, 6))}, r"control.lam must be a number or have shape \[6\], .* got \[3, 6\]"),
        ({"arx.kappa_a": np.ones(3)}, r"arx.kappa_a must be a number or have shape \[6, 3\], .* got \[3\]"),
    ],
)
def test_what_cannot_be_is_refused(gains, changes, text):
    with pytest.raises(ValueError, match=text):
        gains.replace(changes)
