"""Contact told from motors' faults: against a twin, in the closed loop, and what must never be called one."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from twins import contact as twin

import jaxftc
from jaxftc.diagnosis import contact
from jaxftc.logs.diagnose import diagnose
from jaxftc.logs.log import Log
from jaxftc.realtime import reaction
from jaxftc.realtime.trips import Trip, Trips, Watch
from jaxftc.robot import forces, rigid_body
from jaxftc.robot.dynamics import inverse_dynamics
from jaxftc.scenarios.scenario import stack, trail
from jaxftc.simulation import closed_loop
from jaxftc.simulation.contact import torque
from tests.arms import three_hinges

CONTACT = int(jaxftc.Verdict.CONTACT)


@pytest.fixture(scope="module")
def small():
    return jaxftc.Config(three_hinges(), engine="chain", duration=0.4, contact=1)


@pytest.fixture(scope="module")
def gains(small):
    return jaxftc.default_gains(small)


def judged(config, q, statistic, threshold, verdict):
    """Verdicts and forces [n, ...], as NumPy arrays."""
    at = rigid_body.pose(config.robot, jnp.asarray(q))
    inputs = contact.Inputs(at, jnp.asarray(statistic), jnp.asarray(threshold), jnp.asarray(verdict, jnp.int32))
    return [np.asarray(found) for found in contact.judge(config, inputs)]


# The rule alone.


@pytest.mark.parametrize("robot", [three_hinges(), jaxftc.puma560()], ids=lambda robot: robot.name)
@pytest.mark.parametrize("motors", [1, 2])
def test_the_rule_equals_its_twin(robot, motors):
    random, count = np.random.default_rng(5), 400
    config = jaxftc.Config(robot, engine="chain", contact=motors)
    q, threshold = random.normal(size=(robot.n, count)), random.uniform(0.2, 3.0, (robot.n, count))
    statistic = random.normal(size=(robot.n, count)) * random.choice([1.0, 4.0], (robot.n, count))
    verdict = (np.abs(statistic) >= threshold) + 2 * (random.random((robot.n, count)) < 0.02)
    found = judged(config, q, statistic, threshold, verdict)
    wanted = [twin.judge(robot, *(x[:, k] for x in (q, statistic, threshold, verdict)), motors) for k in range(count)]
    touched = (found[0] == CONTACT).any(0)
    assert 20 < touched.sum() < count - 20
    for mine, theirs in zip(found, map(np.transpose, zip(*wanted, strict=True)), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-8, atol=1e-9)


def test_a_force_is_found_with_its_link_and_about_its_size():
    robot, random, count = jaxftc.puma560(), np.random.default_rng(6), 300
    config, side = jaxftc.Config(robot, engine="chain", contact=1), random.normal(size=(3, count))
    q, link = random.normal(size=(6, count)), random.integers(3, 7, count)
    place = forces.Place(jnp.asarray(link), jnp.asarray(random.random(count)), 0.05 * side / np.linalg.norm(side, axis=0))
    push = random.normal(size=(3, count))
    size = np.linalg.norm(push, axis=0)
    statistic = np.asarray(forces.joint_torques(robot, jnp.asarray(q), place, jnp.asarray(push)))
    threshold = np.broadcast_to(1e-4 * robot.torque_limit[:, None], (6, count))  # motors of a wrist are small
    verdict, force = judged(config, q, statistic, threshold, np.abs(statistic) >= threshold)
    told = (verdict == CONTACT).any(0)
    assert told.mean() > 0.9
    named = (verdict == CONTACT).sum(0)
    assert (named == link)[told].mean() > 2 / 3  # where the link's own joint bears too little, the one before is named
    ratio = (force.sum(0) / size)[told & (named == link)]
    assert 0.5 < np.median(ratio) < 1.1


def test_one_motor_is_no_contact_however_the_others_lean_on_it():
    """Up to a tenth of the largest, in units of the thresholds, is what an inexact model leaks."""
    config = jaxftc.Config(three_hinges(), contact=1)
    random, count = np.random.default_rng(7), 100
    q, statistic = random.normal(size=(3, count)), random.uniform(-1.9, 1.9, (3, count))
    statistic[random.integers(0, 3, count), np.arange(count)] = 20.0
    verdict, force = judged(config, q, statistic, np.ones((3, count)), np.abs(statistic) >= 1.0)
    np.testing.assert_array_equal(verdict, np.abs(statistic) >= 1.0)
    assert not force.any()


def test_two_motors_are_no_contact_where_two_may_fail():
    one, two = (jaxftc.Config(three_hinges(), contact=motors) for motors in (1, 2))
    q, statistic = np.array([0.3, -0.4, 0.8]), np.array([5.0, -4.0, 0.0])
    assert (judged(one, q, statistic, np.ones(3), [1, 1, 0])[0] == [CONTACT, CONTACT, 0]).all()
    assert (judged(two, q, statistic, np.ones(3), [1, 1, 0])[0] == [1, 1, 0]).all()


def test_nothing_is_said_while_a_reading_is_held_to_be_wrong():
    config = jaxftc.Config(three_hinges(), contact=1)
    for verdict in ([1, 1, 2], [1, 3, 1]):
        found, force = judged(config, np.zeros(3), np.array([5.0, -4.0, 2.0]), np.ones(3), verdict)
        np.testing.assert_array_equal(found, verdict)
        assert not force.any()


def test_what_cannot_be_judged_is_no_contact():
    config = jaxftc.Config(three_hinges(), contact=1)
    statistic = np.array([5.0, np.nan, 2.0])
    verdict, force = judged(config, np.zeros(3), statistic, np.ones(3), [1, 1, 1])
    np.testing.assert_array_equal(verdict, [1, 1, 1])
    assert not force.any()


@pytest.mark.parametrize("wrong", [-1, 3, 1.5, True])
def test_how_many_motors_may_fail(wrong):
    with pytest.raises(ValueError, match="contact must be"):
        jaxftc.Config(three_hinges(), contact=wrong)


# In the closed loop.


@pytest.fixture(scope="module")
def runs(small, gains):
    """Forces in five directions on the last link, a motor's fault on each joint, and a healthy run; one program."""
    healthy = jaxftc.healthy_scenario(small)
    axes = [(1.0, 0.0, 0.3), (0.0, 1.0, 0.3), (1.0, 1.0, 0.0), (-1.0, 0.5, 0.2), (0.4, -1.0, 0.5)]
    pushed = [healthy.with_contact(3, 30.0, 0.1, axis=axis) for axis in axes]
    ill = [healthy.with_actuator_bias(j, 8.0, 0.1) for j in (1, 2, 3)]
    ill += [healthy.with_actuator_loss(j, 0.8, 0.1) for j in (1, 2, 3)]
    scenarios = stack([*pushed, *ill, healthy])
    trace = jaxftc.simulate(small, gains, scenarios, jax.random.key(0))
    return len(pushed), scenarios, jax.tree.map(np.asarray, trace)


