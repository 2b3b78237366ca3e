"""Every block against the plain NumPy twin that was written from the equations alone."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from twins import cascade as twin_cascade
from twins import control as twin_control
from twins import fuzzy as twin_fuzzy
from twins import laguerre as twin_laguerre
from twins import reference as twin_reference
from twins import threshold as twin_threshold

import jaxftc
from jaxftc import stages
from jaxftc.control import fuzzy_gain, sliding_mode, surface
from jaxftc.diagnosis import sensor_check, statistics, threshold
from jaxftc.fuzzy import rule_table
from jaxftc.gains import align
from jaxftc.observer import arx, cascade, laguerre, stability
from jaxftc.scenarios import reference
from jaxftc.types import Reference
from tests.arms import two_hinges

POLES = st.floats(-0.95, 0.95)
DT = 1e-3


def test_bank_is_the_convolution_with_the_laguerre_functions(rng):
    for xi in (0.8, -0.3, 0.0):
        u = rng.normal(size=80)
        x, seen = jnp.zeros((1, 4)), []
        for value in u:
            seen.append(x[0])
            x = laguerre.advance(jnp.array([xi]), x, jnp.array([value]))
        np.testing.assert_allclose(np.array(seen), twin_laguerre.filtered(xi, 4, u), atol=1e-12)


@given(POLES, st.integers(1, 5), st.integers(0, 2**31 - 1))
def test_bank_recursion_is_the_matrix_form(xi, order, seed):
    draw = np.random.default_rng(seed)
    a, b = twin_laguerre.bank_matrices(xi, order)
    x, u = draw.normal(size=(3, order)), draw.normal(size=3)
    ours = laguerre.advance(jnp.full(3, xi), jnp.asarray(x), jnp.asarray(u))
    np.testing.assert_allclose(ours, x @ a.T + np.outer(u, b), atol=1e-11)


@given(POLES)
def test_steady_gain_is_the_banks_rest_state(xi):
    a, b = twin_laguerre.bank_matrices(xi, 4)
    np.testing.assert_allclose(
        np.full(4, laguerre.steady_gain(jnp.asarray(xi))), np.linalg.solve(np.eye(4) - a, b), rtol=1e-8
    )


@given(st.floats(-0.5, 0.95))
def test_exact_read_out_is_the_twins(xi):
    kappa_a, kappa_b = arx.exact_kappa(jnp.array([xi]), 3, 2, DT)
    np.testing.assert_allclose(np.r_[kappa_a[0], kappa_b[0]], twin_laguerre.exact_kappa(xi, DT), rtol=1e-9, atol=1e-15)


def test_exact_read_out_predicts_a_double_integrator_at_any_order(rng):
    v = rng.normal(size=300)
    y = np.zeros(300)
    for k in range(299):
        y[k + 1] = 2 * y[k] - (y[k - 1] if k else 0.0) + DT**2 * v[k]
    for order_a, order_b in ((2, 2), (3, 2), (5, 4)):
        kappa_a, kappa_b = arx.exact_kappa(jnp.array([0.7]), order_a, order_b, DT)
        x_a, x_b = jnp.zeros((1, order_a)), jnp.zeros((1, order_b))
        for k in range(300):
            y_hat = float((kappa_a * x_a).sum() + (kappa_b * x_b).sum())
            assert abs(y_hat - y[k]) < 1e-14 + 1e-9 * np.abs(y).max(), (order_a, k)
            x_a = laguerre.advance(jnp.array([0.7]), x_a, jnp.array([y[k]]))
            x_b = laguerre.advance(jnp.array([0.7]), x_b, jnp.array([v[k]]))


@pytest.mark.parametrize("observer", ["pi", "eso", "ts"])
@pytest.mark.parametrize("hard", [False, True])
def test_cascade_is_the_twin_over_many_ticks(observer, hard, paper_arm, rng):
    """Readings with noise, a ramp, a jump up and back: every quantity of every tick."""
    config = jaxftc.Config(paper_arm, observer=observer, sign="hard" if hard else "smooth", engine="chain")
    gains = jaxftc.default_gains(config)
    gains = gains.replace({"observer.alpha_f2": 0.9, "observer.alpha_f3": 700.0})
    o, mass = gains.observer, np.diag(rng.uniform(0.2, 4.0, 6)) + 0.05
    a, b_y, b_v = twin_laguerre.block(0.8, 3, 0.8, 2)
    kappa = twin_laguerre.exact_kappa(0.8, DT)
    q0 = rng.uniform(-2, 2, 6)
    state = cascade.init(config, gains, jnp.asarray(q0))
    x = np.stack([twin_laguerre.rest_state(a, b_y, [q])[0] for q in q0])
    zero = np.zeros(6)
    mine = {"b": zero, "e_prev": zero, "psi_pi": zero, "g": zero, "psi_f": zero}
    history = (q0, q0, zero)
    sensors, on = sensor_check.nothing_found(jnp.zeros(6)), stages.of(config)
    for k in range(60):
        y = (
            q0
            + 3e-5 * rng.normal(size=6)
            + 0.02 * (15 <= k < 35) * np.array([1, 0, -1, 0, 0, 0.3])
            + 1e-5 * k**2 * np.eye(6)[1]
        )
        v = rng.normal(size=6)
        want = twin_cascade.tick(
            y, x, mine["b"], mine["e_prev"], mine["psi_pi"], mine["g"], mine["psi_f"], v,
            kappa=kappa, a=a, b_y=b_y, b_v=b_v, mass=mass, dt=DT,
            alpha_p=o.alpha_p[0], alpha_i=o.alpha_i[0], alpha_sm=o.alpha_sm[0], alpha_sm0=o.alpha_sm0[0],
            alpha_f1=o.alpha_f1[0], alpha_f2=o.alpha_f2[0], alpha_f3=o.alpha_f3[0], leak=o.leak[0], jump_limit=o.jump[0],
            threshold_tau=gains.diagnosis.alpha_tau[0], centres_tau=o.tau_centres, widths_tau=o.tau_widths,
            centres_jump=o.jump_centres, widths_jump=o.jump_widths, observer=observer, eps=None if hard else o.eps[0],
            history=history,
        )  # fmt: skip
        reading = cascade.Reading(jnp.asarray(y), jnp.asarray(history[2]), sensors)
        state, seen = cascade.correct(config, gains, state, reading, on)
        residual = mass @ np.asarray(seen.psi)
        state = cascade.adapt(config, gains, state, seen, jnp.asarray(residual), gains.diagnosis.alpha_tau, on)
        state = cascade.apply_input(gains, state, jnp.asarray(v) + seen.psi)
        close = {
            "y_hat": seen.y_hat, "e": seen.e, "q_hat": seen.q_hat, "psi": seen.psi, "residual_tau": residual,
            "b_next": seen.b, "h_s": seen.jump.h_s, "psi_pi_next": state.stages["pi"].psi,
            "g_next": state.stages["sliding"].gamma, "psi_f_next": state.fuzzy.psi,
            "x_next": jnp.concatenate([state.arx.x_a, state.arx.x_b], axis=1),
        }  # fmt: skip
        for name, value in close.items():
            np.testing.assert_allclose(value, want[name], rtol=1e-7, atol=1e-9, err_msg=f"{name} at tick {k}")
        history = (want["q_hat"], history[0], v + want["psi"])
        x, mine = (
            want["x_next"],
            {
                n: want[m]
                for n, m in (
                    ("b", "b_next"),
                    ("e_prev", "e"),
                    ("psi_pi", "psi_pi_next"),
                    ("g", "g_next"),
                    ("psi_f", "psi_f_next"),
                )
            },
        )
    assert (np.abs(want["b_next"]) > 0).any() == (observer == "ts")


@given(
    arrays(float, 3, elements=st.floats(-50, 50)),
    arrays(float, 3, elements=st.floats(-50, 50)),
    st.floats(0, 1),
    st.floats(0.01, 1),
)
def test_statistic_is_the_twin(r, z, w, leak):
    config = jaxftc.Config(two_hinges(), engine="chain")
    values = {"alpha_tau": 2.0, "alpha_q": 0.1, "lead": 0.0, "lam_tau": w, "lam_q": 1.0, "leak_tau": leak, "leak_q": 0.5}
    values |= {"rate": 10.0, "fast": 0.0, "stiction": 0.0} | dict.fromkeys(threshold.FOLLOW, 0.0)
    own = jaxftc.gains.DiagnosisGains(**{name: jnp.full(3, v) for name, v in values.items()})
    gains = dataclasses.replace(jaxftc.default_gains(config), diagnosis=own)
    start, inputs = statistics.State(jnp.asarray(z), jnp.zeros(3)), statistics.Inputs(jnp.asarray(r), jnp.asarray(r))
    state, (s_tau, s_q) = statistics.step(config, gains, start, inputs)
    s, z_next = twin_threshold.statistic(r, z, w, leak)
    np.testing.assert_allclose(s_tau, s, atol=1e-12)
    np.testing.assert_allclose(state.z_tau, z_next, atol=1e-12)
    np.testing.assert_allclose(s_q, r, atol=1e-12)  # weight 1: the residual itself


def test_table_1_is_the_papers():
    np.testing.assert_array_equal(rule_table.PRINTED, twin_fuzzy.TABLE_1)


@pytest.mark.parametrize("name", list(rule_table.TABLES))
def test_table_1_inference_is_the_double_sum(name, config, rng):
    gains = jaxftc.default_gains(config).control
    gains = dataclasses.replace(
        gains, q_widths=gains.q_widths * jnp.linspace(0.7, 1.5, 7), outputs=jnp.array([0.3, 1.4, 2.9])
    )
    q, s = rng.uniform(-7, 7, 40), rng.uniform(-2, 2, 40)
    ours = jax.jit(functools.partial(rule_table.infer, rule_table.TABLES[name]))(
        jnp.asarray(q),
        jnp.asarray(s),
        (gains.q_centres, gains.q_widths),
        (gains.s_centres, gains.s_widths),
        gains.outputs,
    )
    want = [
        twin_fuzzy.alpha_online(
            a, b, gains.q_centres, gains.q_widths, gains.s_centres, gains.s_widths, gains.outputs, rule_table.TABLES[name]
        )
        for a, b in zip(q, s, strict=True)
    ]
    np.testing.assert_allclose(ours, want, rtol=1e-10)


def test_equal_outputs_make_table_1_a_constant(config, rng):
    gains = dataclasses.replace(jaxftc.default_gains(config).control, outputs=jnp.full(3, 1.7))
    value = fuzzy_gain.alpha_online(config, gains, *(jnp.asarray(rng.normal(size=config.n)) for _ in range(2)))
    np.testing.assert_allclose(value, 1.7, rtol=1e-12)


def test_narrow_sets_give_the_nearest_rule_and_a_finite_slope():
    """Single precision, sets so narrow that every grade by itself would be 0."""
    centres, widths = jnp.linspace(-3, 3, 7, dtype=jnp.float32), jnp.full(7, 1e-4, jnp.float32)
    outputs = jnp.array([0.3, 1.4, 2.9], jnp.float32)
    q, s = jnp.array([-2.8, 0.3, 1.2], jnp.float32), jnp.array([-9.0, -1.2, 2.7], jnp.float32)

    def infer(q, centres, widths):
        return rule_table.infer(rule_table.PRINTED, q, s, (centres, widths), (centres, widths), outputs)

    row, column = np.round(np.asarray(q) + 3), np.clip(np.round(np.asarray(s) + 3), 0, 6)
    nearest = rule_table.PRINTED[row.astype(int), column.astype(int)]
    np.testing.assert_allclose(infer(q, centres, widths), np.asarray(outputs)[nearest], rtol=1e-6)
    slopes = jax.grad(lambda *args: infer(*args).sum(), argnums=(0, 1, 2))(q, centres, widths)
    assert all(np.isfinite(slope).all() for slope in slopes)


def test_mended_tables():
    printed, mended = rule_table.TABLES["printed"], rule_table.TABLES["symmetric"]
    assert (printed != printed[::-1, ::-1]).sum() == 12  # the printed table breaks its own symmetry
    np.testing.assert_array_equal(mended, mended[::-1, ::-1])
    assert (np.diff(rule_table.TABLES["s_only"][0][3:]) >= 0).all()


def test_gain_never_falls_below_its_floor(config):
    gains = dataclasses.replace(jaxftc.default_gains(config).control, outputs=jnp.zeros(3), floor=jnp.full(6, 0.2))
    np.testing.assert_array_equal(fuzzy_gain.alpha_online(config, gains, jnp.zeros(6), jnp.zeros(6)), 0.2)


@pytest.mark.parametrize("control", ["smc", "esmc", "afesmc"])
def test_law_is_the_twin(control, paper_arm, rng):
    config = jaxftc.Config(paper_arm, engine="chain", control=control)
    gains = align(jaxftc.default_gains(config), 0).control
    gains = dataclasses.replace(gains, k_b=jnp.full(6, 1.3), alpha_sm=jnp.full(6, 14.0))
    y, qd, psi, b = (rng.normal(size=6) for _ in range(4))
    desired = Reference(*(jnp.asarray(rng.normal(size=6)) for _ in range(3)))
    q = y if control == "smc" else y - b
    at = surface.surface(gains, jnp.asarray(q), jnp.asarray(qd), desired)
    qdd, factor = sliding_mode.law(config, gains, at, jnp.asarray(q), jnp.asarray(psi), desired, stages.of(config))
    mass, bias = np.eye(6), np.zeros(6)
    want = twin_control.law(
        control, y, b, qd, *(np.asarray(r) for r in desired), psi, mass, bias, bias, lam=gains.lam, a_sm=gains.alpha_sm,
        a_sm2=gains.alpha_sm2, k_b=gains.k_b, alpha_online=np.asarray(factor), eps=gains.eps,
    )  # fmt: skip
    np.testing.assert_allclose(at.s, want["s"], rtol=1e-12)
    np.testing.assert_allclose(qdd, want["bracket"], rtol=1e-12)


def test_reference_is_the_twin():
    q_0, q_f = reference.PAPER_START, reference.PAPER_GOAL
    np.testing.assert_allclose(np.rad2deg(q_0), twin_reference.Q_START_DEG)
    for t in (0.0, 0.3, 0.999, 1.0, 1.7):
        ours = reference.cubic(jnp.asarray(q_0), jnp.asarray(q_f), 1.0, jnp.asarray(t))
        np.testing.assert_allclose(np.array(ours), np.array(twin_reference.cubic(t, q_0, q_f, 1.0)), atol=1e-12)


def test_stability_is_that_of_the_twins_error_matrix(paper_arm):
    config = jaxftc.Config(paper_arm, engine="chain")
    gains = jaxftc.default_gains(config)
    o = gains.observer
    a, b_y, b_v = twin_laguerre.block(0.8, 3, 0.8, 2)
    radii = [
        twin_laguerre.spectral_radius(twin_laguerre.error_matrix(
            a, b_y, b_v, twin_laguerre.exact_kappa(0.8, DT), float(o.alpha_p[0]), float(o.alpha_i[0]), alpha_f,
            float(o.leak[0])))
        for alpha_f in (0.0, float(o.alpha_f1[0]))
    ]  # fmt: skip
    ours = stability.spectral_radius(config, gains)
    np.testing.assert_allclose(
        ours, max(radii[1], stability.spectral_radius(dataclasses.replace(config, observer="pi"), gains)[0]), rtol=1e-6
    )
    assert (ours < 1).all()


@pytest.mark.parametrize("alpha_p", [0.2, 0.5, 1.0])
def test_stability_limit_of_the_integral_gain(alpha_p, paper_arm):
    """alpha_i < alpha_p^2 (1 - xi)^2 (1 - xi^2) / T^2, from both sides."""
    config = jaxftc.Config(paper_arm, engine="chain", observer="pi")
    gains = jaxftc.default_gains(config)
    limit = alpha_p**2 * (1 - 0.8) ** 2 * (1 - 0.8**2) / DT**2
    for factor, stable in ((0.99, True), (1.01, False)):
        some = gains.replace({"observer.alpha_p": alpha_p, "observer.alpha_i": factor * limit})
        assert (stability.spectral_radius(config, some) < 1).all() == stable


def test_zero_gains_leave_the_open_model(config):
    """Without correction or integral the model runs on its input alone."""
    gains = jaxftc.default_gains(config)
    off = ("alpha_i", "alpha_sm", "alpha_sm0", "alpha_f1", "alpha_f2", "alpha_f3")
    gains = gains.replace({f"observer.{name}": 0.0 for name in off} | {"observer.alpha_p": 1e-300})
    state, on = cascade.init(config, gains, jnp.ones(config.n)), stages.of(config)
    zero = jnp.zeros(config.n)
    reading = cascade.Reading(zero + 1.3, zero, sensor_check.nothing_found(zero))
    for _ in range(5):
        state, seen = cascade.correct(config, gains, state, reading, on)
        state = cascade.adapt(config, gains, state, seen, zero, zero + 1, on)
        state = cascade.apply_input(gains, state, seen.psi)
        np.testing.assert_allclose(seen.y_hat, 1.0, atol=1e-9)
        np.testing.assert_array_equal(seen.psi, 0.0)


def test_stability_of_the_torque_form_is_refused(paper_arm):
    config = jaxftc.Config(paper_arm, engine="chain", input="torque")
    with pytest.raises(ValueError, match=r'stability needs input="rigid_body"; with "torque" the joints couple'):
        stability.spectral_radius(config, jaxftc.default_gains(config))


@pytest.fixture
def rng():
    return np.random.default_rng(7)
