"""The baselines against closed forms, textbook filters and numerical derivatives; and what they cannot do."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc import stages
from jaxftc.gains import align
from jaxftc.observer import super_twisting
from jaxftc.observer.stage import Inputs
from jaxftc.robot import dynamics, lanes, rigid_body
from jaxftc.robot.model_file import compile_robot
from jaxftc.scenarios.faults import Sensor
from jaxftc.scenarios.reference import cubic
from jaxftc.schemes import ekf, momentum, registry
from jaxftc.types import Verdict
from jaxftc.variants import SCHEMES
from tests.arms import three_hinges
from tests.twins import printed
from tuning import transform

BASELINES = [scheme for scheme in SCHEMES if scheme != "cascade"]
N, RATE = 6, 120.0
SMALL = jaxftc.Config(three_hinges(), engine="chain")
FILTER_THOROUGH = pytest.mark.parametrize(
    "scheme", [pytest.param(name, marks=[pytest.mark.thorough] * (name == "ekf")) for name in BASELINES]
)


def hinge(damping: float = 0.0) -> jaxftc.Robot:
    """One hinge of constant inertia without gravity: a linear system."""
    body = '<body><inertial pos="0 0 .1" mass="1" diaginertia=".1 .1 .2"/>'
    joint = f'<joint axis="0 0 1" damping="{damping}"/></body>'
    return compile_robot("hinge", f'<mujoco><option gravity="0 0 0"/><worldbody>{body}{joint}</worldbody></mujoco>')


def quiet(config: jaxftc.Config, condition: str, **change: float) -> jaxftc.Scenario:
    """The paper's condition without encoder noise, its fault from 0.01 s on, for good."""
    scenario = jaxftc.paper_scenario(condition, config, **change)._replace(noise=jnp.zeros(()))
    late = lambda fault: fault._replace(onset=jnp.full(config.n, 0.01 - 1e-6), clear=jnp.full(config.n, jnp.inf))  # noqa: E731
    return scenario._replace(fault_tau=late(scenario.fault_tau), fault_q=late(scenario.fault_q))


@functools.cache
def run(config: jaxftc.Config, condition: str) -> jaxftc.Trace:
    gains = jaxftc.default_gains(config).replace({"baseline.speed_weight": 1.0, "baseline.rate": RATE})
    return jax.tree.map(np.asarray, jaxftc.simulate(config, gains, quiet(config, condition), jax.random.key(0)))


def of(config: jaxftc.Config, scheme: str, **change: object) -> jaxftc.Config:
    return dataclasses.replace(config, scheme=scheme, **change)  # pyright: ignore[reportArgumentType]


# What comes in.


def test_unknown_schemes_and_states_of_another_are_refused(config):
    with pytest.raises(ValueError, match=r"got 'momentun'.*'momentum'"):
        of(config, "momentun")
    gains, q = jaxftc.default_gains(config), jnp.zeros(config.n)
    told = jaxftc.Reference(q, q, q), jaxftc.Measurement(q, q)
    state = jaxftc.init(of(config, "momentum"), gains, q)
    with pytest.raises(ValueError, match=r"'cascade'.*got jaxftc.schemes.momentum.State"):
        jaxftc.step(config, gains, state, *told)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_scheme_starts_by_holding_the_arm(config, scheme):
    config, q = of(config, scheme), jnp.linspace(-1.0, 1.0, config.n)
    held = jaxftc.inverse_dynamics(config.robot, q, 0 * q, 0 * q)
    state = jaxftc.init(config, jaxftc.default_gains(config), q)
    np.testing.assert_allclose(state.command.tau, held, atol=1e-12)
    np.testing.assert_allclose(registry.holding_torque(config, q), held, atol=1e-12)
    np.testing.assert_array_equal(state.q, q)


