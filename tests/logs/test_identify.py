"""Identification of the ARX-Laguerre read-out: the exact model without noise, honest errors with it, both input forms."""

import dataclasses
import re

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from twins import laguerre as twin

import jaxftc
from jaxftc import identify
from jaxftc.identify import Log, linear_model
from jaxftc.observer import arx
from jaxftc.robot import dynamics, rigid_body
from jaxftc.scenarios.scenario import paper_scenario

CLAIM = np.radians(0.05)  # rad, the paper's bound on the error of a healthy model
NOISE = 3e-5  # rad
OTHER = np.array([-2.0, 1.5, -3.0, 2.0, -2.5, 2.0])  # rad, travel of a motion that no fit has seen
FIT = {"batch": identify.fit_batch, "multistep": identify.fit_multistep}


@pytest.fixture(scope="module")
def rigid(paper_arm):
    """Config and gains, the exact model's."""
    config = jaxftc.Config(paper_arm, engine="chain")
    return config, jaxftc.default_gains(config)


@pytest.fixture(scope="module")
def torque(rigid):
    """Config and gains of an arm with the constant inertia it has in its zero position."""
    config, gains = rigid
    rows = dynamics.nominal_mass(config.robot, rigid_body.pose(config.robot, jnp.zeros(config.n))).rows
    mass = np.array([[float(entry) for entry in row] for row in rows])
    kappa_b = jnp.asarray(np.linalg.inv(mass)[:, :, None] * np.asarray(gains.arx.kappa_b)[:, 0])
    config = dataclasses.replace(config, input="torque")
    return config, dataclasses.replace(gains, arx=dataclasses.replace(gains.arx, kappa_b=kappa_b))  # another shape


@pytest.fixture(scope="module")
def record(rigid):
    """Trace of a healthy run."""
    config, gains = rigid

    def run(noise: float, seed: int, travel: np.ndarray | None = None) -> jaxftc.Trace:
        scenario = paper_scenario("healthy", config)._replace(noise=jnp.asarray(noise))
        if travel is not None:
            scenario = scenario._replace(q_goal=scenario.q_start + jnp.asarray(travel))
        return jaxftc.simulate(config, gains, scenario, jax.random.key(seed))

    return run


@pytest.fixture(scope="module")
def clean_trace(record):
    return record(0.0, 0)


@pytest.fixture(scope="module")
def clean(clean_trace):
    return identify.from_trace(clean_trace)


@pytest.fixture(scope="module")
def noisy(record):
    return identify.from_trace(record(NOISE, 1))


@pytest.fixture(scope="module")
def other(record):
    return identify.from_trace(record(NOISE, 2, OTHER))


def steady(gains) -> np.ndarray:
    """H_y(1) [n]."""
    xi = np.asarray(gains.arx.xi_a, float)
    return np.sqrt((1 + xi) / (1 - xi)) * np.asarray(gains.arx.kappa_a, float).sum(1)


def worst(errors: identify.Errors) -> dict[str, float]:
    """Largest error of any joint, rad."""
    return {name: getattr(errors, name).max.max() for name in errors._fields}


def perturbed(gains, seed: int = 0):
    """Read-out a percent off."""
    a, b = (
        1 + 0.01 * np.random.default_rng(seed).standard_normal(np.shape(k)) for k in (gains.arx.kappa_a, gains.arx.kappa_b)
    )
    return gains.replace({"arx.kappa_a": gains.arx.kappa_a * a, "arx.kappa_b": gains.arx.kappa_b * b})