@pytest.mark.thorough
def test_most_forces_on_the_last_link_are_told(small, runs):
    count, _, trace = runs
    verdict, force = trace.out.verdict[:count], trace.out.force[:count]
    alarm = (verdict > 0).any(2).argmax(1)
    scored = verdict[np.arange(count), alarm + 60]
    assert (alarm > 100).all() and (scored == CONTACT).all(1).sum() >= count - 1
    touched = force.max(2) > 0
    np.testing.assert_array_equal(touched, (verdict & CONTACT > 0).any(2))
    assert 15 < np.median(force.max(2)[touched]) < 45


def test_a_motor_s_fault_is_never_called_a_contact(runs):
    count, _, trace = runs
    verdict = trace.out.verdict[count:]
    assert (verdict[:-1] == 1).any((1, 2)).all() and not (verdict & CONTACT).any() and not trace.out.force[count:].any()
    assert not verdict[-1].any()


def test_the_arm_is_pushed_as_the_force_says(small, runs):
    count, scenarios, trace = runs
    assert (trace.contact_tau[:, :100] == 0).all() and (trace.contact_tau[count:] == 0).all()
    q = jnp.asarray(trace.q[0, 250])
    place = forces.Place(*(leaf[0] for leaf in scenarios.contact[:3]))
    push = scenarios.contact.size[0] * scenarios.contact.axis[0]
    np.testing.assert_allclose(trace.contact_tau[0, 250], forces.joint_torques(small.robot, q, place, push), atol=1e-12)


def test_a_force_of_nothing_changes_nothing(small, gains, runs):
    _, scenarios, trace = runs
    last = jax.tree.map(lambda leaf: leaf[-1], scenarios).with_contact(2, 0.0, 0.05)
    others = jax.tree.map(lambda leaf, new: leaf.at[-1].set(new), scenarios, last)
    again = jaxftc.simulate(small, gains, others, jax.random.key(0))
    for mine, theirs in zip(jax.tree.leaves(again), jax.tree.leaves(trace), strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.thorough
def test_a_verdict_of_contact_changes_nothing_but_verdict_and_force(small, gains, runs):
    """What is said of torques does not reach the arm: switched off, everything else is the same."""
    count, scenarios, trace = runs
    off = jaxftc.simulate(dataclasses.replace(small, contact=0), gains, scenarios, jax.random.key(0))
    for name, mine in off.out._asdict().items():
        theirs = getattr(trace.out, name)
        if name == "verdict":
            assert not (np.asarray(mine) & CONTACT).any() and (mine[count:] == theirs[count:]).all()
        elif name == "force":
            assert not np.asarray(mine).any()
        else:
            np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-10, err_msg=name)


