"""The arm: published numbers, MuJoCo in C, and the two engines against each other."""

import copy
import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import jaxftc
from benchmarks.arms import serial
from jaxftc.numerics.barrier import unstack
from jaxftc.robot import dynamics, mass_matrix, rigid_body
from jaxftc.robot.model_file import compile_robot
from jaxftc.robot.mujoco_model import PAYLOAD
from jaxftc.robot.puma560 import TORQUE_LIMIT
from jaxftc.scenarios.scenario import CONDITIONS
from tests.arms import three_hinges, two_hinges

ENGINES = ("mjx", "chain")
MJX_TOO = pytest.mark.parametrize("engine", [pytest.param("mjx", marks=pytest.mark.thorough), "chain"])
DT = 1e-3  # s
QN = np.array([0, np.pi / 4, np.pi, 0, np.pi / 4, 0])  # rad, the pose at which the field quotes numbers
STATES = 1000

advance = jax.jit(dynamics.advance, static_argnums=(0, 1, 6))
forward = jax.jit(jaxftc.forward_dynamics, static_argnums=0, static_argnames="engine")
inverse = jax.jit(jaxftc.inverse_dynamics, static_argnums=0)
angles = arrays(float, 6, elements=st.floats(-np.pi, np.pi))
speeds = arrays(float, 6, elements=st.floats(-5, 5))


@jax.jit
def inertia(q):
    rows = dynamics.nominal_mass(jaxftc.puma560(), rigid_body.pose(jaxftc.puma560(), q)).rows
    return jnp.stack([jnp.stack([jnp.broadcast_to(entry, q.shape[1:]) for entry in row]) for row in rows])


