"""The arm that is learned while it runs: payload and friction taken up, faults left to the fault estimate."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from twins.adaptation import Twin

import jaxftc
from jaxftc.observer import adaptation
from jaxftc.robot import dynamics, rigid_body
from jaxftc.scenarios import reference
from jaxftc.types import Measurement, Verdict
from tests.arms import three_hinges
from tests.backends import BACKENDS

N, DT = 3, 1e-3
LOAD, FRICTION = 0.4, 1.15  # kg, factor: what the arms of these tests have that their model has not


@pytest.fixture(scope="module")
def config() -> jaxftc.Config:
    return jaxftc.Config(three_hinges(), engine="chain", adaptive=True)


@pytest.fixture(scope="module")
def gains(config) -> jaxftc.Gains:
    return jaxftc.default_gains(config)


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def signals(rng, ticks: int, size: float = 1.0):
    """Inputs of some ticks [T] in which every joint moves."""
    column = lambda: jnp.asarray(rng.normal(size=(ticks, N)))  # noqa: E731
    columns = adaptation.Columns(column(), column(), column())
    return adaptation.Inputs(size * column(), 3.0 + abs(column()), jnp.zeros((ticks, N), bool), columns)


def run_block(config, gains, inputs, state=None):
    """Last state, and corrections [T]."""
    start = adaptation.init(config, gains, jnp.zeros(N)) if state is None else state
    return jax.jit(lambda g, s, i: jax.lax.scan(lambda s, i: adaptation.step(config, g, s, i), s, i))(gains, start, inputs)


def test_it_is_bayesian_regression(config, gains, rng):
    """Same mean and variance as the dense normal equations, tick by tick, where neither clip acts."""
    gains = gains.replace({"diagnosis.alpha_tau": 1e3, "adaptation.noise": 5e-4, "adaptation.memory": 0.05})
    inputs = signals(rng, 40, size=2.0)
    state, got = run_block(config, gains, inputs)
    twin, delayed, made = Twin(N), [np.zeros(N)] * 3, np.zeros(N)
    share = 0.5 * (1 - np.asarray(gains.arx.xi_a))
    speed = np.asarray(config.robot.coulomb_speed)
    for k in range(40):
        y, moving = twin.rows(*delayed), np.tanh(np.asarray(inputs.qd[k]) / speed) ** 2
        kept = np.exp(-DT * moving / 0.05)
        assert np.ptp(kept) < 1e-6, "one memory for all joints, as the twin has it"
        twin.take_in(y, made - inputs.torque[k], DT * moving / (0.1 * 0.5**2), kept[0])
        now = [np.asarray(column[k]) for column in inputs.columns]
        tau = twin.rows(*now) @ twin.mean()
        np.testing.assert_allclose(got.tau[k], tau, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(got.trust[k], 1 / np.sqrt(1 + twin.variance(y) / 0.25), rtol=1e-6)
        delayed = [old + share * (new - old) for old, new in zip(delayed, now, strict=True)]
        made = made + share * (tau - made)
    np.testing.assert_allclose(np.concatenate(state.phi), twin.mean(), rtol=1e-6, atol=1e-9)
    assert 0.01 < np.abs(twin.mean()).max() < adaptation.BOUND


def test_a_payload_s_torque_is_what_it_adds_to_the_arm(rng, config):
    robot = config.robot
    q, qd, qdd = (jnp.asarray(rng.normal(size=N)) for _ in range(3))
    at = rigid_body.pose(robot, q)

    def torque(kg):
        bodies = rigid_body.scaled_inertias(robot, jnp.ones(N), jnp.asarray(kg))
        return np.array(rigid_body.newton_euler(robot, bodies, at, list(qd), list(qdd)))

    np.testing.assert_allclose(dynamics.load_torque(robot, at, qd, qdd), torque(1.5) - torque(0.5), rtol=1e-9)


def test_what_is_learned_stays_within_what_an_arm_can_differ_by(config, gains, rng):
    inputs = signals(rng, 1000)
    columns = adaptation.Columns(jnp.zeros((1000, N)), jnp.zeros((1000, N)), jnp.ones((1000, N)))
    state, _ = run_block(config, gains, inputs._replace(torque=jnp.full((1000, N), -9.0), columns=columns))
    arm = adaptation.learned(gains, state)
    np.testing.assert_array_equal((arm.load, *arm.viscous), 0.0)
    np.testing.assert_allclose(arm.coulomb, 0.3, rtol=1e-9)  # two standard deviations of 0.15


def test_hours_at_one_speed_round_to_nothing_bad(config, gains):
    """Viscous and Coulomb friction look the same, in float32, with a sigma of next to nothing."""
    gains = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), gains)
    one = jnp.ones((20_000, N), jnp.float32)
    gains = gains.replace({"diagnosis.alpha_tau": 0.01, "adaptation.memory": 1e4})
    inputs = adaptation.Inputs(-0.3 * one, one, one > 2, adaptation.Columns(3.0 * one, one, one))
    start = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), adaptation.init(config, gains, one[0]))
    state, got = run_block(config, gains, inputs, start)
    known = adaptation.posterior(state.information)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((known, got)))
    assert (np.asarray((known.vv, known.cc)) > 0).all() and (np.asarray(got.trust) > 0).all()
    assert (np.asarray(got.trust) <= 1).all()


@pytest.mark.parametrize("why", ["standing", "alarmed"])
def test_nothing_is_learned_or_forgotten_at_rest_or_under_a_verdict(config, gains, rng, why):
    moved, _ = run_block(config, gains, signals(rng, 100))
    inputs = signals(rng, 50, size=10.0)
    if why == "standing":
        inputs = inputs._replace(qd=jnp.zeros_like(inputs.qd))
    else:  # one joint's verdict, and one only at first: what comes in HOLD counts as little
        inputs = inputs._replace(alarmed=inputs.alarmed.at[0, 1].set(True))
    after, _ = run_block(config, gains, inputs, moved)
    jax.tree.map(np.testing.assert_array_equal, after.information, moved.information)


def test_learning_goes_on_after_a_verdict(config, gains, rng):
    moved, _ = run_block(config, gains, signals(rng, 100))
    inputs = signals(rng, round(adaptation.HOLD / DT) + 10)
    after, _ = run_block(config, gains, inputs._replace(alarmed=inputs.alarmed.at[0].set(True)), moved)
    assert np.abs(after.information.lz - moved.information.lz).max() > 1e-3


@pytest.mark.thorough
def test_slopes_are_those_of_finite_differences(config, gains, rng):
    inputs = signals(rng, 15)
    start, _ = run_block(config, gains, signals(rng, 30))

    def cost(own, torque):
        changed = dataclasses.replace(gains, adaptation=own)
        _, got = run_block(config, changed, inputs._replace(torque=torque), start)
        return (got.tau**2).sum() + got.trust.sum()

    check_grads(cost, (gains.adaptation, inputs.torque), order=1, atol=1e-5, rtol=1e-5, eps=1e-6)


# In the loop.


@functools.partial(jax.jit, static_argnums=0)
def loop(config, gains, loads, friction, fault):
    """(Outputs, states) [T] of an arm that goes to and fro, with a payload [T] kg and a torque fault [T, n] N m.

    Readings are without noise, and the payload may change while it runs.
    """
    a, b = jnp.zeros(N), jnp.asarray([0.9, -1.1, 1.0])
    plant = dynamics.nominal_plant(config.robot)._replace(damping=friction, coulomb=friction)

    def body(carry, now):
        q, qd, tau, state = carry
        k, load, wrong = now
        t = k * config.dt
        back = jnp.floor(t).astype(int) % 2 > 0
        desired = reference.cubic(jnp.where(back, b, a), jnp.where(back, a, b), 1.0, t - jnp.floor(t))
        state, out = jaxftc.step(config, gains, state, desired, Measurement(q, tau))
        arm = plant._replace(payload=load)
        q, qd = dynamics.advance(config.robot, "chain", arm, q, qd, out.tau + wrong, config.dt)
        return (q, qd, out.tau, state), (out, q - desired.q, state.adaptation)

    start = jaxftc.init(config, gains, a)
    return jax.lax.scan(body, (a, jnp.zeros(N), start.command.tau, start), (jnp.arange(len(loads)), loads, fault))[1]


def run(config, gains, *, load=0.0, since=0.0, friction=1.0, fault=0.0, fault_at=np.inf):
    """Outputs, tracking errors and what is known of the arm, [T] of 3 s: a payload from ``since`` s on, joint 2's fault."""
    t = np.arange(3000) * DT
    wrong = np.outer(fault * (t >= fault_at), [0.0, 1.0, 0.0])
    out, error, states = loop(config, gains, load * jnp.asarray(t >= since), jnp.full(N, friction), jnp.asarray(wrong))
    arm = None if states is None else jax.vmap(functools.partial(adaptation.learned, gains))(states)
    return jax.tree.map(np.asarray, (out, error, arm))


