"""Torque thresholds that follow the motion: against a twin, constant ones, gradients, and the promise of false alarms."""

import copy
import dataclasses
import functools
import tomllib

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st
from jax.test_util import check_grads

import jaxftc
from jaxftc.campaigns import follow
from jaxftc.campaigns.calibrate import calibrate
from jaxftc.cli.main import main
from jaxftc.diagnosis import threshold
from jaxftc.gains import align
from jaxftc.robot.mujoco_model import PAYLOAD
from jaxftc.schemes import diagnoser
from tests.arms import two_hinges

SHARES = dict(zip(threshold.GAINS, (0.3, 0.02, 0.5, 0.1, 0.4), strict=True))


@pytest.fixture(scope="module")
def small():
    return jaxftc.Config(two_hinges(), engine="chain", duration=0.4)


@pytest.fixture(scope="module")
def constant(small):
    return jaxftc.default_gains(small)


@pytest.fixture(scope="module")
def following(constant):
    return constant.replace(SHARES)


def motions(n, count=40, seed=0):
    """Angles, speeds and accelerations [n, count]."""
    random = np.random.default_rng(seed)
    return [random.uniform(-size, size, (n, count)) for size in (3.0, 2.0, 20.0)]


def level(config, gains, q, qd, qdd):
    """Thresholds [n, ...] of motions."""
    at = threshold.motion(config.robot, *(jnp.asarray(x) for x in (q, qd, qdd)))
    return np.asarray(threshold.torque(align(gains, np.ndim(q) - 1).diagnosis, at))


def mujoco_torque(robot, q, qd, qdd, payload):
    """M qdd + h of the links with a payload in kg, by MuJoCo."""
    model = copy.deepcopy(robot.mj_model)
    model.body_mass[model.body(PAYLOAD).id] = payload
    data, torque = mujoco.MjData(model), np.zeros(robot.n)
    data.qpos[:], data.qvel[:] = q, qd
    mujoco.mj_forward(model, data)
    data.qacc[:] = qdd
    mujoco.mj_rne(model, data, 1, torque)
    return torque


def test_it_is_the_sum_as_it_is_written_with_torques_of_mujoco(puma):
    config, alpha = jaxftc.Config(puma), np.arange(1.0, 7.0)
    gains = jaxftc.default_gains(config).replace(SHARES | {"diagnosis.alpha_tau": alpha})
    q, qd, qdd = motions(6)
    got = level(config, gains, q, qd, qdd)
    for k in range(q.shape[1]):
        links, loaded = (mujoco_torque(puma, q[:, k], qd[:, k], qdd[:, k], payload) for payload in (0.0, 1.0))
        turns = 1 / np.cosh(qd[:, k] / puma.coulomb_speed) ** 2
        rise = 0.3 * np.abs(qd[:, k]) + 0.02 * np.abs(qdd[:, k]) + 0.5 * turns
        rise += 0.1 * np.abs(links) + 0.4 * np.abs(loaded - links)
        np.testing.assert_allclose(got[:, k], alpha * (1 + rise), rtol=1e-9)


def test_without_shares_it_is_the_constant_to_the_last_bit(small, constant):
    for dtype in (np.float32, np.float64):
        gains = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), dtype), constant)  # noqa: B023
        got = level(small, gains, *(x.astype(dtype) for x in motions(2)))
        np.testing.assert_array_equal(got, np.broadcast_to(np.asarray(gains.diagnosis.alpha_tau)[:, None], got.shape))


def test_a_program_of_constant_thresholds_does_not_look_at_the_motion(small, constant, following):
    """Where shares are known to be zero nothing is computed of them; where they are traced they may be anything."""

    def step(gains, q):
        return threshold.of_reference(small.robot, align(gains, 1).diagnosis, jaxftc.Reference(q, q, q))

    q, known = jnp.ones((2, 4)), threshold.known_constant(constant)
    programs = [str(jax.make_jaxpr(functools.partial(step, gains))(q)) for gains in (known, following)]
    assert ["tanh" in program for program in programs] == [False, True]
    np.testing.assert_array_equal(step(known, q), step(constant, q))
    assert threshold.follows(following.diagnosis) and not threshold.follows(constant.diagnosis)
    slope = jax.grad(lambda gains: step(gains, q).sum())(constant).diagnosis
    assert all((np.asarray(getattr(slope, name)) > 0).any() for name in ("follow_speed", "follow_torque"))