def response(gains, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """H_y and H_v [n, frequencies] of a rigid-body model at z."""

    def bank(xi, kappa):
        xi, i = np.asarray(xi, float)[:, None, None], np.arange(kappa.shape[1])[None, :, None]
        functions = np.sqrt(1 - xi**2) / (z - xi) * ((1 - xi * z) / (z - xi)) ** i
        return (np.asarray(kappa, float)[:, :, None] * functions).sum(1)

    return bank(gains.arx.xi_a, gains.arx.kappa_a), bank(gains.arx.xi_b, gains.arx.kappa_b[:, 0])


# The log and the model's input.


def test_a_log_is_what_the_robot_saw(clean_trace, clean):
    np.testing.assert_array_equal(clean.q, clean_trace.y)
    np.testing.assert_array_equal(clean.tau, clean_trace.out.tau)


def test_the_rigid_body_input_is_the_acceleration_of_the_plant(rigid, clean_trace, clean):
    v = identify.model_input(rigid[0], clean, half_window=1)
    np.testing.assert_allclose(v[:-1], np.diff(clean_trace.qd, axis=0) / rigid[0].dt, atol=1e-8)


def test_a_wider_window_trades_noise_for_little_error(rigid, clean, noisy):
    config, _ = rigid
    smoothed, exact = (identify.model_input(config, clean, half_window) for half_window in (5, 1))
    assert np.sqrt(((smoothed - exact) ** 2).mean()) < 0.02  # rad/s^2, of 30; most of it where the log ends
    rough = [np.diff(identify.model_input(config, noisy, half_window), axis=0).std() for half_window in (5, 1)]
    assert rough[0] < rough[1]


def test_the_torque_input_is_the_torque(torque, noisy):
    np.testing.assert_array_equal(identify.model_input(torque[0], noisy), noisy.tau)


def test_regressors_are_the_states_of_the_matrix_form(rigid, noisy):
    config, gains = rigid
    u = identify.model_input(config, noisy)
    phi = identify.regressors(config, gains.arx, noisy.q, u)
    a, b_y, b_v = twin.block(0.8, 3, 0.8, 2)
    for joint in range(config.n):
        x = np.concatenate([np.full(3, 3.0 * noisy.q[0, joint]), np.zeros(2)])
        for k in range(200):
            np.testing.assert_allclose(phi[k, joint], [*x, 1.0], rtol=1e-9, atol=1e-9)
            x = a @ x + b_y * noisy.q[k, joint] + b_v * u[k, joint]


def test_features_and_with_kappa_agree_with_the_predictor(rigid, torque):
    for config, gains in (rigid, torque):
        key = jax.random.key(3)
        names = ("x_a", "x_b", "offset")
        shapes = ((config.n, config.order_a), (config.n, config.order_b), (config.n,))
        drawn = {
            name: jax.random.normal(jax.random.fold_in(key, i), shape)
            for i, (name, shape) in enumerate(zip(names, shapes, strict=True))
        }
        gains = gains.replace({"arx.offset": drawn["offset"]})
        bank = arx.State(drawn["x_a"], drawn["x_b"])
        kappa = linear_model.flatten(gains.arx)
        y_hat = (kappa * identify.features(config, bank)).sum(1)
        np.testing.assert_allclose(y_hat, arx.predict(gains.arx, bank), rtol=1e-12)
        back = identify.with_kappa(config, gains, kappa)
        for name in ("kappa_a", "kappa_b", "offset"):
            np.testing.assert_array_equal(getattr(back.arx, name), getattr(gains.arx, name))


# Batch least squares.


def test_without_noise_batch_finds_the_exact_model(rigid, clean):
    config, gains = rigid
    found = identify.fit_batch(config, perturbed(gains), clean)
    np.testing.assert_allclose(steady(found), 1.0, atol=1e-14)
    z = np.exp(1j * np.geomspace(1e-3, np.pi, 50))
    (h_y, h_v), (exact_y, exact_v) = response(found, z), response(gains, z)
    np.testing.assert_allclose(h_y, exact_y, rtol=2e-4)
    np.testing.assert_allclose(h_v, exact_v, atol=1e-3 * np.abs(exact_v).max())
    np.testing.assert_allclose(exact_y, np.broadcast_to(1 - (z - 1) ** 2 / (z - 0.8) ** 2, exact_y.shape), rtol=1e-9)
    size = {name: np.degrees(value) for name, value in worst(identify.errors(config, found, clean)).items()}
    assert size["one_step"] < 2e-5 and size["fifty_step"] < 1e-4 and size["free_run"] < 5e-3
    assert size["extrapolator_fifty_step"] > 1


def test_the_offset_of_the_rigid_body_form_is_held(rigid, clean):
    config, gains = rigid
    offset = jnp.full(config.n, 1e-6)
    moved = gains.replace({"arx.offset": offset})
    np.testing.assert_array_equal(identify.fit_batch(config, moved, clean).arx.offset, offset)


@pytest.mark.parametrize("fit", FIT)
def test_fits_keep_the_precision_and_every_other_gain_and_jax_as_it_was(rigid, clean, fit):
    config, gains = rigid
    with jax.enable_x64(False):
        single = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf, np.float32)), gains)
        found = FIT[fit](config, single, clean)
        free_run = worst(identify.errors(config, found, clean))["free_run"]
        assert jnp.zeros(()).dtype == jnp.float32
    assert {leaf.dtype for leaf in jax.tree.leaves(found)} == {np.dtype("float32")}
    np.testing.assert_allclose(steady(found), 1.0, atol=1e-10)  # eps of float32 is 1e-7
    assert np.degrees(free_run) < 0.02
    arx_as_it_was = found.replace({"arx.kappa_a": single.arx.kappa_a, "arx.kappa_b": single.arx.kappa_b})
    for before, after in zip(jax.tree.leaves(single), jax.tree.leaves(arx_as_it_was), strict=True):
        np.testing.assert_array_equal(before, after)


