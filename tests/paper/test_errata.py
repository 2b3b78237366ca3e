"""Errata of the paper, one test a row: the printed form fails, the corrected form holds in the same setting."""

import numpy as np
import pytest
from twins import cascade, control, fuzzy, laguerre, printed, reference, threshold

pytestmark = pytest.mark.slow  # proofs of what is printed, not tests of what runs

DT = 1e-3  # s
XI = 0.8
KAPPA = laguerre.exact_kappa(XI, DT)
A, B_Y, B_V = laguerre.block(XI, 3, XI, 2)
GAINS = dict(alpha_p=0.5, alpha_i=500.0, alpha_sm=100.0, alpha_sm0=20.0, alpha_f1=500.0, leak=0.002, eps=1e-3)


def joint_motion(v: np.ndarray) -> np.ndarray:
    """Position [T] rad of a rigid joint, at rest in 0, under the acceleration v [T] rad/s^2."""
    qd = DT * np.concatenate([[0.0], np.cumsum(v)])
    return np.concatenate([[0.0], np.cumsum(DT * qd[1:])])[: len(v)]


def follow(update, fault: float, ticks: int) -> tuple[np.ndarray, np.ndarray]:
    """Innovation e and estimate psi, [T] each, of an observer whose fault stage is update(state, e) -> (psi, state).

    One rigid joint, exact predictor, no command; a constant fault acts from the first tick, rad/s^2.
    """
    y = joint_motion(np.full(ticks, fault))
    x, state = np.zeros((1, 5)), (0.0, 0.0)
    innovations, estimates = np.zeros(ticks), np.zeros(ticks)
    for k in range(ticks):
        y_hat = x @ KAPPA
        innovations[k] = y[k] - y_hat[0]
        estimates[k], state = update(state, innovations[k])
        psi = estimates[k : k + 1]
        x = cascade.advance(x, y_hat, innovations[k : k + 1], np.zeros(1), psi, A, B_Y, B_V, alpha_p=0.5)
    return innovations, estimates


def observe(
    mass: float,
    fault_tau: float = 0.0,
    fault_q: float = 0.0,
    ticks: int = 400,
    **options,
) -> dict[str, np.ndarray]:
    """Traces [T] of the cascade on one joint of inertia mass kg m^2; faults in N m and rad act from tick 100 on.

    options replace arguments of cascade.tick.
    """
    on = np.arange(ticks) >= 100
    y = joint_motion(on * fault_tau / mass) + on * fault_q
    zero = np.zeros(1)
    state = dict(x=np.zeros((1, 5)), b=zero, e_prev=zero, psi_pi=zero, g=zero, psi_f=zero)
    model = dict(kappa=KAPPA, a=A, b_y=B_Y, b_v=B_V, mass=np.array([[mass]]), dt=DT)
    trace = {name: np.zeros(ticks) for name in ("y", "y_hat", "e", "psi", "residual_tau", "b_next")}
    for k in range(ticks):
        out = cascade.tick(y[k : k + 1], v=zero, **state, **model, **(GAINS | options))
        for name in ("y_hat", "e", "psi", "residual_tau", "b_next"):
            trace[name][k] = out[name][0]
        state = {name: out[f"{name}_next"] for name in ("x", "b", "psi_pi", "g", "psi_f")} | {"e_prev": out["e"]}
    trace["y"] = y
    return trace


def rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def test_eq_1_to_3_one_symbol_with_two_units_and_the_wrong_sign_of_omega():
    mass, bias = np.array([[2.0, 0.3], [0.3, 0.5]]), np.array([4.0, -1.0])
    nothing, psi = np.zeros(2), np.array([1.0, 0.0])

    # A positive Psi brakes in Eq. (1) and drives in Eq. (2).
    rest = printed.acceleration_eq1(mass, bias, bias, nothing)
    assert printed.acceleration_eq1(mass, bias, bias, psi)[0] < rest[0]
    assert printed.acceleration_eq2(mass, bias, bias, psi)[0] > rest[0]

    # A torque that just carries the load holds the arm; with omega = +(W + G) it throws it.
    assert np.abs(printed.acceleration_eq3(mass, bias, bias, nothing)).max() > 4.0
    np.testing.assert_allclose(control.model_acceleration(mass, bias, bias, nothing, nothing), 0.0, atol=1e-12)

    # Grams instead of kilograms multiply masses and torques by 1000 and no acceleration.
    tau = np.array([7.0, 2.0])
    corrected = control.model_acceleration(mass, tau, bias, nothing, psi)
    np.testing.assert_allclose(control.model_acceleration(1e3 * mass, 1e3 * tau, 1e3 * bias, nothing, psi), corrected)
    in_kg, in_g = (printed.acceleration_eq3(u * mass, u * tau, u * bias, psi) for u in (1.0, 1e3))
    assert np.abs(in_g - in_kg).max() > 1e3

    # The torque fault that belongs to the corrected Psi is A Psi.
    np.testing.assert_allclose(control.model_acceleration(mass, tau + mass @ psi, bias, nothing, nothing), corrected)


def test_eq_4_the_filter_is_applied_twice():
    v = 20 * np.sin(0.02 * np.arange(300))
    y = joint_motion(v)
    x_y, x_v = laguerre.filtered(XI, 3, y), laguerre.filtered(XI, 2, v)

    corrected = laguerre.predict(KAPPA, x_y, x_v)
    np.testing.assert_allclose(corrected, y, atol=1e-12)

    # A product of two filter outputs has the unit rad^2: twice the motion is predicted four times as large.
    once = printed.output_eq4(KAPPA[:3], KAPPA[3:], x_y, x_v)
    twice = printed.output_eq4(KAPPA[:3], KAPPA[3:], 2 * x_y, 2 * x_v)
    np.testing.assert_allclose(twice, 4 * once)
    assert rms(once - y) > 0.1 * rms(y)

    # Nor does a second convolution in place of the product describe the joint.
    again_y = np.stack([laguerre.filtered(XI, 3, x_y[:, i])[:, i] for i in range(3)], axis=1)
    again_v = np.stack([laguerre.filtered(XI, 2, x_v[:, i])[:, i] for i in range(2)], axis=1)
    assert rms(laguerre.predict(KAPPA, again_y, again_v) - y) > 0.1 * rms(y)


def test_eq_5_the_output_is_off_by_one_sample():
    v = 20 * np.sin(0.01 * np.arange(600))
    y = joint_motion(v)
    x, states = np.zeros(5), []
    for k in range(600):
        states.append(x)
        x = A @ x + B_Y * y[k] + B_V * v[k]
    states = np.array(states)

    # The index of Eq. (6), Y_hat(k) = kappa^T X_hat(k), is exact; that of Eq. (5) lags by one sample of motion, which
    # alone breaks the claim of 0.05 deg in the healthy condition.
    np.testing.assert_allclose(laguerre.predict(KAPPA, states[:, :3], states[:, 3:]), y, atol=1e-12)
    lag = y[1:] - printed.next_output_eq5(KAPPA, states)[:-1]
    np.testing.assert_allclose(lag, np.diff(y), atol=1e-12)
    assert np.rad2deg(np.abs(lag).max()) > 0.05


def test_eq_5_6_7_10_a_scalar_is_added_to_a_vector():
    nothing = np.zeros(1)

    def free_run(advance, psi: float) -> np.ndarray:
        x, y_hat = np.zeros((1, 5)), []
        for _ in range(1000):
            y_hat.append((x @ KAPPA)[0])
            x = advance(x, x @ KAPPA, nothing, nothing, np.array([psi]), A, B_Y, B_V, alpha_p=0.5)
        return np.array(y_hat)

    # An acceleration of 1 rad/s^2 for 1 s moves a joint by half a radian, not by fifty turns.
    np.testing.assert_allclose(free_run(cascade.advance, 1.0), joint_motion(np.ones(1000)), atol=1e-9)
    assert free_run(printed.advance_eq6, 1.0)[-1] > 100 * np.pi

    # Whatever scalar is put in for the fault, the best one leaves most of the needed vector b_v f uncovered.
    ones = np.ones(5) / np.sqrt(5)
    assert np.linalg.norm(B_V - ones * (ones @ B_V)) > 0.5 * np.linalg.norm(B_V)

    # A correction on every state spends itself in the input bank: the error fades in minutes instead of milliseconds.
    through_b_y = laguerre.spectral_radius(A + (1 - 0.5) * np.outer(B_Y, KAPPA))
    on_all = laguerre.spectral_radius(A + np.outer(B_Y, KAPPA) - 0.5 * np.outer(np.ones(5), KAPPA))
    assert -DT / np.log(through_b_y) < 0.02
    assert -DT / np.log(on_all) > 60.0