@pytest.mark.parametrize("scheme", BASELINES)
def test_a_tick_uses_no_gain_that_is_idle(scheme):
    config = of(SMALL, scheme)
    gains, q = jaxftc.default_gains(config), jnp.linspace(-1.0, 1.0, config.n)
    zero = jnp.zeros_like(q)
    state = jax.tree.map(lambda x: x + 1e-3 * jnp.ones_like(x), jaxftc.init(config, gains, q))

    def cost(gains):
        told = jaxftc.Reference(q + 0.1, zero + 0.2, zero + 0.3), jaxftc.Measurement(q + 1e-3, state.command.tau + 0.1)
        leaves = jax.tree.leaves(jaxftc.step(config, gains, state, *told))
        return sum(
            (jnp.where(jnp.isfinite(leaf), leaf, 0.0) ** 2).sum() for leaf in leaves
        )  # no threshold is an infinite one

    slopes = jax.jit(jax.grad(cost))(gains)
    names = ["".join(str(key) for key in path)[1:] for path, _ in jax.tree_util.tree_leaves_with_path(gains)]
    flat = {name for name, slope in zip(names, jax.tree.leaves(slopes), strict=True) if not np.any(slope)}
    assert flat == transform.idle(config)


# Computed torque.


def test_computed_torque_tracks_the_papers_motion(config):
    config = of(config, "computed_torque", duration=1.0)
    scenario = jaxftc.paper_scenario("healthy", config)
    trace = jaxftc.simulate(config, jaxftc.default_gains(config), scenario, jax.random.key(0))
    assert np.rad2deg(np.abs(trace.q - trace.q_ref)).max() < 0.05
    assert not np.any(trace.out.verdict) and not np.any(trace.out.statistic_tau)
    assert np.isinf(trace.out.threshold_tau).all() and np.isinf(trace.out.threshold_q).all()


def matrix(mass, q):
    return jnp.stack([lanes.stack(row, q) for row in mass.rows])


# Momentum observer.


def test_momentum_and_its_drift_against_derivatives(puma):
    """C^T qd - g is the Lagrangian's gradient; M' qd is checked by central differences of M."""
    random = np.random.default_rng(0)
    q, qd = (jnp.asarray(random.normal(size=N)) for _ in range(2))

    def mass(q):
        return matrix(dynamics.nominal_mass(puma, rigid_body.pose(puma, q)), q)

    p, drift = momentum.momentum(puma, q, qd)
    np.testing.assert_allclose(p, mass(q) @ qd, atol=1e-12)
    at = rigid_body.pose(puma, q)
    gravity = dynamics.nominal_torque(puma, at, 0 * q, 0 * q)
    friction = puma.damping * qd + dynamics.coulomb(puma, qd)
    energy = jax.grad(lambda q: 0.5 * qd @ mass(q) @ qd)(q)  # C^T qd
    np.testing.assert_allclose(drift, energy - gravity - friction, atol=1e-11)
    turning = (mass(q + 1e-6 * qd) - mass(q - 1e-6 * qd)) @ qd / 2e-6  # M' qd
    coriolis = dynamics.nominal_torque(puma, at, qd, 0 * qd) - puma.damping * qd - gravity  # C qd
    np.testing.assert_allclose(drift, turning - coriolis - gravity - friction, atol=1e-7)


def low_passed(fault: np.ndarray, dt: float) -> np.ndarray:
    """Response r' = K_o (fault - r), sampled: closed form for a fault that is constant in a tick."""
    r, out = np.zeros(fault.shape[1]), []
    for f in fault:
        out.append(r)
        r = f + (r - f) * np.exp(-RATE * dt)
    return np.array(out)