@pytest.mark.slow
def test_gradients_of_a_run_are_finite_with_a_contact(small, gains, runs):
    short = dataclasses.replace(small, duration=0.13)
    scenarios = trail(jax.tree.map(lambda leaf: leaf[jnp.array([0, 5, 11])], runs[1]))
    scenarios = scenarios._replace(contact=scenarios.contact._replace(onset=0.02 + 0 * scenarios.contact.onset))

    def loss(gains, size):
        pushed = scenarios._replace(contact=scenarios.contact._replace(size=size))
        trace = closed_loop.run_loop(short, None, gains, pushed, jax.random.key(0))
        return (trace.out.tau**2).mean() + (trace.q**2).mean() + trace.out.force.sum()

    slopes = jax.jit(jax.grad(loss, argnums=(0, 1)))(gains, scenarios.contact.size)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))
    assert slopes[1][0] != 0


@pytest.mark.parametrize("statistic", [(5.0, -4.0, 2.0), (0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (5.0, np.inf, 2.0)])
def test_no_gradient_passes_through_the_rule_and_none_is_lost_in_it(statistic):
    config = jaxftc.Config(three_hinges(), contact=1)

    def force(q, statistic, threshold):
        verdict = (jnp.abs(statistic) >= threshold).astype(jnp.int32)
        return contact.judge(
            config, contact.Inputs(rigid_body.pose(config.robot, q), statistic, threshold, verdict)
        ).force.sum()

    slopes = jax.grad(force, argnums=(0, 1, 2))(jnp.zeros(3), jnp.asarray(statistic), jnp.ones(3))
    np.testing.assert_array_equal(np.stack(slopes), 0.0)


@pytest.mark.thorough
def test_the_torque_of_a_contact_has_the_slopes_of_differences():
    robot, scenario = three_hinges(), jaxftc.healthy_scenario(jaxftc.Config(three_hinges()))
    scenario = scenario.with_contact(3, 30.0, 0.1, axis=(0.3, 1.0, 0.2), along=0.6, offset=(0.05, 0.0, 0.02), rise=0.1)

    def pushed(q, size):
        return torque(robot, scenario.contact._replace(size=size), jnp.asarray(0.15), q)

    check_grads(
        pushed, (jnp.array([0.3, -0.4, 0.8]), jnp.asarray(30.0)), order=1, modes=("fwd", "rev"), atol=1e-6, rtol=1e-6
    )
    for nothing in (0.0, 30.0):
        at = 0.15 if not nothing else 0.05  # no size, or before the onset
        found = jax.grad(
            lambda q, n=nothing, at=at: torque(robot, scenario.contact._replace(size=jnp.asarray(n)), at, q).sum()
        )
        assert (found(jnp.ones(3)) == 0).all()


# Beside somebody else's controller.


@pytest.mark.thorough
def test_the_diagnoser_tells_a_force_on_a_link(small):
    """Signals of an arm that moves with no controller's help: readings, and torques less those of a force or of a motor."""
    config, t = dataclasses.replace(small, dt=0.005, t_final=0.4), 0.005 * np.arange(400)[:, None]
    swing, rate = np.array([0.6, 0.5, 0.4]), np.array([1.1, 1.3, 1.7])
    q = swing * np.sin(rate * t + 0.5)
    qd, qdd = swing * rate * np.cos(rate * t + 0.5), -swing * rate**2 * np.sin(rate * t + 0.5)
    tau = np.asarray(inverse_dynamics(config.robot, q.T, qd.T, qdd.T)).T
    place = forces.Place(jnp.int32(3), jnp.asarray(1.0), jnp.zeros(3))
    push = np.broadcast_to(np.array([[0.0], [28.0], [9.0]]), (3, 400))
    pushed = np.asarray(forces.joint_torques(config.robot, jnp.asarray(q.T), place, jnp.asarray(push))).T
    after, gains = t > 1.0, jaxftc.default_gains(config)
    said = [diagnose(config, gains, Log(q=q, tau=tau - after * lost)) for lost in (pushed, np.array([0.0, 8.0, 0.0]))]
    assert not (said[0].verdict[:200] > 0).any() and (said[0].verdict[-1] == CONTACT).all()
    assert 15 < said[0].force[-1, 2] < 45 and not said[0].force[-1, :2].any()
    assert (said[1].verdict[-1] == [0, 1, 0]).all() and not (said[1].verdict & CONTACT).any()


def test_a_loop_can_stop_at_a_contact(small):
    watch = Watch(Trips(verdicts=(jaxftc.Verdict.CONTACT,)), small)
    zero = np.zeros(3)

    def confirmed(*verdict):
        return watch.verdicts(reaction.State(zero, np.array(verdict), np.array(verdict), zero, zero))

    assert confirmed(1, 2, 0) is None
    assert confirmed(CONTACT, CONTACT, 2) == Trip("verdict", f"contact on the link of {small.robot.joint_names[1]}")