def test_eq_6_16_the_integral_state_collects_the_whole_estimate():
    gains = dict(alpha_p=0.5, alpha_i=500.0, alpha_f=500.0, leak=0.002)
    matrix = laguerre.error_matrix(A, B_Y, B_V, KAPPA, **gains)
    as_printed = matrix.copy()
    as_printed[5, 6] = 1.0  # psi_PI(k+1) = psi_PI(k) + psi_F(k) + alpha_i e
    assert laguerre.spectral_radius(matrix) < 1.0 < laguerre.spectral_radius(as_printed)

    def paper(state, e):
        psi_pi, psi_f = state
        return psi_pi + psi_f, (printed.psi_pi_eq6(psi_pi + psi_f, e, 500.0), 0.998 * psi_f + 500.0 * e)

    psi = observe(0.5, fault_tau=5.0, ticks=2000, alpha_sm=0.0, alpha_sm0=0.0)["psi"]
    assert psi[-1] == pytest.approx(10.0, rel=0.005)
    assert np.abs(follow(paper, fault=10.0, ticks=2000)[1]).max() > 1e6


def test_eq_7_16_gamma_is_a_relay_unless_it_is_integrated():
    def paper(state, e):
        psi_pi, psi_sm = state
        return psi_pi + psi_sm, (psi_pi + 500.0 * e, printed.psi_sm_eq7(e, 100.0, 20.0))

    settled = slice(500, None)
    error_corrected = observe(0.5, fault_tau=5.0, ticks=1000, observer="eso", eps=None)["psi"][settled] - 10.0
    error_paper = follow(paper, fault=10.0, ticks=1000)[1][settled] - 10.0
    assert rms(error_corrected) < 1.0
    assert rms(error_paper) > 10.0  # the relay's own amplitude: 20 rad/s^2, to and fro
    assert np.abs(np.diff(error_paper)).max() > 30.0 > 5.0 > np.abs(np.diff(error_corrected)).max()


def test_eq_10_16_delta_fuzzy_forgets_the_estimate():
    # delta_fuzzy is never assigned, so it stays at 0; then the fuzzy stage alone holds a fault only by a lasting error.
    e_paper, psi_paper = follow(lambda s, e: (s[0], (printed.psi_fuzzy_eq10(0.0, e, 500.0), 0.0)), 10.0, 1500)
    per_fault = KAPPA @ np.linalg.solve(np.eye(5) - A - (1 - 0.5) * np.outer(B_Y, KAPPA), B_V)  # lasting e, s^2
    loop_gain = 500.0 * per_fault
    assert loop_gain < 0.1
    assert psi_paper[-1] == pytest.approx(10.0 * loop_gain / (1 + loop_gain))
    assert e_paper[-1] == pytest.approx(10.0 * per_fault / (1 + loop_gain))

    only_fuzzy = dict(alpha_i=0.0, alpha_sm=0.0, alpha_sm0=0.0, leak=0.0, threshold_tau=1e-6)
    good = observe(0.5, fault_tau=5.0, ticks=1500, **only_fuzzy)
    assert good["psi"][-1] == pytest.approx(10.0, abs=1e-6)
    assert good["e"][-1] == pytest.approx(0.0, abs=1e-9)