@given(shares=st.lists(st.floats(0.0, 10.0), min_size=3, max_size=3), seed=st.integers(0, 2**16), more=st.floats(1.0, 3.0))
def test_no_motion_lowers_a_threshold(small, constant, shares, seed, more):
    """Never below the constant, and no lower where the joints are faster at the same angles."""
    of_all, (of_speed, of_acceleration) = constant.replace(dict.fromkeys(threshold.GAINS, shares[0])), shares[1:]
    of_size = constant.replace({"diagnosis.follow_speed": of_speed, "diagnosis.follow_acceleration": of_acceleration})
    q, qd, qdd = motions(2, 5, seed)
    alpha = np.asarray(constant.diagnosis.alpha_tau)[:, None]
    assert (level(small, of_all, q, qd, qdd) >= alpha).all()
    one, other = level(small, of_size, q, qd, qdd), level(small, of_size, q, more * qd, more * qdd)
    assert (one >= alpha).all() and (other >= one * (1 - 1e-12)).all()


def test_a_negative_share_is_refused(small, constant):
    with pytest.raises(ValueError, match=r"diagnosis.follow_speed must lie in \[0, inf\) s/rad"):
        jaxftc.init(small, constant.replace({"diagnosis.follow_speed": -0.1}), np.zeros(2))


@pytest.mark.thorough
def test_its_gradient_is_that_of_differences(small, following):
    """In the shares, the threshold at rest and the motion, away from where a size has its corner."""
    q, qd, qdd = (jnp.asarray(x) for x in motions(2, 2, 3))

    def cost(shares, alpha, qd, qdd):
        gains = following.replace(dict(zip(threshold.GAINS, shares, strict=True)) | {"diagnosis.alpha_tau": alpha})
        return (threshold.torque(align(gains, 1).diagnosis, threshold.motion(small.robot, q, qd, qdd)) ** 2).sum()

    at = jnp.asarray(list(SHARES.values())), jnp.asarray([1.0, 2.0]), qd, qdd
    check_grads(cost, at, order=1, modes=("fwd", "rev"), atol=1e-5, rtol=1e-5)


@pytest.fixture(scope="module")
def runs(small, constant, following):
    """Traces of the same motion, healthy and with faults on all joints, with both kinds of threshold."""
    key = jax.random.key(3)
    conditions = {name: jaxftc.paper_scenario(name, small) for name in ("healthy", "actuator")}
    return {
        (name, kind): jaxftc.simulate(small, gains, scenario, key)
        for name, scenario in conditions.items()
        for kind, gains in (("constant", constant), ("following", following))
    }


@pytest.mark.thorough
def test_a_fault_does_not_raise_its_own_threshold(runs):
    healthy, faulty = (np.asarray(runs[name, "following"].out.threshold_tau) for name in ("healthy", "actuator"))
    np.testing.assert_array_equal(healthy, faulty)
    assert (healthy.max(0) > 1.1 * healthy.min(0)).all()
    assert (np.asarray(runs["actuator", "following"].out.verdict) > 0).any()


def test_the_alarm_is_that_of_the_moving_threshold(runs, small):
    """It rises when |S| has been at its threshold for so many ticks, and not before."""
    for kind in ("constant", "following"):
        out = runs["actuator", kind].out
        over = np.abs(np.asarray(out.statistic_tau)) >= np.asarray(out.threshold_tau)
        lasting = np.array([over[max(k - small.alarm_ticks + 1, 0) : k + 1].all(0) for k in range(len(over))])
        bits = (np.asarray(out.verdict) & 1) > 0
        first = [int(np.flatnonzero(x)[0]) for x in bits.T if x.any()]
        assert first == [int(np.flatnonzero(x)[0]) for x, bit in zip(lasting.T, bits.T, strict=True) if bit.any()]
        assert first
    late = [np.flatnonzero(np.asarray(runs["actuator", kind].out.detected))[0] for kind in ("constant", "following")]
    assert late[0] < late[1], "a higher threshold is reached later"


