"""The gradient of the whole objective in every free gain: reverse, forward and finite differences agree in float64."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc.scenarios.scenario import stack, trail
from tests.arms import two_hinges
from tests.contract.test_gradients import base_gains, faulty
from tuning import OBJECTIVE, Problem, problem, transform

pytestmark = pytest.mark.thorough  # half a minute to compile; test_gradients.py has the loop in every gain

BATCH = 8
STEPS = (1e-5, 1e-4)  # rounding spoils the small one, kinks (torque travel) the large one
# The poles and the stiff read-out behind them: a step of 1e-5 is a large one there.
STIFF = {transform.POLES: (1e-7, 1e-6)}


class Setup(NamedTuple):
    space: transform.Space
    loss: object  # theta -> weighted sum of the terms' means
    slope: Callable[[str], np.ndarray]  # mode -> [size]
    reverse: np.ndarray  # [size]


@pytest.fixture(scope="module")
def setup():
    """Scenarios with both faults early in a run of 120 ms, so that every term has something to say."""
    config = jaxftc.Config(two_hinges(), engine="chain", duration=0.12)
    start = base_gains(config)
    # Close to the edge of stability, where that term has a slope; alpha_f1 and alpha_f3 are alike by default, a kink of
    # their maximum there.
    o = start.observer
    start = start.replace({"observer.alpha_i": 14 * o.alpha_i, "observer.alpha_f3": 1.1 * o.alpha_f3})
    scenarios = trail(stack([faulty(config)._replace(id=jnp.asarray(k, jnp.int32)) for k in range(BATCH)]))
    space = transform.space(config, start, transform.tunable(config))
    whole = Problem(config, OBJECTIVE, jax.random.key(0), BATCH)
    zero, one = jnp.zeros(space.size), jnp.ones(())
    low = jnp.full((len(OBJECTIVE), BATCH), np.inf)  # a start that is worse in everything: no guard

    def slope(mode):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(problem, "CLIP", np.inf)
            terms, found = jax.jit(whole.slope(space, mode))(whole.key, zero, one, scenarios, low)
        assert np.isfinite(terms).all() and (np.asarray(terms).mean(1) > 0).all(), "a term that is 0 has no slope to check"
        return np.asarray(found).mean(1)

    run = jax.jit(whole.at(space))

    def loss(theta):
        points = jnp.broadcast_to(jnp.asarray(theta)[:, None], (space.size, BATCH))
        return float(whole.weights @ np.asarray(run(whole.key, points, 1.0, scenarios)).mean(1))

    return Setup(space, loss, slope, slope("reverse"))


def test_reverse_and_forward_agree(setup):
    np.testing.assert_allclose(setup.slope("forward"), setup.reverse, rtol=1e-6, atol=1e-9 * np.abs(setup.reverse).max())


NAMES = transform.tunable(jaxftc.Config(two_hinges(), engine="chain"))


@pytest.mark.parametrize("name", NAMES)
def test_the_slope_in_a_gain_is_that_of_finite_differences(setup, name):
    leaf = next(leaf for leaf in setup.space.leaves if f"{leaf.block}.{leaf.name}" == name)
    direction = np.zeros(setup.space.size)
    direction[leaf.part] = np.random.default_rng(0).choice([-1.0, 1.0], leaf.part.stop - leaf.part.start)
    slope = setup.reverse @ direction
    finite = [(setup.loss(h * direction) - setup.loss(-h * direction)) / (2 * h) for h in STIFF.get(name, STEPS)]
    np.testing.assert_allclose(slope, min(finite, key=lambda f: abs(f - slope)), rtol=1e-3, atol=1e-8)


def test_every_gain_that_is_tuned_has_a_slope(setup):
    flat = {f"{leaf.block}.{leaf.name}" for leaf in setup.space.leaves if not np.abs(setup.reverse[leaf.part]).max() > 0}
    assert not flat