def test_noise_spoils_the_free_run_of_batch_but_not_its_fifty_steps(rigid, noisy, other):
    config, gains = rigid
    found = identify.fit_batch(config, gains, noisy)
    np.testing.assert_allclose(steady(found), 1.0, atol=1e-14)
    for log in (noisy, other):
        size = worst(identify.errors(config, found, log))
        assert size["one_step"] < 0.25 * CLAIM and size["fifty_step"] < CLAIM
        assert CLAIM < size["free_run"] < 10 * CLAIM
        assert size["extrapolator_one_step"] < CLAIM, "at 1 kHz a straight line meets the claim over one step"
        assert size["extrapolator_fifty_step"] > 20 * CLAIM


def test_a_good_one_step_error_proves_nothing(rigid, clean):
    """Two superfluous functions a bank: the best one-step fit explodes when left alone."""
    config = dataclasses.replace(rigid[0], order_a=5, order_b=5)
    size = worst(identify.errors(config, identify.fit_batch(config, jaxftc.default_gains(config), clean), clean))
    assert np.degrees(size["one_step"]) < 1e-4
    assert size["fifty_step"] > 1e3 and size["free_run"] == np.inf


# The simulation error.


def test_the_fit_over_the_whole_log_meets_the_claim_alone_and_on_another_motion(rigid, noisy, other):
    config, gains = rigid
    found = identify.fit_multistep(config, perturbed(gains), noisy, horizon=len(noisy.q))
    np.testing.assert_allclose(steady(found), 1.0, atol=1e-14)
    for log, bound in ((noisy, 0.2), (other, 0.5)):
        size = worst(identify.errors(config, found, log))
        assert size["one_step"] < bound * CLAIM and size["free_run"] < bound * CLAIM and size["fifty_step"] < CLAIM


def test_fifty_steps_do_not_teach_the_free_run(rigid, noisy):
    config, gains = rigid
    size = worst(identify.errors(config, identify.fit_multistep(config, gains, noisy), noisy))
    assert size["fifty_step"] < 0.5 * CLAIM < CLAIM < size["free_run"]


@pytest.mark.parametrize("form", ["rigid", "torque"])
@pytest.mark.parametrize("start", ["given", "batch", "perturbed"])
def test_multistep_never_gets_worse(request, noisy, form, start):
    config, gains = request.getfixturevalue(form)
    gains = {
        "given": lambda: gains,
        "batch": lambda: identify.fit_batch(config, gains, noisy),
        "perturbed": lambda: perturbed(gains),
    }[start]()
    before = identify.errors(config, gains, noisy).fifty_step.rms
    after = identify.errors(config, identify.fit_multistep(config, gains, noisy), noisy).fifty_step.rms
    assert (after <= before).all()
    if start == "perturbed":
        assert (after < 0.01 * before).all()


