"""theta and gains: every theta is allowed, 0 is the start, and names mean what they say."""

import dataclasses

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings

import jaxftc
from jaxftc.diagnosis import threshold
from jaxftc.gains import BLOCKS, check, specs
from jaxftc.observer import arx
from tests.contract.test_gradients import CASES
from tuning import transform

POLES = transform.POLES


@pytest.fixture(scope="module")
def start(config):
    return jaxftc.default_gains(config)


@pytest.fixture(scope="module")
def everything(config, start):
    return transform.space(config, start, transform.tunable(config))


def leaf(gains, path):
    block, name = path.split(".")
    return np.asarray(getattr(getattr(gains, block), name))


def test_zero_is_the_start(config, start, everything):
    assert everything.deploy(np.zeros(everything.size)) is start
    moved = everything.gains(jnp.zeros(everything.size))
    for block, name, spec in specs():
        path = f"{block}.{name}"
        closed = spec.axes == ("n",) and (leaf(start, path) == spec.high).any()  # an end of an interval moves inside
        tolerance = transform.INSET if closed else transform.SMALLEST.get(path, 1e-9)
        np.testing.assert_allclose(leaf(moved, path), leaf(start, path), rtol=1e-9, atol=tolerance * 1.0001, err_msg=path)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(0.01, 1.0))
def test_every_theta_within_reach_gives_allowed_gains_in_float32_too(config, start, everything, seed, scale):
    theta = scale * transform.REACH * np.random.default_rng(seed).choice([-1.0, 1.0], everything.size)
    check(config, everything.gains(jnp.asarray(theta)))
    with jax.enable_x64(False):
        low = jax.tree.map(lambda x: jnp.asarray(np.asarray(x), jnp.float32), start)
        space = transform.space(config, low, transform.tunable(config))
        check(config, space.deploy(theta))


def test_a_free_gain_moves_and_no_other(config, start, everything):
    for path in transform.tunable(config):
        space = transform.space(config, start, [path])
        moved = space.gains(jnp.ones(space.size))
        changed = {f"{b}.{n}" for b, n, _ in specs() if not np.array_equal(leaf(moved, f"{b}.{n}"), leaf(start, f"{b}.{n}"))}
        follow = {"arx.xi_b", "arx.kappa_a", "arx.kappa_b"} if path == POLES else set()
        assert changed == {path} | follow


def test_gains_move_by_factors_and_odds(config, start):
    space = transform.space(config, start, ["observer.alpha_i", "control.speed_weight"])
    moved = space.gains(jnp.ones(space.size))
    np.testing.assert_allclose(moved.observer.alpha_i / start.observer.alpha_i, np.e)
    odds = lambda p: p / (1 - p)  # noqa: E731
    np.testing.assert_allclose(odds(moved.control.speed_weight) / odds(start.control.speed_weight), np.e)


def test_a_gain_that_starts_at_0_can_move(config, start):
    still = start.replace({"observer.alpha_sm0": 0.0})
    space = transform.space(config, still, ["observer.alpha_sm0", "control.k_b"])
    moved = space.gains(jnp.full(space.size, transform.REACH))
    np.testing.assert_allclose(moved.observer.alpha_sm0, 20 * 1e-3 * 30.0)
    np.testing.assert_allclose(moved.control.k_b, 20.0)
    assert (space.deploy(np.zeros(space.size)).observer.alpha_sm0 == 0).all()


def test_shared_gains_move_alike_from_their_own_values(config, start):
    own = start.replace({"observer.alpha_i": jnp.arange(1.0, 3.0) * 100})
    space = transform.space(config, own, ["observer.alpha_i"], shared=["observer"])
    assert space.size == 1
    np.testing.assert_allclose(space.gains(jnp.ones(1)).observer.alpha_i, np.e * own.observer.alpha_i)