def test_the_compiled_tick_says_the_same(small, following):
    q, qd, qdd = (x[:, 0] for x in motions(2))
    tick = jaxftc.Tick(small, following)
    _, out = tick.step(tick.init(q), jaxftc.Reference(q, qd, qdd), jaxftc.Measurement(q, np.zeros(2)))
    np.testing.assert_allclose(out.threshold_tau, level(small, following, q, qd, qdd), rtol=1e-9)


def test_follow_needs_a_share_of_false_alarms(capsys):
    with pytest.raises(SystemExit) as stop, jax.enable_x64(False):
        main(["campaign", "--follow", "-n", "10"])
    assert stop.value.code == 2 and "--follow sets thresholds, and needs --false-alarms" in capsys.readouterr().err


@pytest.mark.parametrize("scheme", ["momentum", pytest.param("ekf", marks=pytest.mark.thorough)])
def test_the_baselines_have_it_too(small, following, scheme):
    config = dataclasses.replace(small, scheme=scheme)
    q, qd, qdd = (x[:, 0] for x in motions(2))
    state = jaxftc.init(config, following, q)
    _, out = jaxftc.step(config, following, state, jaxftc.Reference(q, qd, qdd), jaxftc.Measurement(q, np.zeros(2)))
    np.testing.assert_allclose(out.threshold_tau, level(small, following, q, qd, qdd))


def test_a_gains_file_has_the_shares_and_one_without_them_is_refused(small, following, tmp_path):
    path = tmp_path / "gains.toml"
    jaxftc.save_gains(path, following, small)
    loaded = jaxftc.load_gains(path, small)
    for name in threshold.FOLLOW:
        np.testing.assert_array_equal(getattr(loaded.diagnosis, name), getattr(following.diagnosis, name))
    table = tomllib.loads(path.read_text())
    for name in threshold.FOLLOW:
        del table["diagnosis"][name]
    path.write_text(tomli_w.dumps(table))
    with pytest.raises(ValueError, match=r"lacks diagnosis\.follow_speed.*follow_payload.*save_gains"):
        jaxftc.load_gains(path, small)


# The fit.

TRUE = np.array([0.4, 0.05, 0.0, 0.2, 0.0])  # shares of a spread
SIZES = np.array([2.0, 10.0, 0.3, 8.0, 3.0])  # of the motions


def moments(count, seed, shares=TRUE):
    """Moments of two joints whose |S| is normal, its spread following the motion by shares, or not at all."""
    random = np.random.default_rng(seed)
    motion = np.abs(random.normal(size=(2, 5, count))) * SIZES[:, None]
    spread = np.stack([1 + shares @ motion[0], np.ones(count)])
    return follow.Moments(np.abs(random.normal(size=(2, count))) * spread * np.array([[2.0], [0.1]]), motion)


def test_shares_are_those_of_the_spread():
    found = follow.fit(moments(60000, 0), moments(60000, 1))
    np.testing.assert_allclose((found.values[0] - TRUE) * SIZES, 0.0, atol=0.15)  # of the spread at rest
    assert (found.values >= 0).all() and found.loss[0] < 0.8
    np.testing.assert_array_equal(found.values[1], 0.0)  # a spread that follows nothing has a constant threshold
    assert found.loss[1] == 1.0


def test_what_does_not_hold_on_fresh_moments_is_not_kept():
    """Ten moments cannot carry six coefficients; a bound is kept; a joint without a residual has a constant threshold."""
    few = follow.fit(moments(10, 0), moments(60000, 1), quantile=0.9)
    assert (few.loss <= 1).all()
    most = np.full((2, 5), np.inf)
    most[:, 1] = 0.05  # N m for a unit of the second motion
    bound = follow.fit(moments(20000, 0), moments(20000, 1), most=most)
    plain = follow.fit(moments(20000, 0), moments(20000, 1))
    height = 2.0 * 3.29  # of the first joint at rest: 0.999 of a normal |S|
    assert bound.values[0, 1] * height < 0.06 < plain.values[0, 1] * height
    still = moments(1000, 0)._replace(size=np.zeros((2, 1000)))
    np.testing.assert_array_equal(follow.fit(still, still).values, 0.0)