def test_multistep_keeps_a_start_that_the_constraint_cannot_beat(rigid, noisy):
    """A read-out that is free to break H_y(1) = 1 fits one log better over one step, the horizon of this test."""
    config, gains = rigid
    phi, q = linear_model.data(config, gains, noisy)
    columns = phi[:, :, :-1]
    kappa = np.stack([np.linalg.lstsq(columns[:, j], q[:, j], rcond=None)[0] for j in range(config.n)])
    free = identify.with_kappa(config, gains, np.concatenate([kappa, np.zeros((config.n, 1))], axis=1))
    assert (np.abs(steady(free) - 1) > 1e-9).all()
    found = identify.fit_multistep(config, free, noisy, horizon=1)
    np.testing.assert_array_equal(found.arx.kappa_a, free.arx.kappa_a)


def test_errors_of_horizons_are_what_a_loop_gives(rigid, noisy):
    config, gains = rigid
    gains = perturbed(gains)
    u = identify.model_input(config, noisy)
    found = identify.errors(config, gains, noisy)
    for size, horizon in ((found.fifty_step, 50), (found.free_run, 1000)):
        error = np.zeros((110, config.n))
        measured = simulated = arx.init(config, gains, jnp.asarray(noisy.q[0]))
        for k in range(110):
            simulated = measured if k % horizon == 0 else simulated
            y_hat = arx.predict(gains.arx, simulated)
            error[k] = y_hat - noisy.q[k]
            simulated = arx.advance(gains.arx, simulated, y_hat, jnp.asarray(u[k]))
            measured = arx.advance(gains.arx, measured, jnp.asarray(noisy.q[k]), jnp.asarray(u[k]))
        short = identify.errors(config, gains, Log(noisy.q[:110], noisy.tau[:110]))
        short = short.fifty_step if horizon == 50 else short.free_run
        # the last readings' speed comes from fewer readings in the short log, and its input differs there
        np.testing.assert_allclose(short.rms, np.sqrt((error**2).mean(0)), rtol=2e-2)
        chex.assert_shape([size.rms, size.max], (config.n,))


# The torque form.


def test_the_torque_form_fits_its_motion_and_not_another(torque, noisy, other):
    config, gains = torque
    found = identify.fit_batch(config, gains, noisy)
    np.testing.assert_allclose(steady(found), 1.0, atol=1e-14)
    chex.assert_shape(found.arx.kappa_b, (6, 6, 2))
    assert (np.asarray(found.arx.offset) != 0).all()
    seen, unseen = (identify.errors(config, found, log) for log in (noisy, other))
    assert worst(seen)["fifty_step"] < CLAIM and worst(seen)["fifty_step"] < 0.05 * worst(seen)["extrapolator_fifty_step"]
    assert (seen.one_step.rms < seen.extrapolator_one_step.rms).all()
    assert worst(unseen)["fifty_step"] > 0.2 * worst(unseen)["extrapolator_fifty_step"], "a linear model of a nonlinear arm"
    assert worst(unseen)["free_run"] > 20 * CLAIM


def test_holding_the_torque_forms_steady_gain_helps_against_noise(torque, record):
    config, gains = torque
    log = identify.from_trace(record(NOISE, 1, np.full(6, 0.1)))
    phi, q = linear_model.data(config, gains, log)
    length = np.linalg.norm(phi, axis=0)
    kappa = np.stack([np.linalg.lstsq(phi[:, j] / length[j], q[:, j], rcond=None)[0] / length[j] for j in range(6)])
    free = identify.with_kappa(config, gains, kappa)
    assert np.abs(steady(free) - 1).max() > 2e-3  # gravity's stiffness accounts for 2e-4
    size = [worst(identify.errors(config, g, log))["free_run"] for g in (free, identify.fit_batch(config, gains, log))]
    assert size[1] < 0.2 * size[0]


# Recursive least squares.


def recurse(state, phi, y, forgetting=1.0, frozen=None):
    """State after every tick of phi [T, n, features], y [T, n]."""
    frozen = jnp.zeros(y.shape, bool) if frozen is None else frozen

    def body(state, x):
        return identify.rls_step(state, *x, forgetting)

    state, kappa = jax.lax.scan(body, state, (phi, y, frozen))
    return state, kappa[-1]