def test_the_residual_is_the_fault_low_passed():
    """Exactly, for a hinge of constant inertia; speed_weight 1 leaves the difference quotient, which is exact there."""
    config = jaxftc.Config(hinge(), engine="chain", scheme="momentum", duration=0.06)
    trace = run(config, "actuator")
    assert np.abs(trace.fault_tau[10:]).min() == 5.0
    np.testing.assert_allclose(trace.out.residual_tau, low_passed(trace.fault_tau, config.dt), atol=1e-8)
    since = trace.t[10:] - 0.01
    np.testing.assert_allclose(trace.out.residual_tau[10:, 0], 5.0 * (1 - np.exp(-RATE * since)), atol=1e-8)


@pytest.mark.slow
def test_the_residual_is_the_fault_low_passed_on_the_whole_arm(config):
    """Up to what M changes in a tick."""
    trace = run(of(config, "momentum"), "actuator")
    np.testing.assert_allclose(trace.out.residual_tau, low_passed(trace.fault_tau, config.dt), atol=0.25)
    np.testing.assert_array_equal(trace.out.residual_tau, trace.out.fault_tau_hat)
    first = np.argmax(trace.out.verdict == Verdict.ACTUATOR, axis=0)  # 2 of 5 N m, and two more ticks
    expected = 10 + int(np.ceil(-np.log(1 - 2 / 5) / RATE / config.dt)) + config.alarm_ticks - 1
    assert np.abs(first - expected).max() <= 1


@pytest.mark.slow
def test_the_momentum_observer_takes_an_encoder_fault_for_a_torque(config):
    """A documented inability: one channel for two kinds of fault."""
    trace = run(of(config, "momentum"), "sensor")
    assert set(np.unique(trace.out.verdict)) == {0, Verdict.ACTUATOR}
    assert (trace.out.verdict[20] == Verdict.ACTUATOR).all()
    assert not np.any(trace.out.fault_q_hat) and not np.any(trace.out.residual_q)


# Extended Kalman filter.