def random_states(count: int = STATES, n: int = 6) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles, speeds and torques [n, count], to the limits of the PUMA 560 and a little beyond."""
    draw = np.random.default_rng(560)
    limit = 1.2 * np.asarray(TORQUE_LIMIT)[:n, None]
    return tuple(draw.uniform(-size, size, (n, count)) for size in (np.pi, 6.0, limit))


def random_plants(count: int = STATES, n: int = 6) -> jaxftc.Plant:
    """A different arm for every state: far more mismatch than any preset has."""
    draw = np.random.default_rng(561)
    factor = lambda low, high: jnp.asarray(draw.uniform(low, high, (n, count)))  # noqa: E731
    return jaxftc.Plant(
        mass=factor(0.5, 2.0),
        payload=jnp.asarray(draw.uniform(0, 3, count)),
        armature=factor(0.5, 2.0),
        damping=factor(0.0, 3.0),
        coulomb=factor(0.0, 3.0),
        torque_constant=factor(1.0, 1.0),
    )


def step_in_c(robot: jaxftc.Robot, plants: jaxftc.Plant, q, qd, tau) -> tuple[np.ndarray, np.ndarray]:
    """(q, qd) [6, count] after one mj_step; the model is changed by hand, Coulomb friction is an applied torque."""
    model, data = copy.copy(robot.mj_model), mujoco.MjData(robot.mj_model)
    model.opt.timestep = DT
    before = {name: getattr(model, name).copy() for name in ("body_mass", "body_inertia", "dof_armature", "dof_damping")}
    links = [model.jnt_bodyid[j] for j in range(6)]
    friction = np.asarray(dynamics.coulomb(robot, qd))
    after = np.empty((2, *q.shape))
    for k in range(q.shape[1]):
        mass, armature, damping, coulomb = (
            np.asarray(leaf)[:, k] for leaf in (plants.mass, plants.armature, plants.damping, plants.coulomb)
        )
        model.body_mass[links] = mass * before["body_mass"][links]
        model.body_inertia[links] = mass[:, None] * before["body_inertia"][links]
        model.body_mass[model.body(PAYLOAD).id] = plants.payload[k]
        model.dof_armature[:] = armature * before["dof_armature"]
        model.dof_damping[:] = damping.reshape(6, *[1] * (model.dof_damping.ndim - 1)) * before["dof_damping"]
        mujoco.mj_setConst(model, data)
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q[:, k], qd[:, k], tau[:, k] - coulomb * friction[:, k]
        mujoco.mj_step(model, data)
        after[0, :, k], after[1, :, k] = data.qpos, data.qvel
    return after[0], after[1]


def spread(one: jaxftc.Plant, count: int = STATES) -> jaxftc.Plant:
    """The same arm for every state."""
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[..., None], (*leaf.shape, count)), one)


def test_gravity_load_of_the_literature(puma):
    torque = inverse(puma, QN, np.zeros(6), np.zeros(6))
    np.testing.assert_allclose(torque, [0, 31.6399, 6.0351, 0, 0.0283, 0], atol=5e-5)


def test_inertia_of_the_literature():
    matrix = np.asarray(inertia(QN))
    np.testing.assert_allclose(np.diag(matrix), [3.6594, 4.4137, 0.9378, 0.1925, 0.1713, 0.1941], atol=5e-5)
    np.testing.assert_allclose([matrix[0, 1], matrix[0, 2], matrix[1, 2]], [-0.4044, 0.1006, 0.3509], atol=5e-5)


@MJX_TOO
def test_acceleration_of_the_literature(puma, engine):
    """The published number has the printed sgn in its friction: a narrow tanh is the same at these speeds."""
    hard = dataclasses.replace(puma, coulomb_speed=1e-6, fingerprint="puma560 with a hard sign")
    qd, tau = np.array([0.1, 0.2, 0.8, 0.2, 0.5, 1]), np.array([1, 3.2, 1.8, 0.1, 0.7, 4.6])
    qdd = forward(hard, QN, qd, tau, engine=engine)
    np.testing.assert_allclose(qdd, [-7.4102, -9.8432, -10.9694, -4.4314, -0.9881, 21.0228], atol=5e-5)


def test_coulomb_friction_at_speed_is_that_of_the_motors_times_the_gear(puma):
    for speed, expected in ((1.0, puma.coulomb_positive), (-1.0, -puma.coulomb_negative), (0.0, np.zeros(6))):
        np.testing.assert_allclose(dynamics.coulomb(puma, np.full(6, speed)), expected, rtol=1e-12)
    assert puma.coulomb_positive[0] == pytest.approx(0.395 * 62.6111)
    assert puma.coulomb_negative[5] == pytest.approx(10.5e-3 * 76.686)


def test_torque_limits_of_the_motors(puma):
    np.testing.assert_array_equal(puma.torque_limit, TORQUE_LIMIT)


@MJX_TOO
@pytest.mark.parametrize("which", ["nominal", "perturbed"])
def test_one_step_is_that_of_mujoco_in_c(puma, engine, which):
    q, qd, tau = random_states()
    plants = random_plants() if which == "perturbed" else spread(jaxftc.nominal_plant(puma))
    expected = step_in_c(puma, plants, q, qd, tau)
    for mine, theirs in zip(advance(puma, engine, plants, q, qd, tau, DT), expected, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("engine", [pytest.param("mjx", marks=pytest.mark.slow), "chain"])
@pytest.mark.parametrize("which", ["nominal", "perturbed"])
def test_one_step_in_single_precision(puma, engine, which):
    q, qd, tau = random_states()
    plants = random_plants() if which == "perturbed" else spread(jaxftc.nominal_plant(puma))
    expected = step_in_c(puma, plants, q, qd, tau)
    # JAX cannot trace one int64 index array first with and then without 64 bits; an arm of its own keeps the two apart.
    arm = dataclasses.replace(puma, body_link=puma.body_link.astype(np.int32), fingerprint="puma560 in single precision")
    with jax.enable_x64(False):
        singles = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), (plants, q, qd, tau))
        got = advance(arm, engine, *singles, DT)
    for mine, theirs in zip(got, expected, strict=True):
        assert mine.dtype == jnp.float32
        # Relative to the size of the joint's motion: an angle of nearly 0 has no relative precision of its own.
        assert (np.abs(mine - theirs) <= 1e-5 * np.maximum(np.abs(theirs), 1.0)).all()


@given(angles)
def test_mass_matrix_is_symmetric_and_positive_definite(q):
    matrix = np.asarray(inertia(q))
    np.testing.assert_array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix).min() > 0.01  # kg m^2, less than the smallest motor's


@MJX_TOO
def test_forward_undoes_inverse(puma, engine):
    arm = puma if engine == "chain" else two_hinges()  # MJX takes long to compile the larger one
    q, qd, _ = random_states(200, arm.n)
    qdd = np.random.default_rng(0).normal(scale=20, size=q.shape)
    np.testing.assert_allclose(forward(arm, q, qd, inverse(arm, q, qd, qdd), engine=engine), qdd, rtol=1e-9, atol=1e-9)


def test_solve_is_that_of_numpy():
    draw = np.random.default_rng(1)
    for n in (1, 2, 6):
        root = draw.normal(size=(50, n, n))
        matrix, right = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(n), draw.normal(size=(50, n))
        rows = [[jnp.asarray(matrix[:, i, j]) for j in range(n)] for i in range(n)]
        got = np.stack(mass_matrix.solve(rows, list(jnp.asarray(right.T))), axis=-1)
        np.testing.assert_allclose(got, np.linalg.solve(matrix, right[..., None])[..., 0], rtol=1e-9, atol=1e-9)


def test_the_slope_of_solve_is_that_of_numpys_solution():
    """By rule, dx = M^-1 (db - dM x), in both modes; an entry that is a plain number has none."""
    draw = np.random.default_rng(2)
    root, change, right, push, pull = (draw.normal(size=(3, 3)) for _ in range(5))
    matrix, change = root @ root.T + 0.1 * np.eye(3), change + change.T
    matrix[2, 0] = matrix[0, 2] = 0.25
    change[2, 0] = change[0, 2] = 0.0

    def solution(matrix, right):
        rows = [[0.25 if {i, j} == {0, 2} else matrix[i, j] for j in range(3)] for i in range(3)]
        return jnp.stack(mass_matrix.solve(rows, list(right)))

    x = np.linalg.solve(matrix, right)
    slope = np.linalg.solve(matrix, push - change @ x)
    at, along = (jnp.asarray(matrix), jnp.asarray(right)), (jnp.asarray(change), jnp.asarray(push))
    np.testing.assert_allclose(jax.jvp(solution, at, along)[1], slope, rtol=1e-9)
    grad_matrix, grad_right = jax.vjp(solution, *at)[1](jnp.asarray(pull))
    np.testing.assert_allclose((grad_matrix * change).sum() + (grad_right * push).sum(), (pull * slope).sum(), rtol=1e-9)
    second = jax.jvp(lambda *at: jax.jvp(solution, at, along)[1], at, along)[1]
    np.testing.assert_allclose(second, np.linalg.solve(matrix, -2 * change @ slope), rtol=1e-8)


@pytest.mark.parametrize("arm", [6, 3, 2, 1])
def test_links_as_base_parameters_move_as_the_links_themselves(puma, arm):
    robot = puma if arm == 6 else compile_robot(f"arm{arm}", serial(arm))
    draw = np.random.default_rng(arm)
    q, qd, qdd = (jnp.asarray(draw.normal(size=robot.n)) for _ in range(3))
    mass, payload = jnp.asarray(draw.uniform(0.5, 2, robot.n)), jnp.asarray(1.5)
    links = [rigid_body.link_inertia(link, mass[i]) for i, link in enumerate(robot.links)]
    links[-1] = rigid_body._join(links[-1], rigid_body.link_inertia(robot.payload_link, payload))
    grouped, at = rigid_body.scaled_inertias(robot, mass, payload), rigid_body.pose(robot, q)
    assert all(isinstance(link.mass, float) and link.mass == link.moment[2] == link.tensor[1] == 0 for link in grouped)
    lanes = unstack(qd), unstack(qdd)
    forces = [np.asarray(rigid_body.newton_euler(robot, bodies, at, *lanes)) for bodies in (grouped, links)]
    np.testing.assert_allclose(*forces, rtol=1e-9, atol=1e-9)
    matrices = [np.asarray(rigid_body.mass_matrix(robot, bodies, at).rows) for bodies in (grouped, links)]
    np.testing.assert_allclose(*matrices, rtol=1e-9, atol=1e-9)


@jax.jit
def powers(q, qd, qdd):
    """(power into the links, rate of their kinetic energy) W, gravity and friction left out."""
    robot = jaxftc.puma560()
    at, links = rigid_body.pose(robot, q), rigid_body.nominal_inertias(robot)
    torque = jnp.stack(rigid_body.newton_euler(robot, links, at, unstack(qd), unstack(qdd), gravity=False))

    def energy(q, qd):
        rows = rigid_body.mass_matrix(robot, links, rigid_body.pose(robot, q)).rows
        return 0.5 * sum(row[j] * qd[i] * qd[j] for i, row in enumerate(rows) for j in range(robot.n))

    return qd @ torque, jax.jvp(energy, (q, qd), (qd, qdd))[1]


@given(angles, speeds, speeds)
def test_power_into_the_links_is_the_rate_of_their_kinetic_energy(q, qd, qdd):
    """Ties Newton-Euler to the composite inertias: dM/dt - 2C does no work."""
    power, rate = (float(p) for p in powers(q, qd, qdd))
    assert power == pytest.approx(rate, rel=1e-9, abs=1e-9)


def test_gravity_torque_is_the_slope_of_mujocos_potential_energy(puma):
    model = copy.copy(puma.mj_model)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data, step = mujoco.MjData(model), 1e-5

    def potential(q):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_energyPos(model, data)
        return data.energy[0]

    q = random_states(20)[0]
    torque = inverse(puma, q, np.zeros_like(q), np.zeros_like(q))
    for k in range(20):
        slope = [(potential(q[:, k] + h) - potential(q[:, k] - h)) / (2 * step) for h in step * np.eye(6)]
        np.testing.assert_allclose(torque[:, k], slope, atol=1e-6)


def test_nothing_moves_without_a_torque_where_there_is_no_gravity(puma):
    """Degenerate case: at rest and weightless, the acceleration is M^-1 tau."""
    weightless = dataclasses.replace(puma, gravity=np.zeros(3), fingerprint="puma560 in space")
    assert not np.any(inverse(weightless, QN, np.zeros(6), np.zeros(6)))
    tau = np.arange(6.0)
    expected = np.linalg.solve(np.asarray(inertia(QN)), tau)
    np.testing.assert_allclose(forward(weightless, QN, np.zeros(6), tau, engine="chain"), expected, rtol=1e-9)


@MJX_TOO
def test_trailing_axes_are_a_loop_over_scenarios(engine):
    arm = two_hinges()
    q, qd, tau = (x.reshape(arm.n, 4, 2) for x in random_states(8, arm.n))
    plants = jax.tree.map(lambda leaf: leaf.reshape(*leaf.shape[:-1], 4, 2), random_plants(8, arm.n))
    together = forward(arm, q, qd, tau, engine=engine, plant=plants)
    for k in np.ndindex(4, 2):
        own = jax.tree.map(lambda leaf, k=k: leaf[..., *k], plants)
        alone = forward(arm, q[:, *k], qd[:, *k], tau[:, *k], engine=engine, plant=own)
        np.testing.assert_allclose(together[:, *k], alone, rtol=1e-10, atol=1e-10)


def test_one_plant_serves_all_scenarios(puma):
    q, qd, tau = random_states(4)
    expected = forward(puma, q, qd, tau, engine="chain", plant=spread(jaxftc.nominal_plant(puma), 4))
    np.testing.assert_allclose(forward(puma, q, qd, tau, engine="chain"), expected, rtol=1e-12)


def small_and_large(large: jaxftc.Robot):
    return pytest.mark.parametrize("arm", [two_hinges(), pytest.param(large, marks=pytest.mark.slow)], ids=["2", "6"])


@pytest.mark.slow
@small_and_large(jaxftc.puma560())
def test_both_engines_have_the_same_gradient_in_every_property_of_the_plant(arm):
    q, qd, tau = random_states(8, arm.n)
    weight = np.random.default_rng(2).normal(size=(2, arm.n, 8))

    def cost(engine, plants, q, qd, tau):
        after = dynamics.advance(arm, engine, plants, q, qd, plants.torque_constant * tau, 0.01)
        return sum((w * x).sum() for w, x in zip(weight, after, strict=True))

    slopes = jax.jit(jax.grad(cost, argnums=(1, 2, 3, 4)), static_argnums=0)
    by_chain, by_mjx = (slopes(engine, random_plants(8, arm.n), q, qd, tau) for engine in ("chain", "mjx"))
    for name, mine, theirs in zip(
        (*jaxftc.Plant._fields, "q", "qd", "tau"), jax.tree.leaves(by_chain), jax.tree.leaves(by_mjx), strict=True
    ):
        assert np.isfinite(mine).all() and np.all(np.abs(mine).max() > 0), name
        np.testing.assert_allclose(mine, theirs, rtol=1e-8, atol=1e-9, err_msg=name)


@pytest.mark.thorough
@small_and_large(jaxftc.puma560(coulomb=False))
def test_the_closed_loop_does_not_depend_on_the_engine(arm):
    """1 s of the paper's four conditions: the same angles to 1e-6 rad, and the same diagnosis."""
    traces = {}
    for engine in ENGINES:
        config = jaxftc.Config(arm, engine=engine)
        four = jaxftc.sample_scenarios(jax.random.key(0), len(CONDITIONS), "paper", config=config)
        traces[engine] = jaxftc.simulate(config, jaxftc.default_gains(config), four, jax.random.key(1))
    mjx, own = traces["mjx"], traces["chain"]
    assert np.isfinite(mjx.q).all() and np.ptp(mjx.q, axis=1).min() > 0.5
    for name in ("q", "y", "fault_q"):
        np.testing.assert_allclose(getattr(mjx, name), getattr(own, name), rtol=0, atol=1e-6, err_msg=name)
    np.testing.assert_allclose(mjx.out.tau, own.out.tau, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(mjx.out.verdict, own.out.verdict)


@pytest.mark.parametrize("arm", [jaxftc.puma560, three_hinges])
def test_the_plant_model_moves_as_the_arm(arm):
    robot = arm()
    model = robot.plant_model(DT)
    data, draw = mujoco.MjData(model), np.random.default_rng(3)
    for _ in range(20):
        q, tau = (
            draw.uniform(-2, 2, robot.n),
            1.5 * draw.uniform(-1, 1, robot.n) * robot.torque_limit,
        )  # also beyond the limits
        qd = draw.choice([-1, 1], robot.n) * draw.uniform(0.5, 2, robot.n)  # friction is all there, in both directions
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[: robot.n] = q, qd, tau
        mujoco.mj_step(model, data)
        within = np.clip(tau, -robot.torque_limit, robot.torque_limit)
        expected = dynamics.advance(robot, "chain", jaxftc.nominal_plant(robot), q, qd, within, DT)
        np.testing.assert_allclose(data.qpos, expected[0], atol=1e-9)
        np.testing.assert_allclose(data.qvel, expected[1], atol=1e-6)