def test_eq_11_12_v_is_not_positive_definite_and_the_matrix_is_singular():
    assert printed.lyapunov_eq11(e=0.0, psi=1.0, alpha_i=500.0, alpha_sm=100.0) < 0.0
    assert printed.lyapunov_eq11(e=-1e-4, psi=0.0, alpha_i=500.0, alpha_sm=100.0) < 0.0
    matrix = printed.lyapunov_matrix_eq12(3.0)
    assert np.linalg.eigvalsh(matrix) == pytest.approx([0.0, np.trace(matrix)], abs=1e-12)

    # With the plus sign V never falls, and a whole line of states leaves it where it is.
    grid = np.linspace(-1.0, 1.0, 20)
    assert min(printed.lyapunov_rate_eq12(e, psi, 3.0) for e in grid for psi in grid) >= -1e-12
    assert printed.lyapunov_rate_eq12(e=0.25, psi=1.5, alpha_sm=3.0) == pytest.approx(0.0, abs=1e-12)

    # The condition below Eq. (12) needs a positive definite matrix; for Delta Psi >= 0 there is none.
    for delta in (0.0, 1e-3, 0.1, 1.0, 10.0):
        condition = printed.condition_matrix_eq12(3.0, delta)
        assert np.linalg.eigvalsh((condition + condition.T) / 2).min() < 1e-12

    # The spectral radius does decide: one gain inside the stable range converges, one outside does not.
    for alpha_i, stable in ((3000.0, True), (4500.0, False)):
        radius = laguerre.spectral_radius(laguerre.error_matrix(A, B_Y, B_V, KAPPA, 0.5, alpha_i, leak=0.5))
        psi = follow(lambda s, e, gain=alpha_i: (s[0], (s[0] + gain * e, 0.0)), 10.0, 3000)[1]
        assert (radius < 1.0) == stable
        assert (np.abs(psi[-50:] - 10.0).max() < 1e-3) == stable


def test_eq_13_one_residual_cannot_tell_two_faults_apart():
    alpha_tau, alpha_q = 2.0, np.deg2rad(1.0)
    kinds = {(5.0, 0.0): 1, (0.0, np.deg2rad(1.5)): 2, (5.0, np.deg2rad(1.5)): 3, (0.0, 0.0): 0}
    for (fault_tau, fault_q), kind in kinds.items():
        trace = observe(2.0, fault_tau, fault_q)
        bits = [threshold.alarm(trace[name][-1:], a) for name, a in (("residual_tau", alpha_tau), ("b_next", alpha_q))]
        assert threshold.verdict(*bits) == kind

    # An estimated actuator fault leaves no output error: by Eq. (13) the arm looks healthy while 5 N m act on it.
    trace = observe(2.0, fault_tau=5.0)
    r_a, r_s = printed.residuals_eq13(trace["y"], trace["y_hat"])
    assert abs(r_a[-1]) < 1e-3 * alpha_q and abs(r_s[-1]) < 1e-3 * alpha_q
    assert trace["residual_tau"][-1] == pytest.approx(5.0, rel=0.05)

    # One number against two thresholds never gives more than one of the two single faults.
    for th_a, th_s in ((1.0, 2.0), (2.0, 1.0), (1.0, 1.0)):
        r = np.linspace(-3.0, 3.0, 121)
        assert not {1, 2} <= set(threshold.verdict(threshold.alarm(r, th_a), threshold.alarm(r, th_s)).tolist())
    assert {1, 2} <= set(threshold.verdict(np.array([True, False]), np.array([False, True])).tolist())


def test_eq_20_to_23_25_k_beta_is_only_in_the_proof():
    def inertia(q_2: float) -> np.ndarray:  # planar arm of two links, kg m^2
        c = np.cos(q_2)
        return np.array([[3.0 + 2.0 * c, 1.0 + c], [1.0 + c, 1.0]])

    # Without a fault Eq. (21) promises a fall, yet V of Eq. (20) rises under the printed law: at rest because A couples
    # the joints, and in motion (4 rad/s), because A itself grows. The corrected V = s^T s / 2 falls in both.
    a_sm, k, step = 1.0, 5.0, 0.01
    for s, q_2, qd_2 in ((np.array([-0.1, 1.0]), 0.0, 0.0), (np.array([2.0, 0.0]), -np.pi / 2, 4.0)):
        later = s - step * a_sm * np.sign(s)
        assert printed.lyapunov_rate_eq21(s, np.zeros(2), a_sm, k) < 0.0
        assert later @ inertia(q_2 + step * qd_2) @ later > s @ inertia(q_2) @ s
        assert later @ later < s @ s

    # A disturbance as large as the gain: the law decays like exp(-k t) with k_b s in it, and not at all without.
    def run(k_b: float) -> np.ndarray:
        surface, path = np.array([10.0, -4.0]), []
        for _ in range(1000):
            path.append(surface)
            bracket = control.acceleration(np.zeros(2), np.zeros(2), surface, np.zeros(2), 0.0, a_sm, k_b)
            surface = surface + DT * (bracket + a_sm * np.array([1.0, -1.0]))
        return np.linalg.norm(np.array(path), axis=1)

    bound = 1.001 * np.linalg.norm([10.0, -4.0]) * np.exp(-k * DT * np.arange(1000))
    assert np.all(run(k_b=k) <= bound)
    assert run(k_b=0.0)[-1] > 100 * bound[-1]