@pytest.fixture(scope="module")
def off(config) -> jaxftc.Config:
    return dataclasses.replace(config, adaptive=False)


@pytest.fixture(scope="module")
def tight(gains) -> jaxftc.Gains:
    """Thresholds that the arm with its model exceeds, without learning, by far."""
    return gains.replace({"diagnosis.alpha_tau": 0.5})


def rms(signal: np.ndarray) -> np.ndarray:
    return np.sqrt((signal[300:] ** 2).mean(0))


def test_payload_and_friction_are_learned_and_the_residual_shrinks(config, off, tight):
    """After 0.3 s a fifth of the residual is left, the numbers are those of the arm, and nothing is called a fault."""
    (before, *_), (after, _, arm) = (run(c, tight, load=LOAD, friction=FRICTION) for c in (off, config))
    assert (rms(after.residual_tau) < 0.2 * rms(before.residual_tau)).all()
    assert before.detected.mean() > 0.5 and not after.detected.any()
    np.testing.assert_allclose(arm.load[[300, -1]], LOAD, atol=0.03)
    np.testing.assert_allclose(arm.coulomb[-1], FRICTION - 1, atol=0.08)
    np.testing.assert_allclose(arm.viscous[-1], FRICTION - 1, atol=0.05)


def test_a_model_that_is_right_is_left_alone(config, off, gains):
    (before, was, _), (after, now, arm) = (run(c, gains) for c in (off, config))
    assert np.abs(arm.load).max() < 0.01 and np.abs(arm.viscous).max() < 0.01 and np.abs(arm.coulomb).max() < 0.01
    assert np.abs(after.tau - before.tau).max() < 0.05 and np.abs(now - was).max() < 1e-4
    assert not after.detected.any()