def textbook(config: jaxftc.Config, gains: jaxftc.Gains, q: float, tau: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Means [T, 4] of a Kalman filter for one hinge: q, qd, tau_f, b. Short form, dense matrices."""
    dt, inertia, damping = config.dt, 0.2 + float(config.robot.armature[0]), float(config.robot.damping[0])
    noise, walks = float(gains.baseline.noise_y[0]), gains.baseline
    per = dt / (inertia + dt * damping)
    f = np.array([[1, dt * (1 - per * damping), dt * per, 0], [0, 1 - per * damping, per, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    g = np.array([dt * per, per, 0, 0])
    h = np.array([[1.0, 0, 0, 1]])
    spread = dt * np.square([0, float(walks.walk_qd[0]), inertia * float(walks.walk_psi[0]), float(walks.walk_b[0])])
    x, p, means = np.array([q, 0, 0, 0]), np.diag([noise**2, 0, 0, 0]), []
    for torque, reading in zip(tau, y, strict=True):
        x, p = f @ x + g * torque, f @ p @ f.T + np.diag(spread)
        if np.isfinite(reading):
            gain = p @ h.T / (h @ p @ h.T + noise**2)
            x, p = x + gain[:, 0] * (reading - h @ x), p - gain @ h @ p
        means.append(x)
    return np.array(means)


def test_the_filter_of_a_linear_arm_is_the_textbooks():
    """With noise, an actuator fault and readings that fail to come."""
    config = jaxftc.Config(hinge(damping=0.5), engine="chain", scheme="ekf", duration=0.06)
    gains = jaxftc.default_gains(config)
    random = np.random.default_rng(1)
    tau = random.normal(size=60)
    y = 0.3 + np.cumsum(1e-3 * random.normal(size=60))
    y[[5, 20, 21, 22]] = np.nan
    hold = jaxftc.Reference(*[jnp.zeros((60, 1))] * 3)

    def body(state, told):
        state, out = jaxftc.step(config, gains, state, *told)
        return state, (state.belief.mean, out)

    told = hold, jaxftc.Measurement(jnp.asarray(y)[:, None], jnp.asarray(tau)[:, None])
    means, out = jax.jit(lambda: jax.lax.scan(body, jaxftc.init(config, gains, jnp.asarray([0.3])), told)[1])()
    expected = textbook(config, gains, 0.3, tau, y)
    np.testing.assert_allclose(means, expected, rtol=1e-9, atol=1e-10)
    for name, column in (("q_hat", 0), ("fault_tau_hat", 2), ("fault_q_hat", 3)):
        np.testing.assert_array_equal(getattr(out, name)[:, 0], means[:, column])


def test_the_filters_jacobian_is_that_of_its_mean():
    """For P = v v^T the predicted covariance is (F v)(F v)^T + Q, and F v is a central difference of the mean."""
    config = of(SMALL, "ekf")
    gains = align(jaxftc.default_gains(config), 0).baseline
    random = np.random.default_rng(2)
    x, v = (jnp.asarray(random.normal(size=4 * config.n)) for _ in range(2))
    tau = jnp.asarray(20 * random.normal(size=config.n))
    predict = jax.jit(lambda mean, cov: ekf.predict(config, gains, ekf.Belief(mean, cov), tau))
    step, none = 1e-6, jnp.zeros((4 * config.n, 4 * config.n))
    ahead, behind = (predict(x + side * step * v, none) for side in (1, -1))
    pushed = (ahead.mean - behind.mean) / (2 * step)
    np.testing.assert_allclose(
        predict(x, jnp.outer(v, v)).cov - predict(x, none).cov, jnp.outer(pushed, pushed), rtol=1e-6, atol=1e-6
    )


@pytest.mark.thorough
def test_the_filters_covariance_stays_positive_in_single_precision(paper_arm):
    """Over a second of the paper's motion and faults, relative to the standard deviations."""
    with jax.enable_x64(False):
        config = jaxftc.Config(paper_arm, engine="chain", scheme="ekf")
        gains, scenario = jaxftc.default_gains(config), jaxftc.paper_scenario("both", config)
        trace = jaxftc.simulate(of(config, "computed_torque"), gains, scenario, jax.random.key(0))
        desired = jax.vmap(lambda t: cubic(scenario.q_start, scenario.q_goal, config.t_final, t))(trace.t)

        def body(state, told):
            state, out = jaxftc.step(config, gains, state, *told)
            return state, (state.belief.cov, out)

        first = registry.holding_torque(config, scenario.q_start)
        told = desired, jaxftc.Measurement(trace.y, jnp.vstack([first[None], trace.out.tau[:-1]]))
        start = jaxftc.init(config, gains, scenario.q_start)
        covs, out = jax.jit(lambda: jax.lax.scan(body, start, told)[1])()
    assert covs.dtype == jnp.float32 and np.isfinite(covs).all()
    covs = np.asarray(covs[9::10], np.float64)
    np.testing.assert_array_equal(covs, covs.swapaxes(1, 2))
    size = np.sqrt(np.diagonal(covs, axis1=1, axis2=2))
    assert size.min() > 0
    assert np.linalg.eigvalsh(covs / size[:, :, None] / size[:, None]).min() > 0
    assert np.abs(out.q_hat + out.fault_q_hat - trace.y).max() < 0.03


# Missing readings.


@pytest.fixture(scope="module")
def dropped():
    """A run of a scheme with no reading of any joint for 20 ticks, on an arm with a payload, so that predictions drift."""

    @functools.cache
    def one(scheme: str) -> jaxftc.Trace:
        arm = of(SMALL, scheme, duration=0.06)
        scenario = jaxftc.paper_scenario("healthy", arm)
        scenario = scenario._replace(plant=scenario.plant._replace(payload=jnp.asarray(1.0)))
        fault = scenario.fault_q._replace(
            kind=jnp.full(arm.n, Sensor.DROPOUT, jnp.int32), onset=jnp.full(arm.n, 0.0199), clear=jnp.full(arm.n, 0.0391)
        )
        trace = jaxftc.simulate(arm, jaxftc.default_gains(arm), scenario._replace(fault_q=fault), jax.random.key(3))
        return jax.tree.map(np.asarray, trace)

    return one


@FILTER_THOROUGH
def test_missing_readings_are_held_on_prediction(dropped, scheme):
    trace = dropped(scheme)
    assert np.isnan(trace.y[20:40]).all() and np.isfinite(trace.y[40:]).all()
    for name, leaf in trace.out._asdict().items():
        assert np.isfinite(leaf).all() or name.startswith("threshold"), name
    assert np.abs(trace.out.q_hat - trace.q).max() < 2e-3
    assert np.abs(trace.out.qd_hat - trace.qd).max() < 0.25


def test_a_reading_that_comes_back_is_no_momentum(dropped):
    trace = dropped("momentum")
    drift = np.abs(trace.out.q_hat - trace.q)[39]
    kick = np.abs(np.diff(trace.out.residual_tau, axis=0))
    assert drift.max() > 2e-4, "there is something to mistake for a speed"
    assert (kick[39] < 3 * kick[:39].max(0)).all()


@FILTER_THOROUGH
def test_a_joint_without_a_reference_holds_its_angle(scheme):
    config = of(SMALL, scheme)
    gains, q = jaxftc.default_gains(config), jnp.linspace(-1.0, 1.0, config.n)
    zero = jnp.zeros_like(q)
    state, tick = jaxftc.init(config, gains, q), jax.jit(jaxftc.step, static_argnums=0)
    measurement = jaxftc.Measurement(q, state.command.tau)
    held = tick(config, gains, state, jaxftc.Reference(q, zero, zero), measurement)
    lost = tick(config, gains, state, jaxftc.Reference(q.at[2].set(jnp.nan), zero, zero), measurement)
    jax.tree.map(np.testing.assert_array_equal, lost, held)


# Eq. (7) as printed.


def test_the_printed_super_twisting_is_the_papers(config):
    config = dataclasses.replace(config, sign="hard")
    gains = align(jaxftc.default_gains(config).replace({"observer.alpha_sm0": 20.0}), 0)
    state, errors = super_twisting.State(jnp.zeros(config.n)), np.random.default_rng(3).normal(size=(5, config.n)) * 1e-3
    late = np.zeros(config.n)
    for e in errors:
        inputs = Inputs(jnp.asarray(e), jnp.zeros_like(e), stages.of(config))
        state, psi = super_twisting.printed(config, gains, state, inputs)
        np.testing.assert_allclose(psi, late, atol=1e-12)
        late = np.array([printed.psi_sm_eq7(x, 120.0, 20.0) for x in e])


def test_the_printed_observer_runs_the_printed_equation(config):
    """With the correction weight 1 and no integral the innovation follows from the reading, so psi can be replayed."""
    config = dataclasses.replace(config, observer="eso_printed", sign="hard")
    gains = jaxftc.default_gains(config).replace({"observer.alpha_i": 0.0})
    scenario = jaxftc.paper_scenario("healthy", config)
    out = jaxftc.simulate(config, gains, scenario, jax.random.key(0)).out
    errors, psi = np.asarray(out.residual_q), []
    for q_hat, residual in zip(out.q_hat, out.residual_tau, strict=True):
        mass = matrix(dynamics.nominal_mass(config.robot, rigid_body.pose(config.robot, q_hat)), q_hat)
        psi.append(np.linalg.solve(np.asarray(mass), np.asarray(residual)))
    assert np.abs(psi[1:]).min() > 20.0  # the relay's own amplitude is 30 rad/s^2
    late = [[printed.psi_sm_eq7(x, 120.0, 30.0) for x in e] for e in errors[:-1]]
    np.testing.assert_allclose(psi[0], 0.0, atol=1e-9)
    np.testing.assert_allclose(psi[1:], late, rtol=1e-9, atol=1e-7)