recurse = jax.jit(recurse)


@pytest.fixture(scope="module")
def rows(rigid, noisy):
    config, gains = rigid
    return jnp.asarray(identify.regressors(config, gains.arx, noisy.q, identify.model_input(config, noisy))), jnp.asarray(
        noisy.q
    )


@pytest.mark.parametrize("form", ["rigid", "torque"])
def test_without_forgetting_recursive_is_batch(request, noisy, form):
    config, gains = request.getfixturevalue(form)
    phi, q = linear_model.data(config, gains, noisy)
    state = identify.rls_init(config, gains, prior=1e-9, quiet=0.0)
    _, kappa = recurse(state, jnp.asarray(phi), jnp.asarray(q))
    recursive, batch = identify.with_kappa(config, gains, kappa), identify.fit_batch(config, gains, noisy)
    np.testing.assert_allclose(recursive.arx.kappa_a, batch.arx.kappa_a, atol=1e-6)
    scale = np.abs(batch.arx.kappa_b).max(axis=2, keepdims=True)
    np.testing.assert_allclose(recursive.arx.kappa_b / scale, batch.arx.kappa_b / scale, atol=1e-4)
    np.testing.assert_allclose(steady(recursive), 1.0, atol=1e-13)


def test_frozen_joints_keep_their_state_bit_for_bit(rigid, rows):
    config, gains = rigid
    state, kappa = recurse(identify.rls_init(config, gains), *rows, 0.999)
    frozen = jnp.arange(config.n) % 2 == 0
    phi, y = rows[0][500], rows[1][500] + 1.0  # what a fault does to a reading
    after, kappa_after = identify.rls_step(state, phi, y, frozen, 0.999)
    for name in ("root", "weight"):
        before, now = np.asarray(getattr(state, name)), np.asarray(getattr(after, name))
        np.testing.assert_array_equal(now[frozen], before[frozen])
        assert (now[~frozen] != before[~frozen]).reshape(3, -1).any(1).all()
    np.testing.assert_allclose(kappa_after[frozen], kappa[frozen], rtol=1e-12)
    missing, _ = identify.rls_step(state, phi, jnp.full(config.n, jnp.nan), jnp.zeros(config.n, bool), 0.999)
    for before, now in zip(jax.tree.leaves(state), jax.tree.leaves(missing), strict=True):
        np.testing.assert_array_equal(before, now)


def test_a_joint_at_rest_neither_learns_nor_forgets(rigid, rows):
    config, gains = rigid
    state, _ = recurse(identify.rls_init(config, gains), *rows, 0.999)
    q = 1.0 + NOISE * np.random.default_rng(0).standard_normal((5000, config.n))
    phi = identify.regressors(config, gains.arx, q, np.zeros_like(q))
    after, _ = recurse(state, jnp.asarray(phi), jnp.asarray(q), 0.999)
    np.testing.assert_array_equal(after.root, state.root)


def test_forgetting_follows_a_change(rigid, rows):
    config, gains = rigid
    phi, _ = rows
    before, after = (linear_model.span(config, g.arx)[0] for g in (perturbed(gains), gains))
    y = jnp.concatenate([jnp.einsum("nf,tnf->tn", jnp.asarray(kappa), phi) for kappa in (before, after)])
    for forgetting, followed in ((0.98, True), (1.0, False)):
        _, kappa = recurse(identify.rls_init(config, gains), jnp.concatenate([phi, phi]), y, forgetting)
        error = np.abs(np.einsum("nf,tnf->tn", kappa - after, phi)[500:]).max()
        assert (error < 1e-6) == followed