def test_eq_29_the_estimation_error_passes_the_threshold_only_at_first():
    trace = observe(2.0, fault_tau=5.0)
    fault = 5.0 * (np.arange(400) >= 100)
    beyond = printed.bound_eq29(fault, trace["residual_tau"], 2.0)  # all in N m, through the inertia
    assert not beyond[:100].any()
    assert beyond[101]
    # Eq. (29) asks for "beyond" at every sample of the fault, which is to say that the observer never converges.
    assert not beyond[100:].all()
    assert not beyond[160:].any()
    assert rms(trace["residual_tau"][300:] - 5.0) < 0.2


def test_algorithm_1_step_4_uses_steps_5_and_6():
    def first_stuck_step(available: set[str]) -> str | None:
        known = set(available)
        for step, needs, gives in printed.ALGORITHM_1:
            if not known.issuperset(needs):
                return step
            known |= set(gives)
        return None

    assert first_stuck_step(set()) == "fuzzy observer"
    assert first_stuck_step({"r", "threshold"}) is None  # values of the last tick

    # The same on numbers: a residual that does not exist yet poisons the estimate; the tick of the twin reads carried
    # values only, so its first call is already finite.
    missing = np.array([np.nan])
    weights = cascade.rule_weights(missing, np.zeros(1), (0.0, 1.0), (0.3, 0.3), (0.0, 1.0), (0.3, 0.3))
    assert np.isnan(weights[1]).all()
    trace = observe(2.0, ticks=1)
    assert all(np.isfinite(values).all() for values in trace.values())


@pytest.mark.parametrize(("r", "faulty"), [(0.1, False), (5.0, True), (-0.1, False), (-5.0, True)])
def test_eq_14_17_18_the_decision_is_inverted_for_negative_residuals(r, faulty):
    residual, alpha = np.array([r]), 2.0
    as_printed = printed.faulty_eq17(residual, printed.threshold_eq14(residual, residual, alpha, lam=1.0))[0]
    s, _ = threshold.statistic(residual, residual, w=0.5, leak=0.1)
    assert threshold.alarm(s, alpha)[0] == faulty
    assert as_printed == (faulty if r > 0 else not faulty)


def test_eq_19_the_surface_is_of_the_tracking_error():
    mass, lam, a_sm = np.array([[2.0]]), 10.0, 5.0
    zero, load = np.zeros(1), 6.0  # N m, gravity of a link in the horizontal, m g l sin q at q = pi/2

    def bias(q, qd):
        return load * np.sin(q)

    def run(as_printed: bool) -> float:
        q, qd, q_ref = np.array([np.pi / 2 + 0.1]), zero, np.array([np.pi / 2])
        for _ in range(2000):
            if as_printed:  # a perfect observer: residual and its rate are zero whatever the arm does
                tau = printed.torque_eq19(mass, lambda qd: bias(qd, qd), qd, zero, zero, zero, zero, lam, a_sm)
            else:
                now = (mass, bias(q, qd), zero)
                out = control.law(
                    "smc", q, zero, qd, q_ref, zero, zero, zero, *now, lam=lam, a_sm=a_sm, a_sm2=0.0, k_b=5.0, eps=0.02
                )
                tau = out["tau"]
            qd = qd + DT * control.model_acceleration(mass, tau, bias(q, qd), zero, zero)
            q = q + DT * qd
        return abs(q - q_ref)[0]

    assert run(as_printed=False) < 1e-3
    assert run(as_printed=True) > 0.1  # the error it started with, and the arm sags

    # Even without a load the printed switching term never sees the error.
    load = 0.0
    assert run(as_printed=False) < 1e-3
    assert run(as_printed=True) == pytest.approx(0.1, abs=1e-9)

    # omega = +(W + G) of Eq. (3) turns the load's compensation over and takes it for an acceleration.
    hold = printed.torque_eq19(mass, lambda qd: np.array([6.0]), zero, zero, zero, zero, zero, lam, a_sm)
    assert hold[0] == pytest.approx(-12.0)
    assert control.torque(mass, zero, np.array([6.0]), zero)[0] == pytest.approx(6.0)

    # S-dot must vanish on the reference; lambda (X - Xd-dot) does not.
    q, qd = np.array([1.0]), np.array([0.4])  # rad, rad/s, both equal to the reference's
    assert printed.surface_rate_eq19(zero, zero, q, qd, lam)[0] == pytest.approx(0.6 * lam)
    now, then = (control.surface(at, qd, at, qd, lam) for at in (q, q + DT * qd))
    assert (then - now)[0] == 0.0