def test_with_nothing_to_learn_it_is_the_cascade(config, off, gains):
    none = gains.replace({f"adaptation.{name}": 0.0 for name in ("load", "viscous", "coulomb")})
    before, after = (run(c, none, load=LOAD, fault=8.0, fault_at=0.5)[0] for c in (off, config))
    for name, mine, theirs in zip(before._fields, after, before, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-9 * np.abs(theirs).max(), err_msg=name)


def test_a_payload_that_comes_while_it_runs_is_learned(config, gains):
    """One that raises no alarm: within 2 s, two memories, four fifths of it."""
    out, _, arm = run(config, gains, load=0.15, since=0.4)
    assert not out.detected.any()
    assert np.abs(arm.load[390]) < 0.01
    np.testing.assert_allclose(arm.load[2400:], 0.15, atol=0.03)


@pytest.mark.parametrize("fault", [3.0, 8.0, -20.0])
def test_a_sudden_fault_is_not_learned_away(config, off, gains, fault):
    """At the same thresholds it is found 15 ms later at most, and two seconds later it is still there in full."""
    (before, *_), (after, _, arm) = (run(c, gains, load=0.1, fault=fault, fault_at=0.5) for c in (off, config))
    found = [np.flatnonzero(out.verdict[:, 1] & Verdict.ACTUATOR)[0] for out in (before, after)]
    assert 500 < found[1] <= found[0] + 15
    assert not after.detected[:500].any() and (after.verdict[found[1] + 20 :, 1] == Verdict.ACTUATOR).all()
    np.testing.assert_allclose(after.fault_tau_hat[600:, 1], fault, atol=0.5 + 0.05 * abs(fault))
    assert np.abs(arm.load[-1] - arm.load[490]) < 0.05, "the load is that of before"