@pytest.mark.parametrize("forgetting", [1.0, 0.999])
def test_float32_stays_sound_for_a_hundred_thousand_ticks(rigid, rows, forgetting):
    """Motion and rest in turn, with fresh noise: nothing overflows, the triangle keeps its sign, and float64 is met."""
    config, gains = rigid
    phi, y = (np.concatenate([np.concatenate([x, np.repeat(x[:1], 1000, axis=0)])] * 50) for x in map(np.asarray, rows))
    y = y + NOISE * np.random.default_rng(0).standard_normal(y.shape)
    errors = []
    for double in (False, True):
        with jax.enable_x64(double):
            mine = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), float), gains)
            state, kappa = recurse(
                identify.rls_init(config, mine), jnp.asarray(phi, float), jnp.asarray(y, float), forgetting
            )
            assert {leaf.dtype for leaf in jax.tree.leaves(state)} == {np.dtype("float64" if double else "float32")}
        root, kappa = np.asarray(state.root), np.asarray(kappa, float)
        assert np.isfinite(root).all() and (np.diagonal(root, axis1=1, axis2=2) >= state.floor).all()
        assert (np.tril(root[:, :, :-1], -1) == 0).all()
        error = np.einsum("nf,tnf->tn", kappa, np.asarray(rows[0])) - np.asarray(rows[1])
        errors.append(np.sqrt((error**2).mean(0)))
    assert np.degrees(max(errors[1])) < 0.0025  # the noise itself is 0.0017
    np.testing.assert_allclose(errors[0], errors[1], rtol=1e-2)