def test_eq_24_30_the_printed_compensation_doubles_the_fault():
    mass, bias = np.array([[2.0, 0.3], [0.3, 0.5]]), np.array([4.0, -1.0])
    fault, zero = np.array([8.0, -3.0]), np.zeros(2)  # rad/s^2, estimated without error

    def surface_path(as_printed: bool) -> np.ndarray:
        s, path = zero, []
        for _ in range(500):
            path.append(s)
            # On the reference with lam = 0 the surface is the speed error, so s-dot is the joint's acceleration.
            if as_printed:
                free = control.acceleration(zero, zero, s, zero, 0.0, 1.0, 0.0, eps=0.01)
                tau = printed.torque_eq24(mass, free, fault, bias)
            else:
                bracket = control.acceleration(zero, zero, s, fault, 0.0, 1.0, 0.0, eps=0.01)
                tau = control.torque(mass, bracket, bias, zero)
            s = s + DT * control.model_acceleration(mass, tau, bias, zero, fault)
        return np.array(path)

    drift = surface_path(as_printed=True)
    np.testing.assert_allclose(drift[1] / DT, 2 * fault)  # at s = 0 only the disturbance is left of s-dot
    assert np.abs(drift[-1]).min() > 1.0
    np.testing.assert_allclose(surface_path(as_printed=False), 0.0, atol=1e-12)


def test_eq_26_to_28_the_bound_must_hold_the_error_of_the_estimate():
    fault, estimate = 10.0, 9.5  # rad/s^2
    grid = np.linspace(0.0, 12.0, 1201)

    def least_gain(psi: float) -> float:
        return next(a for a in grid if all(printed.condition_eq27(s, psi, a) for s in (-1.0, 1.0)))

    # Taken literally, the gain with an observer must be as large as the gain without one.
    assert least_gain(fault) == pytest.approx(fault)
    assert least_gain(fault - estimate) == pytest.approx(fault - estimate)

    def run(a: float, psi: float) -> tuple[float, float]:
        s, commands, path = np.zeros(1), [], []
        for k in range(1000):
            hold = 0.05 * np.sin(0.7 * k)  # noise of the measured speed, rad/s
            commands.append(control.acceleration(0.0, 0.0, s + hold, np.array([psi]), 0.0, a, 0.0)[0])
            s = s + DT * (commands[-1] + fault)
            path.append(s[0])
        return np.abs(path).max(), np.abs(np.diff(commands)).sum()

    # Twice the least gain, once with the estimate and once without it: both hold the surface, and the first one, which
    # Eq. (27) forbids, chatters less in proportion.
    spread_small, chatter_small = run(a=2 * (fault - estimate), psi=estimate)
    spread_large, chatter_large = run(a=2 * fault, psi=0.0)
    assert not printed.condition_eq27(1.0, fault, 2 * (fault - estimate))
    assert max(spread_small, spread_large) < 0.1
    assert chatter_large > 10 * chatter_small