@pytest.fixture(scope="module")
def calibrated(small, constant):
    """Both kinds of threshold, set on the same runs of arms that differ from their model."""
    hard = jaxftc.sample_scenarios(jax.random.key(60), 480, "hard", config=small)
    with jax.enable_x64(False):
        low = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), jnp.float32), constant)
        return [calibrate(small, low, hard, jax.random.key(61), false_alarms=0.05, follow=kind) for kind in (False, True)]


@pytest.mark.slow
def test_moving_thresholds_keep_the_promise_on_fresh_runs(calibrated):
    plain, moving = calibrated
    assert plain.shares is None and moving.shares is not None
    assert moving.met and moving.settled and moving.reached.value <= 0.1
    assert (moving.shares.loss < 1).any() and (moving.shares.values >= 0).all()


@pytest.mark.slow
def test_they_are_lower_at_rest_and_constant_ones_are_as_before(calibrated, small, constant):
    plain, moving = calibrated
    follows = moving.shares.values.any(1)
    at_rest = [np.asarray(found.gains.diagnosis.alpha_tau)[follows] for found in calibrated]
    assert (at_rest[1] < at_rest[0]).all()
    for name in threshold.FOLLOW:
        assert not np.asarray(getattr(plain.gains.diagnosis, name)).any()


# Beside a controller of somebody else.


@pytest.fixture(scope="module")
def beside():
    """A diagnosis at 100 Hz whose thresholds rise steeply with the motion."""
    config = jaxftc.Config(two_hinges(), dt=0.01, t_final=0.01, engine="chain")
    return config, jaxftc.default_gains(config).replace(
        {"diagnosis.follow_speed": 1.0, "diagnosis.follow_acceleration": 0.05}
    )


def watched(config, gains, push):
    """What is said of an arm that swings by itself, its torque known but for ``push`` N m on the first joint from 2 s on."""
    robot, t = config.robot, np.arange(400) * config.dt
    wave = 0.4 * np.array([1.0, 0.7])[:, None]
    q, qd, qdd = (wave * x for x in (np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)))
    tau = np.array(jaxftc.inverse_dynamics(robot, *map(jnp.asarray, (q, qd, qdd))))
    tau[0, 200:] -= push
    state = diagnoser.init(config, align(gains, 0), jnp.asarray(q[:, 0]))
    step = lambda state, x: diagnoser.step(config, gains, state, diagnoser.Measurement(*x))  # noqa: E731
    return jax.tree.map(np.asarray, jax.lax.scan(step, state, (jnp.asarray(q.T), jnp.asarray(tau.T)))[1]), qd.T


def test_the_diagnoser_follows_the_motion_and_an_alarm_holds_the_threshold_down(beside):
    config, gains = beside
    alpha, rate = np.asarray(gains.diagnosis.alpha_tau), float(gains.diagnosis.rate[0])
    calm, qd = watched(config, gains, 0.0)
    low = np.zeros(2)
    for k, speed in enumerate(np.abs(qd)):  # the speed alone, low-passed as the residual is
        low = low - np.expm1(-rate * config.dt) * (speed - low)
        if k > 100:
            assert (calm.threshold_tau[k] > alpha * (1 + 0.9 * low)).all()
    assert not calm.detected.any() and (calm.threshold_tau >= alpha).all()
    pushed, _ = watched(config, gains, 20.0)
    up = np.flatnonzero(pushed.verdict[:, 0] & 1)
    assert 200 < up[0] < 230
    assert (np.diff(pushed.threshold_tau[up[0] :, 0]) <= 1e-12).all() and np.ptp(calm.threshold_tau[up[0] :, 0]) > 0.2