def test_rls_takes_scenarios_on_trailing_axes_and_aligned_ranks(rigid, rows, aligned_ranks):
    config, gains = rigid
    phi, y = rows[0][300:320], rows[1][300:320]
    one, kappa = recurse(identify.rls_init(config, gains), phi, y, 0.99)
    many, kappas = recurse(
        identify.rls_init(config, gains, scenarios=(3,)), *(jnp.repeat(x[..., None], 3, axis=-1) for x in (phi, y)), 0.99
    )
    for i in range(3):
        np.testing.assert_allclose(many.root[..., i], one.root, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(kappas[..., i], kappa, rtol=1e-6, atol=1e-12)


@pytest.fixture
def aligned_ranks():
    """An operation on arrays of different ranks is an error."""
    with jax.numpy_rank_promotion("raise"):
        yield


def test_the_fits_keep_ranks_aligned(torque, noisy, aligned_ranks):
    config, gains = torque
    fitted = identify.fit_multistep(config, identify.fit_batch(config, gains, noisy), noisy, steps=1)
    assert np.isfinite(identify.errors(config, fitted, noisy).one_step.max).all()


# The doors.


def with_cell(log: Log, name: str, where: object, value: float) -> Log:
    changed = np.array(getattr(log, name))
    changed[where] = value
    return log._replace(**{name: changed})


LOGS = {
    "shapes": (
        lambda log: Log(log.q[:, :5], log.tau),
        "log.q and log.tau must both be [T, 6], ticks first, got shapes (1000, 5) and (1000, 6)",
    ),
    "lengths": (
        lambda log: Log(log.q, log.tau[:-1]),
        "log.q and log.tau must both be [T, 6], ticks first, got shapes (1000, 6) and (999, 6)",
    ),
    "short": (lambda log: Log(log.q[:50], log.tau[:50]), "log must have at least 100 ticks, got 50; record a longer motion"),
    "dropout": (
        lambda log: with_cell(log, "q", (slice(7, 9), 2), np.nan),
        "log.q holds 2 values that are not finite, the first at tick 7 of joint 3; "
        "cut the log there, or interpolate single dropouts",
    ),
    "moving": (
        lambda log: Log(log.q[300:], log.tau[300:]),
        "log must start with the arm at rest, got 6.6 rad/s in joint 3; "
        "at most 0.15 rad/s pass, so begin the log before the motion does",
    ),
    "still": (
        lambda log: with_cell(log, "q", (slice(None), 4), 0.5),
        "joint 5 (joint5) moved by 0 rad in the log; "
        "at least 0.01 rad is needed to identify it, so record a motion of every joint",
    ),
}


@pytest.mark.parametrize("case", LOGS)
@pytest.mark.parametrize("fit", FIT)
def test_a_bad_log_is_refused(rigid, clean, fit, case):
    spoil, text = LOGS[case]
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        FIT[fit](*rigid, spoil(clean))


def test_errors_take_a_joint_that_stood_still(rigid, clean):
    assert np.isfinite(worst(identify.errors(*rigid, LOGS["still"][0](clean)))["fifty_step"])


def test_a_trace_of_many_scenarios_is_refused(clean_trace):
    many = jax.tree.map(lambda x: jnp.stack([x, x], axis=-1), clean_trace)
    text = (
        "trace must be of one run, [T, n], got y of shape (1000, 6, 2); "
        "take one scenario of it: jax.tree.map(lambda x: x[i], trace)"
    )
    with pytest.raises(ValueError, match=re.escape(text)):
        identify.from_trace(many)


def test_a_log_that_shows_too_little_is_refused(torque, noisy):
    config, _ = torque
    rest = jnp.zeros(config.n)
    held = with_cell(
        noisy, "tau", (slice(None), 3), jaxftc.inverse_dynamics(config.robot, jnp.asarray(noisy.q[0]), rest, rest)[3]
    )
    text = (
        "the log shows only 13 of the 15 unknowns of joint 1's model; "
        "record a motion with changing accelerations, or lower order_a and order_b"
    )
    with pytest.raises(ValueError, match=re.escape(text)):
        identify.fit_batch(*torque, held)


def test_a_model_that_explodes_in_the_horizon_is_refused(rigid, noisy):
    config, gains = rigid
    wild = gains.replace({"arx.kappa_a": gains.arx.kappa_a * jnp.asarray([[9.0, -9.0, 9.0]])})
    text = "the given model of joint 1 explodes within the horizon; start from default_gains, or shorten it"
    with pytest.raises(ValueError, match=re.escape(text)):
        identify.fit_multistep(config, wild, noisy, horizon=1000)


REFUSED = {
    "half_window": (
        lambda c, g, log: identify.model_input(c, log, half_window=0),
        "half_window must be an integer of at least 1, got 0; 1 is the difference of two readings",
    ),
    "horizon": (
        lambda c, g, log: identify.fit_multistep(c, g, log, horizon=0),
        "horizon must be an integer of at least 1, got 0; 50 ticks is the default, the length of the log is the free run",
    ),
    "steps": (
        lambda c, g, log: identify.fit_multistep(c, g, log, steps=0),
        "steps must be an integer of at least 1, got 0; 60 is the default",
    ),
    "u": (
        lambda c, g, log: identify.regressors(c, g.arx, log.q, log.q[1:]),
        "q and u must both be [T, 6], ticks first, got shapes (1000, 6) and (999, 6)",
    ),
    "scenario axes": (
        lambda c, g, log: identify.fit_batch(c, jax.tree.map(lambda leaf: leaf[..., None], g), log),
        "gains of one arm are needed, without scenario axes, got arx.kappa_a of shape (6, 3, 1)",
    ),
    "kappa": (
        lambda c, g, log: identify.with_kappa(c, g, np.zeros((6, 5))),
        "kappa must be [6, 6]: order_a, inputs times order_b, 1; got shape (6, 5)",
    ),
    "prior": (
        lambda c, g, log: identify.rls_init(c, g, prior=0.0),
        "prior must be a positive, finite number of regressor units, 1e-3 where nothing else is known, got 0.0",
    ),
    "quiet": (
        lambda c, g, log: identify.rls_init(c, g, quiet=-1.0),
        "quiet must be a finite number of rad, 0 or more, got -1.0; 2e-4 suits an encoder's noise of 3e-5",
    ),
    "phi": (
        lambda c, g, log: identify.rls_step(identify.rls_init(c, g), jnp.zeros((6, 5)), jnp.zeros(6), jnp.zeros(6, bool)),
        "phi must be [6, 6] with y's axes behind, got shape (6, 5)",
    ),
    "forgetting": (
        lambda c, g, log: identify.rls_step(
            identify.rls_init(c, g), jnp.zeros((6, 6)), jnp.zeros(6), jnp.zeros(6, bool), 1.5
        ),
        "forgetting must lie in [0.5, 1], got 1.5; 0.999 remembers about 1000 ticks",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_arguments_are_refused(rigid, clean, case):
    call, text = REFUSED[case]
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        call(*rigid, clean)