@pytest.mark.thorough
def test_it_follows_from_the_log_alone(config, gains):
    """Reference, readings and torques say all: replayed without plant and fault, the tick says the same."""
    scenario = jaxftc.paper_scenario("actuator", config)
    scenario = scenario._replace(plant=scenario.plant._replace(payload=jnp.asarray(0.3)))
    trace = jaxftc.simulate(dataclasses.replace(config, duration=0.2), gains, scenario, jax.random.key(0))
    desired = jax.vmap(lambda t: reference.cubic(scenario.q_start, scenario.q_goal, config.t_final, t))(trace.t)
    start = jaxftc.init(config, gains, scenario.q_start)
    tau = jnp.vstack([start.command.tau, trace.out.tau[:-1]])
    again = jax.jit(lambda log: jax.lax.scan(lambda s, x: jaxftc.step(config, gains, s, *x), start, log)[1])(
        (desired, Measurement(trace.y, tau))
    )
    for name in ("tau", "statistic_tau", "fault_tau_hat"):
        mine, theirs = np.asarray(getattr(again, name)), np.asarray(getattr(trace.out, name))
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-9 * np.abs(theirs).max(), err_msg=name)


# Around it.


@pytest.mark.thorough
@pytest.mark.parametrize("backend", BACKENDS)
def test_the_compiled_tick_learns_the_same(config, gains, backend):
    tick = jaxftc.Tick(config, gains, backend=backend)
    q, zero = np.array([0.1, -0.4, 0.3]), np.zeros(N)
    mine, theirs = tick.init(q), jaxftc.init(config, gains, q)
    step = jax.jit(functools.partial(jaxftc.step, config, gains))
    for k in range(30):
        told = jaxftc.Reference(q + 1e-3 * k, zero + 1.0, zero), Measurement(q + 0.9e-3 * k, zero + 2.0)
        (mine, said), (theirs, wanted) = tick.step(mine, *told), step(theirs, *told)
        np.testing.assert_allclose(said.tau, wanted.tau, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(said.statistic_tau, wanted.statistic_tau, rtol=1e-9, atol=1e-9)
    assert np.abs(adaptation.learned(gains, theirs.adaptation).load) > 1e-3, "it has learned something"


@pytest.mark.parametrize("change", [{"scheme": "momentum"}, {"input": "torque"}])
def test_what_cannot_learn_says_so(config, change):
    with pytest.raises(ValueError, match=r"adaptive.*scheme.*input='rigid_body'"):
        dataclasses.replace(config, **change)


def test_it_is_a_variant_by_name(config):
    assert jaxftc.variants.changes("adaptive") == {"adaptive": True}
    with pytest.raises(ValueError, match=r"got 'adaptive'; that is adaptive=True of the scheme 'cascade'"):
        dataclasses.replace(config, scheme="adaptive")


@pytest.mark.parametrize("value", ["no", 1, 0, None])
def test_it_is_on_or_off(config, value):
    with pytest.raises(ValueError, match="adaptive must be True or False, got"):
        dataclasses.replace(config, adaptive=value)


def test_its_gains_are_tuned_where_it_runs(config, off):
    from tuning.transform import tunable

    own = {f"adaptation.{field.name}" for field in dataclasses.fields(jaxftc.gains.AdaptationGains)}
    assert own <= set(tunable(config)) and not own & set(tunable(off))