def test_poles_move_together_and_the_read_out_follows(config, start):
    space = transform.space(config, start, [POLES])
    gains = space.deploy(np.linspace(-1, 1, space.size))
    xi = gains.arx.xi_a
    np.testing.assert_array_equal(xi, gains.arx.xi_b)
    kappa_a, kappa_b = arx.exact_kappa(xi, config.order_a, config.order_b, config.dt)
    np.testing.assert_allclose(gains.arx.kappa_a, kappa_a, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(gains.arx.kappa_b[:, 0], kappa_b, rtol=1e-12)
    assert POLES not in transform.select(config)  # poles are tuned only if named
    off = start.replace({"arx.offset": 1e-3})
    space = transform.space(config, off, [POLES])
    theta = np.full(space.size, 0.1)
    for path in ("arx.kappa_a", "arx.kappa_b", "arx.offset"):
        trained, deployed = (leaf(g, path) for g in (space.gains(jnp.asarray(theta)), space.deploy(theta)))
        np.testing.assert_allclose(trained, deployed, rtol=1e-9, atol=1e-15)


def test_a_set_per_scenario_is_the_sets_one_by_one(config, everything):
    points = np.random.default_rng(0).normal(size=(everything.size, 3))
    together = everything.gains(jnp.asarray(points), 1.5)
    for k in range(3):
        alone = everything.gains(jnp.asarray(points[:, k]), 1.5)
        for path in transform.tunable(config):
            np.testing.assert_allclose(leaf(together, path)[..., k], leaf(alone, path), rtol=1e-12, err_msg=path)


def test_widen_scales_both_smooth_signs_and_nothing_else(config, start, everything):
    zero = jnp.zeros(everything.size)
    plain, wide = everything.gains(zero), everything.gains(zero, 2.0)
    for path in transform.tunable(config):
        factor = 2.0 if path.endswith(".eps") else 1.0
        np.testing.assert_allclose(leaf(wide, path), factor * leaf(plain, path), err_msg=path)


@pytest.mark.parametrize("name", CASES)
def test_idle_gains_are_those_without_a_gradient(name):
    """The list of what the gradient tests expect to be flat, apart from the thresholds' own pass through stop-gradient."""
    case = CASES[name]
    assert transform.idle(case.config()) == set(case.idle)


def test_names_and_blocks_select(config):
    tunable = transform.tunable(config)
    assert transform.select(config, ["diagnosis"]) == tuple(n for n in tunable if n.startswith("diagnosis."))
    assert not set(threshold.GAINS) & set(transform.select(config))  # they move only if they are named
    assert transform.select(config, [threshold.GAINS[0]]) == (threshold.GAINS[0],)
    assert "control.lam" not in transform.select(config, (), ["control.lam"])
    assert set(transform.select(config, ["observer", POLES])) == {n for n in tunable if n.startswith(("observer.", "arx."))}


@pytest.mark.parametrize(
    ("only", "freeze", "message"),
    [
        (
            ["observer.alpha_j"],
            [],
            r"gain must be one of .*got 'observer.alpha_j'; did you mean 'observer.alpha_[a-z0-9]+'\?",
        ),
        (["obsrver"], [], r"got 'obsrver'; did you mean 'observer'\?"),
        ([], list(BLOCKS), "every gain is frozen, so there is nothing to tune; free at least one"),
        (["control.alpha_sm"], [], "'control.alpha_sm' does nothing with observer 'ts' and control 'afesmc'"),
    ],
)
def test_what_cannot_be_selected_is_refused(config, only, freeze, message):
    with pytest.raises(ValueError, match=message):
        transform.select(config, only, freeze)


def test_a_baseline_tunes_its_own_gains_only(config):
    momentum = dataclasses.replace(config, scheme="momentum")
    own = {"baseline.kp", "baseline.kd", "baseline.rate", "baseline.speed_weight", "diagnosis.alpha_tau"}
    assert set(transform.select(momentum)) == own
    with pytest.raises(ValueError, match=r"gain 'control.lam' does nothing with scheme 'momentum'"):
        transform.select(momentum, ["control.lam"])
    with pytest.raises(ValueError, match=r"'baseline.rate' does nothing.*'ts'.*'afesmc'"):
        transform.select(config, ["baseline.rate"])


def test_poles_of_the_torque_form_cannot_be_tuned(config):
    with pytest.raises(ValueError, match="nothing to tune"):
        transform.select(dataclasses.replace(config, input="torque"), ["arx"])


def test_poles_that_differ_cannot_be_tuned(config, start):
    apart = start.replace({"arx.xi_b": 0.5 * start.arx.xi_b})
    with pytest.raises(ValueError, match="tuned where both banks have the same pole"):
        transform.space(config, apart, [POLES])


def test_gains_with_scenario_axes_are_no_start(config, start):
    swept = start.replace({"observer.alpha_i": jnp.ones((1, 3))})
    with pytest.raises(ValueError, match="tuning starts from one set of gains"):
        transform.space(config, swept, ["control"])