def test_eq_33_the_height_of_a_set_is_always_one():
    centres, widths, outputs = np.linspace(-1.0, 1.0, 7), np.full(7, 0.15), np.array([0.5, 1.5, 2.5])
    heights = np.array([printed.output_height_eq33(c, 0.4) for c in outputs])
    np.testing.assert_allclose(heights, 1.0)

    for i, q in enumerate(centres):
        for j, s in enumerate(centres):
            gain = fuzzy.alpha_online(q, s, centres, widths, centres, widths, heights)
            assert gain == pytest.approx(1.0)  # whatever the table says
            sharp = fuzzy.alpha_online(q, s, centres, 0.2 * widths, centres, 0.2 * widths, outputs)
            assert sharp == pytest.approx(outputs[fuzzy.TABLE_1[i, j]])


def test_table_1_breaks_its_point_symmetry_in_12_cells():
    # Not an erratum but the reason for the symmetric variant; the counts also guard the transcription.
    table = fuzzy.TABLE_1
    broken = table != table[::-1, ::-1]
    assert broken.sum() == 12
    assert set(np.flatnonzero(broken.any(axis=1))) == {2, 3, 4}
    assert np.bincount(table.ravel()).tolist() == [18, 10, 21]


def test_eq_35_joint_3_ends_at_1530_deg():
    t_final = 1.3
    start, final = reference.Q_START_DEG, reference.Q_FINAL_DEG
    powers = t_final ** np.arange(4)
    end_printed = sum(c * p for c, p in zip(printed.coefficients_eq35(start, final, t_final), powers, strict=True))
    end = sum(c * p for c, p in zip(reference.coefficients(start, final, t_final), powers, strict=True))
    assert end_printed[2] == pytest.approx(1530.0)
    np.testing.assert_allclose(end, final)

    q, qd, _ = reference.cubic(t_final * (1 - 1e-9), start, final, t_final)
    np.testing.assert_allclose(q, final, atol=1e-5)
    np.testing.assert_allclose(qd, 0.0, atol=1e-5)
    slopes = printed.coefficients_eq35(start, final, t_final)
    assert np.abs(slopes[1] + 2 * slopes[2] * t_final + 3 * slopes[3] * t_final**2).min() > 100.0  # deg/s at the end


def test_eq_37_to_39_the_units_of_the_two_channels_are_swapped():
    channel = {"actuator": "N m", "sensor": "deg"}  # what acts: a motor's torque, an encoder's angle
    for name, unit in channel.items():
        assert printed.FAULTS_EQ37[name][1] == printed.THRESHOLDS_EQ37[name][1] != unit
    torque, angle = printed.FAULTS_EQ37["sensor"][0], np.deg2rad(printed.FAULTS_EQ37["actuator"][0])
    alpha_tau, alpha_q = printed.THRESHOLDS_EQ37["sensor"][0], np.deg2rad(printed.THRESHOLDS_EQ37["actuator"][0])
    mass = 0.2  # kg m^2, a wrist joint

    # 1.5 deg are 0.026: read as an actuator's torque, a fault that is lost a hundredfold below any useful threshold.
    # 5 read as an encoder's angle in SI units is more than the whole travel of all joints but one.
    assert np.abs(observe(mass, fault_tau=angle)["residual_tau"]).max() < 0.05 * alpha_tau
    travel = np.abs(reference.Q_FINAL_DEG - reference.Q_START_DEG)
    assert (np.rad2deg(torque) > travel).sum() == 5

    # With the labels exchanged, both faults pass their thresholds and each shows up in its own channel.
    actuator, sensor = observe(mass, fault_tau=torque), observe(mass, fault_q=angle)
    assert actuator["residual_tau"][-1] > alpha_tau and abs(actuator["b_next"][-1]) < alpha_q
    assert sensor["b_next"][-1] > alpha_q and abs(sensor["residual_tau"][-1]) < alpha_tau

    # A decision must not hang on the units: N m against an angle does, N m against N m does not.
    residual = observe(mass, fault_tau=0.5)["residual_tau"][-1]
    assert threshold.alarm(residual, np.deg2rad(1.0)) and not threshold.alarm(residual, 1.0)
    assert not any(threshold.alarm(unit * residual, unit * alpha_tau) for unit in (1.0, 1e3, 1e7))
