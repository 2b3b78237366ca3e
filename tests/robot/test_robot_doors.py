"""Doors: arms read from files, and what a user is told when something is not allowed."""

import copy
import dataclasses
import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import chex
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import tomli_w

import jaxftc
from jaxftc.robot import dynamics
from jaxftc.robot.model_file import compile_robot
from jaxftc.robot.mujoco_model import PAYLOAD
from jaxftc.scenarios.scenario import stack, trail

# Arbitrary axes, an anchor off its body's origin, a turned base that is welded to the world, gravity that is not along z,
# an angle at which the arm is drawn, a body welded to a link, principal axes that are not the link's.
TWO_LINKS = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="1 -2 -9"/>
  <worldbody>
    <body name="base" pos="0.3 -0.2 0.5" quat="0.8 0.1 -0.5 0.3">
      <geom type="box" size="0.2 0.2 0.1" mass="3"/>
      <body name="upper" pos="0.1 0 0.2" quat="0.9 0.3 0.1 0">
        <joint name="shoulder" axis="1 2 -0.5" pos="0.05 -0.02 0.03" ref="0.4" damping="0.3" armature="0.02"
               frictionloss="0.5" range="-1 1" actuatorfrcrange="-12 9"/>
        <inertial pos="0.1 0.2 -0.05" mass="2" fullinertia="0.05 0.06 0.07 0.01 -0.005 0.008"/>
        <body name="lamp" pos="0 0.3 0.1" euler="0.4 0.2 0.1">
          <geom type="capsule" size="0.03 0.1" mass="0.4"/>
        </body>
        <body name="lower" pos="0 0.5 0" quat="0.7 -0.2 0.4 0.5">
          <joint name="elbow" axis="0 -3 4" pos="-0.01 0.02 0" ref="-0.7" damping="0.1" frictionloss="0.2"/>
          <geom type="ellipsoid" size="0.05 0.1 0.2" pos="0.1 0.1 0.2" euler="0.3 -0.6 0.9" mass="1.2"/>
          <site name="tool" pos="0.05 0.1 0.4"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="elbow" gear="20" ctrllimited="true" ctrlrange="-0.2 0.25"/>
  </actuator>
</mujoco>
"""

# Seven hinges on five bodies: two pairs share a body, and every axis and anchor is its own.
SEVEN_HINGES = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body pos="0 0 0.4">
      <joint name="j1" axis="0 0 1"/><joint name="j2" axis="0 1 0.2" pos="0.02 0 0.1" ref="0.3"/>
      <geom type="capsule" size="0.05" fromto="0 0 0 0.1 0 0.3" mass="4"/>
      <body pos="0.1 0 0.3" quat="0.5 0.5 -0.5 0.5">
        <joint name="j3" axis="0 0 -1" damping="0.4"/>
        <geom type="box" size="0.1 0.05 0.2" pos="0 0.1 0.1" mass="3"/>
        <body pos="0.05 0.3 0">
          <joint name="j4" axis="1 1 1" armature="0.05"/>
          <geom type="cylinder" size="0.04 0.1" pos="0.1 0 0" mass="2"/>
          <body pos="0.2 0.1 0" euler="0.1 0.2 0.3">
            <joint name="j5" axis="1 0 0" ref="-0.2"/><joint name="j6" axis="0 -1 0" pos="0.03 0 0"/>
            <geom type="box" size="0.03 0.04 0.1" pos="0 0 0.1" mass="1"/>
            <body pos="0 0 0.2">
              <joint name="j7" axis="0 0 1" pos="0 0.01 0"/>
              <geom type="sphere" size="0.05" pos="0.02 0 0.05" mass="0.5"/>
              <body pos="0 0 0.1" euler="1 0 0"><geom type="box" size="0.02 0.03 0.04" mass="0.3"/></body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

URDF = """
<robot name="lamp">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.2 0 0.1" rpy="0.3 0 0"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0" iyz="0.002"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="hand"><inertial><origin xyz="0.1 0 0"/><mass value="0.5"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3" rpy="0.1 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="50" velocity="2"/><dynamics damping="0.7" friction="0.3"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="0.4 0 0" rpy="0 0 0.3"/>
    <axis xyz="0 0.6 0.8"/></joint>
  <joint name="weld" type="fixed"><parent link="lower"/><child link="hand"/><origin xyz="0.2 0 0"/></joint>
</robot>
"""

ONE_HINGE = """
<mujoco><worldbody><body name="link"><joint name="hinge" axis="0 0 1"/>
  <geom type="box" size="0.1 0.2 0.3" pos="0.2 0 0" mass="1"/></body></worldbody></mujoco>
"""

ARMS = {"two links": ("arm.xml", TWO_LINKS), "seven hinges": ("arm.xml", SEVEN_HINGES), "urdf": ("arm.urdf", URDF)}
ARMS["one hinge"] = ("arm.xml", ONE_HINGE)

accelerations = jax.jit(dynamics.acceleration, static_argnums=(0, 1))


def load(folder: Path, text: str, name: str = "arm.xml") -> jaxftc.Robot:
    (folder / name).write_text(text)
    return jaxftc.load_robot(folder / name)


def refuses(*parts: str):
    """ValueError whose text holds these parts in this order."""
    return pytest.raises(ValueError, match="(?s)" + ".*".join(map(re.escape, parts)))


def acceleration_in_c(robot: jaxftc.Robot, payload: float, q, qd, tau) -> np.ndarray:
    model = copy.copy(robot.mj_model)
    model.body_mass[model.body(PAYLOAD).id] = payload
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    friction = np.asarray(dynamics.coulomb(robot, qd))
    qdd = np.empty_like(q)
    for k in range(q.shape[1]):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q[:, k], qd[:, k], tau[:, k] - friction[:, k]
        mujoco.mj_forward(model, data)
        qdd[:, k] = data.qacc
    return qdd


def arms_and_engines() -> list:
    """MJX takes long to compile."""
    pairs = [(arm, engine) for arm in ARMS for engine in ("chain", "mjx")]
    longer = {("seven hinges", "mjx"): [pytest.mark.slow]} | {
        (arm, "mjx"): [pytest.mark.thorough] for arm in ("two links", "one hinge")
    }
    return [pytest.param(*pair, marks=longer.get(pair, [])) for pair in pairs]


@pytest.mark.parametrize(("arm", "engine"), arms_and_engines())
def test_any_serial_arm_moves_as_in_mujoco(tmp_path, arm, engine):
    name, text = ARMS[arm]
    robot = load(tmp_path, text, name)
    draw = np.random.default_rng(robot.n)  # 64 states: shorter loops are unrolled, and take twice as long to compile
    q, qd, tau = (draw.uniform(-size, size, (robot.n, 64)) for size in (np.pi, 3.0, 10.0))
    loaded = jaxftc.nominal_plant(robot)._replace(payload=jnp.asarray(1.5))
    expected = acceleration_in_c(robot, 1.5, q, qd, tau)
    np.testing.assert_allclose(accelerations(robot, engine, loaded, q, qd, tau), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("arm", ARMS)
def test_inverse_dynamics_of_any_serial_arm(tmp_path, arm):
    name, text = ARMS[arm]
    robot = load(tmp_path, text, name)
    q, qd, qdd = np.random.default_rng(robot.n).uniform(-2, 2, (3, robot.n, 5))
    tau = jaxftc.inverse_dynamics(robot, q, qd, qdd)
    got = accelerations(robot, "chain", jaxftc.nominal_plant(robot), q, qd, tau)
    np.testing.assert_allclose(got, qdd, rtol=1e-9, atol=1e-9)


def test_what_a_model_says_about_its_joints(tmp_path):
    robot = load(tmp_path, TWO_LINKS, "desk-lamp.xml")
    assert (robot.name, robot.n, robot.joint_names) == ("desk-lamp", 2, ("shoulder", "elbow"))
    np.testing.assert_allclose(robot.q_zero, [0.4, -0.7])
    np.testing.assert_allclose(robot.gravity, [1, -2, -9])
    np.testing.assert_allclose(robot.armature, [0.02, 0])
    np.testing.assert_allclose(robot.damping, [0.3, 0.1])
    # Dry friction is a smooth torque, no constraint; the model's own motors and joint ranges limit the torque.
    # Of an asymmetric range the smaller side counts.
    np.testing.assert_allclose(robot.coulomb_positive, [0.5, 0.2])
    np.testing.assert_allclose(robot.coulomb_negative, [0.5, 0.2])
    np.testing.assert_allclose(robot.torque_limit, [9, 4])


def test_direction_dependent_friction_stands_in_the_joints_user_data(tmp_path):
    text = ONE_HINGE.replace('axis="0 0 1"', 'axis="0 0 1" user="0.4 0.7" frictionloss="9"')
    robot = load(tmp_path, text.replace("<mujoco>", '<mujoco><size nuser_jnt="2"/>'))
    assert (robot.coulomb_positive, robot.coulomb_negative) == (0.4, 0.7)


def test_what_a_urdf_says_about_its_joints(tmp_path):
    robot = load(tmp_path, URDF, "lamp.urdf")
    assert (robot.name, robot.n, robot.joint_names) == ("lamp", 2, ("shoulder", "elbow"))
    np.testing.assert_allclose(robot.torque_limit, [50, np.inf])
    np.testing.assert_allclose(robot.damping, [0.7, 0])
    np.testing.assert_allclose(robot.coulomb_positive, [0.3, 0])


@pytest.mark.slow
def test_a_loaded_arm_runs_the_whole_loop(tmp_path):
    """Seven joints without torque limits: nothing in the controller is made for six.

    As a batch of one scenario, which compiles in half the time of a single arm.
    """
    config = jaxftc.Config(load(tmp_path, SEVEN_HINGES), engine="chain", duration=0.05)
    healthy = jaxftc.paper_scenario("healthy", config)._replace(noise=jnp.zeros(()))
    trace = jaxftc.simulate(config, jaxftc.default_gains(config), stack([healthy]), jax.random.key(0))
    chex.assert_shape(trace.q, (1, 50, 7))
    assert np.abs(trace.q - trace.q_ref).max() < 1e-3
    assert not trace.out.detected.any()


def test_robots_are_compared_by_what_they_were_compiled_from(tmp_path):
    one, same = load(tmp_path, TWO_LINKS), load(tmp_path, TWO_LINKS)
    heavier = load(tmp_path, TWO_LINKS.replace('mass="1.2"', 'mass="1.3"'))
    assert one == same and hash(one) == hash(same) and one is not same
    assert one != heavier and one != "arm" and len({one, same, heavier}) == 2
    assert jaxftc.puma560() is jaxftc.puma560()
    assert jaxftc.puma560() != jaxftc.puma560(coulomb=False)


def test_configs_are_compared_by_value():
    one, same = (jaxftc.Config(jaxftc.puma560(), engine="chain") for _ in range(2))
    assert one == same and hash(one) == hash(same)
    assert one != dataclasses.replace(one, observer="pi")


# Refusals: robots.


def test_a_missing_robot_file_is_refused(tmp_path):
    for path in (tmp_path / "none.xml", tmp_path):
        with refuses(f"no robot file at {path}", "give an MJCF or URDF file,", "or 'puma560' for the built-in arm"):
            jaxftc.load_robot(path)


def test_dynamics_refuse_wrong_shapes_and_engines(puma):
    six, five = np.zeros(6), np.zeros(5)
    with refuses("tau must have the 6 joints on its first axis ([6] or [6, scenarios]), got shape (5,)"):
        jaxftc.forward_dynamics(puma, six, six, five)
    with refuses("qdd must have the 6 joints on its first axis", "got shape ()"):
        jaxftc.inverse_dynamics(puma, six, six, 0.0)
    with refuses("engine must be one of 'mjx', 'chain', got 'chains'; did you mean 'chain'?"):
        jaxftc.forward_dynamics(puma, six, six, six, engine="chains")


# Refusals: configs.


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"robot": "puma560"}, "robot must be a Robot, got str; call puma560() or load_robot(path)"),
        ({"engine": "mujoco"}, "engine must be one of 'mjx', 'chain', got 'mujoco'"),
        ({"observer": "ESO"}, "observer must be one of 'pi', 'eso', 'ts', 'eso_printed', got 'ESO'"),
        (
            {"scheme": "kalman"},
            "'ekf', 'computed_torque', or module:object, got 'kalman'",
        ),
        ({"control": "afsmc"}, "control must be one of 'smc', 'esmc', 'afesmc', got 'afsmc'; did you mean 'afesmc'?"),
        ({"input": "torques"}, "input must be one of 'rigid_body', 'torque', got 'torques'; did you mean 'torque'?"),
        ({"rules": "mended"}, "rules must be one of 'printed', 'symmetric', 's_only', got 'mended'"),
        ({"sign": "soft"}, "sign must be one of 'smooth', 'hard', got 'soft'"),
        ({"dt": -1e-3}, "dt must be a positive, finite number of seconds, got -0.001"),
        ({"dt": 0.0}, "dt must be a positive, finite number of seconds, got 0.0"),
        ({"dt": float("nan")}, "dt must be a positive, finite number of seconds, got nan"),
        ({"dt": "1e-3"}, "dt must be a positive, finite number of seconds, got '1e-3'"),
        ({"t_final": float("inf")}, "t_final must be a positive, finite number of seconds, got inf"),
        ({"t_final": 0.0015}, "t_final must be a multiple of dt = 0.001 s, got 0.0015 s; the nearest is 0.002 s"),
        ({"duration": -1.0}, "duration must be a positive, finite number of seconds, got -1.0"),
        ({"duration": 0.1234}, "duration must be a multiple of dt = 0.001 s, got 0.1234 s; the nearest is 0.123 s"),
        ({"order_a": 1}, "order_a must be an integer of at least 2, got 1; a joint is a double integrator; 3 suits it"),
        ({"order_b": 1}, "order_b must be an integer of at least 2, got 1; a joint is a double integrator; 2 suits it"),
        ({"order_b": 2.0}, "order_b must be an integer of at least 2, got 2.0"),
        ({"order_b": True}, "order_b must be an integer of at least 2, got True"),
        ({"alarm_ticks": 0}, "alarm_ticks must be an integer of at least 1, got 0; 1 alarms at once"),
        ({"release_ticks": 0}, "release_ticks must be an integer of at least 1, got 0; 1 releases at once"),
        (
            {"transient_ticks": -1},
            "transient_ticks must be an integer of at least 0, got -1; 0 switches the sensor check off",
        ),
    ],
    ids=str,
)
def test_configs_are_refused(puma, change, text):
    with refuses(text):
        jaxftc.Config(**{"robot": puma} | change)


# Refusals: gains.


def with_gain(gains: jaxftc.Gains, path: str, value) -> jaxftc.Gains:
    """Gains with one of any shape, which ``Gains.replace`` would refuse."""
    block, name = path.split(".")
    return dataclasses.replace(gains, **{block: dataclasses.replace(getattr(gains, block), **{name: jnp.asarray(value)})})


@pytest.mark.parametrize(
    ("path", "value", "text"),
    [
        ("control.lam", [20.0] * 5, "control.lam must have shape [6], got [5]; n is 6 joints"),
        ("control.lam", 20.0, "control.lam must have shape [6], got []; n is 6 joints"),
        ("arx.kappa_a", np.zeros((6, 2)), "arx.kappa_a must have shape [6, 3], got [6, 2]; n is 6 joints"),
        ("control.lam", [[20.0] * 6] * 3, "control.lam must have shape [6], got [3, 6]; n is 6 joints"),
        ("control.lam", [np.nan] * 6, "control.lam must be finite, got [nan, nan, nan, nan, nan, nan]"),
        ("observer.alpha_i", [np.inf] * 6, "observer.alpha_i must be finite, got [inf,"),
        ("arx.xi_a", [1.0] * 6, "arx.xi_a must lie in (-1, 1)"),
        ("arx.xi_b", [-1.0] * 6, "arx.xi_b must lie in (-1, 1)"),
        ("control.q_widths", [-0.1] * 7, "control.q_widths must lie in (0,"),
        ("observer.tau_widths", [0.0, 0.1], "observer.tau_widths must lie in (0,"),
        ("observer.alpha_p", [1.01] * 6, "observer.alpha_p must lie in (0, 1]"),
        ("observer.alpha_i", [-1.0] * 6, "observer.alpha_i must lie in [0,"),
        ("control.outputs", [0.5, 1.0, 3.5], "control.outputs must lie in [0, 3]"),
        ("baseline.rate", [0.0] * 6, "baseline.rate must lie in (0, inf) 1/s, got [0.0, "),
        ("baseline.kp", [-1.0] * 6, "baseline.kp must lie in [0, inf) 1/s^2, got [-1.0, "),
        ("control.q_centres", [0.0] * 7, "control.q_centres must increase from set to set"),
        ("observer.jump_centres", [1.0, 0.0], "observer.jump_centres must increase from set to set, got [1.0, 0.0]"),
    ],
)
def test_gains_are_refused_by_every_door(config, path, value, text):
    gains = with_gain(jaxftc.default_gains(config), path, value)
    for call in (
        lambda: jaxftc.init(config, gains, np.zeros(6)),
        lambda: jaxftc.simulate(config, gains, jaxftc.paper_scenario("healthy", config), jax.random.key(0)),
    ):
        with refuses(text):
            call()


def test_poles_at_one_would_divide_by_zero_in_the_bank_at_rest(config):
    """The limit that the check guards: at a pole of 1 the settled bank is infinite."""
    gains = jaxftc.default_gains(config).replace({"arx.xi_a": 0.999999})
    assert np.isfinite(jaxftc.init(config, gains, np.ones(6)).observer.arx.x_a).all()


# Refusals: the tick and the closed loop.


@pytest.mark.parametrize(
    ("q", "text"),
    [
        (np.zeros(5), "q must have the 6 joints on its first axis ([6] or [6, scenarios]), got shape (5,)"),
        (np.zeros((4, 6)), "q must have the 6 joints on its first axis ([6] or [6, scenarios]), got shape (4, 6)"),
        (0.0, "q must have the 6 joints on its first axis ([6] or [6, scenarios]), got shape ()"),
        ([0.0, np.nan, 0, 0, 0, 0], "q must be finite, got [0.0, nan, 0.0, 0.0, 0.0, 0.0]; give the arm's measured angles"),
    ],
)
def test_init_refuses(config, q, text):
    with refuses(text):
        jaxftc.init(config, jaxftc.default_gains(config), q)


@pytest.mark.parametrize("signal", ["measurement.q", "measurement.tau", "reference.q", "reference.qd", "reference.qdd"])
@pytest.mark.parametrize("shape", [(5,), (), (6, 3)])
def test_step_refuses_wrong_shapes_also_under_jit(config, signal, shape):
    gains, six = jaxftc.default_gains(config), jnp.zeros(6)
    state = jaxftc.init(config, gains, six)
    signals = {"reference": jaxftc.Reference(six, six, six), "measurement": jaxftc.Measurement(six, six)}
    kind, field = signal.split(".")
    signals[kind] = signals[kind]._replace(**{field: jnp.zeros(shape)})
    for tick in (jaxftc.step, jax.jit(jaxftc.step, static_argnums=0)):
        if shape == (6, 3):
            text = f"{signal} must have the shape of state.q, [6], got [6, 3]; give every signal the same scenario axes"
        else:
            text = f"{signal} must have the 6 joints on its first axis ([6] or [6, scenarios]), got shape {shape}"
        with refuses(text):
            tick(config, gains, state, signals["reference"], signals["measurement"])


def edited(scenario: jaxftc.Scenario, path: str, value) -> jaxftc.Scenario:
    first, *rest = path.split(".")
    return scenario._replace(**{first: edited(getattr(scenario, first), ".".join(rest), value) if rest else value})


@pytest.mark.parametrize(
    ("path", "value", "text"),
    [
        ("q_start", np.full(6, np.nan), "scenario.q_start must be finite, got [nan,"),
        ("q_goal", np.full(6, np.inf), "scenario.q_goal must be finite, got [inf,"),
        ("q_goal", np.zeros(5), "scenario.q_goal must have shape [6]"),
        ("fault_tau.kind", np.zeros(5, int), "scenario.fault_tau.kind must have shape [6]"),
        ("fault_tau.kind", np.full(6, 99), "scenario.fault_tau.kind must be an Actuator or a Sensor, got [99,"),
        ("fault_q.magnitude", np.full(6, np.nan), "scenario.fault_q.magnitude must be finite, got [nan,"),
        ("fault_q.onset", np.full(6, np.nan), "scenario.fault_q.onset must be finite, got [nan,"),
        ("fault_q.clear", np.full(6, np.nan), "scenario.fault_q.clear must be a number, infinite if the fault stays"),
        (
            "fault_q.period",
            np.zeros(6),
            "scenario.fault_q.period must be positive, infinite if the fault is not intermittent",
        ),
        ("fault_q.duty", np.full(6, 1.5), "scenario.fault_q.duty must lie in [0, 1], got [1.5,"),
        ("noise", -1e-5, "scenario.noise must be finite and not negative, got -1e-05"),
        ("plant.payload", np.nan, "scenario.plant.payload must be finite and not negative, got nan"),
        ("plant.mass", np.zeros(6), "scenario.plant.mass must be positive and finite, got [0.0,"),
        ("plant.damping", np.full(6, np.nan), "scenario.plant.damping must be finite, got [nan,"),
    ],
)
def test_simulate_refuses(config, path, value, text):
    scenario = edited(jaxftc.paper_scenario("both", config), path, jnp.asarray(value))
    with refuses(text):
        jaxftc.simulate(config, jaxftc.default_gains(config), scenario, jax.random.key(0))


def test_simulate_refuses_scenarios_on_a_trailing_axis(config):
    sampled = trail(jaxftc.sample_scenarios(jax.random.key(0), 4, "paper", config=config))
    with refuses("scenario.q_start must have shape [4, 6], got [6, 4]; ids are [4]"):
        jaxftc.simulate(config, jaxftc.default_gains(config), sampled, jax.random.key(0))


def test_scenarios_are_refused(config):
    with refuses("condition must be one of 'healthy', 'actuator', 'sensor', 'both', got 'sensors'; did you mean 'sensor'?"):
        jaxftc.paper_scenario("sensors", config)
    with refuses("preset must be one of", "got 'papr'; did you mean 'paper'?"):
        jaxftc.sample_scenarios(jax.random.key(0), 4, preset="papr", config=config)
    with refuses("n must be an integer of at least 1, got 0; it is the number of scenarios"):
        jaxftc.sample_scenarios(jax.random.key(0), 0, config=config)


# Gains files.


@pytest.fixture(scope="module")
def config(puma_config) -> jaxftc.Config:
    return puma_config


@pytest.fixture
def gains_file(config, tmp_path) -> Path:
    path = tmp_path / "gains.toml"
    jaxftc.save_gains(path, jaxftc.default_gains(config), config)
    return path


def test_gains_survive_a_file_bit_for_bit(config, tmp_path):
    draw = np.random.default_rng(0)
    gains = jax.tree.map(lambda x: x * (1 + 1e-3 * draw.uniform(size=x.shape)), jaxftc.default_gains(config))
    weights = ("observer.alpha_p", "observer.alpha_f2", "diagnosis.lam_q")
    gains = gains.replace({"arx.xi_a": draw.uniform(0.5, 0.9, 6)} | {name: draw.uniform(0.1, 1.0, 6) for name in weights})
    jaxftc.save_gains(tmp_path / "gains.toml", gains, config)
    read = jaxftc.load_gains(str(tmp_path / "gains.toml"), config)
    chex.assert_trees_all_equal(read, gains)
    assert [path.name for path in tmp_path.iterdir()] == ["gains.toml"], "nothing is left beside the file"


def test_gains_of_scenarios_are_not_written(config, tmp_path):
    gains = jax.tree.map(lambda x: jnp.broadcast_to(x[..., None], (*x.shape, 3)), jaxftc.default_gains(config))
    with refuses("arx.xi_a must be one set of gains, ['n'], got shape [6, 3]"):
        jaxftc.save_gains(tmp_path / "gains.toml", gains)


def test_gains_file_says_units_robot_and_version(config, gains_file):
    table = tomllib.loads(gains_file.read_text())
    robot = config.robot
    system = {"robot": robot.name, "robot_fingerprint": robot.fingerprint, "dt": 1e-3, "order_a": 3, "order_b": 2}
    scheme = {"scheme": "cascade", "observer": "ts", "adaptive": False}
    assert table["made_with"] == {"jaxftc": jaxftc.__version__, "input": "rigid_body"} | system | scheme
    assert table["control"]["lam"] == {"unit": "1/s", "value": [20.0] * 6}


def rename(table: dict) -> None:
    table["observer"]["alpha_pp"] = table["observer"].pop("alpha_p")


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (rename, ["gains.toml: unknown gain 'observer.alpha_pp'; did you mean 'observer.alpha_p'?"]),
        (lambda t: t.update(contrl=t.pop("control")), ["unknown gain 'contrl.lam'; did you mean 'control.lam'?"]),
        (lambda t: t["observer"].pop("alpha_p"), ["gains.toml lacks observer.alpha_p; write it with save_gains"]),
        (lambda t: t.pop("arx"), ["gains.toml lacks arx.xi_a, arx.xi_b, arx.kappa_a, arx.kappa_b, arx.offset;"]),
        (
            lambda t: t["diagnosis"]["alpha_q"].update(unit="deg"),
            ["gains.toml: diagnosis.alpha_q must be a table of unit = 'rad' and value, got {'unit': 'deg'"],
        ),
        (
            lambda t: t["control"].update(lam=[20.0] * 6),
            ["control.lam must be a table of unit = '1/s' and value, got [20.0"],
        ),
        (lambda t: t["control"]["lam"].update(value="fast"), ["gains.toml: control.lam must hold numbers, got 'fast'"]),
        (lambda t: t["control"]["lam"].update(value=[float("nan")] * 6), ["control.lam must be finite, got [nan,"]),
        (lambda t: t["control"]["lam"].update(value=[20.0] * 5), ["control.lam must have shape [6], got [5]"]),
        (lambda t: t["control"]["lam"].update(value=[-20.0] * 6), ["control.lam must lie in (0,"]),
    ],
)
def test_wrong_gains_files_are_refused(config, gains_file, change: Callable[[dict], object], parts):
    table = tomllib.loads(gains_file.read_text())
    change(table)
    gains_file.write_text(tomli_w.dumps(table))
    with refuses(*parts):
        jaxftc.load_gains(gains_file, config)


def test_unreadable_gains_files_are_refused(config, tmp_path):
    path = tmp_path / "gains.toml"
    for content in (None, b"lam = ]", b"\xff\xfe\x00"):
        if content is not None:
            path.write_bytes(content)
        with refuses(f"cannot read gains from {path}: "):
            jaxftc.load_gains(path, config)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"dt": 2e-3}, "holds gains for another dt 0.001, here 0.002; use the config they were made with"),
        ({"order_a": 4}, "holds gains for another order_a 3, here 4; use the config they were made with"),
        ({"order_b": 3}, "holds gains for another order_b 2, here 3; use the config they were made with"),
        ({"input": "torque"}, "holds gains for another input 'rigid_body', here 'torque'; use the config"),
        ({"robot": jaxftc.puma560}, "holds gains for another robot 'puma560 without Coulomb friction', here 'puma560';"),
    ],
    ids=["dt", "order_a", "order_b", "input", "robot"],
)
def test_gains_of_another_system_are_refused(config, gains_file, change, text):
    other = dataclasses.replace(config, **{key: value() if callable(value) else value for key, value in change.items()})
    with refuses(text):
        jaxftc.load_gains(gains_file, other)


def test_gains_serve_every_observer_control_and_engine(config, gains_file):
    other = dataclasses.replace(config, observer="pi", control="smc", engine="mjx", sign="hard", t_final=2.0)
    assert jaxftc.load_gains(gains_file, other).control.lam.shape == (6,)


def test_thresholds_of_another_scheme_are_doubted(config, gains_file, tmp_path, capsys):
    from jaxftc.cli import common
    from jaxftc.gains_file import load_and_doubt

    def caution(*asked):
        return load_and_doubt(*asked)[1]

    other = dataclasses.replace(config, adaptive=True)
    assert caution(gains_file, config) is None
    assert "was made with scheme cascade, observer ts, adaptive False; here scheme cascade, observer ts, adaptive True" in (
        caution(gains_file, other)
    )
    for anew, said in ((True, ""), (False, f"{caution(gains_file, other)}\n")):
        common.load_or_default(common.Options(gains=gains_file), other, anew=anew)
        assert capsys.readouterr().err == said
    assert caution(gains_file, dataclasses.replace(config, scheme="computed_torque")) is None, "it judges nothing"
    assert "made with scheme cascade; here scheme diagnoser" in caution(gains_file, config, "diagnoser")
    logs = tmp_path / "logs.toml"
    jaxftc.save_gains(logs, jaxftc.default_gains(config), config, scheme="diagnoser")
    assert caution(logs, config, "diagnoser") is None and "made with scheme diagnoser, " in caution(logs, config)
    jaxftc.save_gains(tmp_path / "gains.toml", jaxftc.default_gains(config))
    assert caution(tmp_path / "gains.toml", other) is None, "the file does not say"


def test_gains_without_a_fingerprint_fit_any_system_of_their_shapes(config, tmp_path):
    jaxftc.save_gains(tmp_path / "gains.toml", jaxftc.default_gains(config))
    other = dataclasses.replace(config, robot=jaxftc.puma560())
    assert jaxftc.load_gains(tmp_path / "gains.toml", other).control.lam.shape == (6,)


def small_arm(on_first="", on_last="", option=""):
    inertial = '<inertial pos="0 0 .1" mass="1" diaginertia=".1 .1 .1"/>'
    return (
        f'<mujoco>{option}<worldbody><body><joint axis="0 0 1"/>{inertial}{on_first}'
        f'<body pos="0 0 .3"><joint axis="0 0 1"/>{inertial}{on_last}</body></body></worldbody></mujoco>'
    )


def test_a_tool_in_a_frame_is_where_it_is_drawn():
    arm = compile_robot("framed", small_arm(on_last='<frame pos="1 0 0"><site name="tool" pos=".1 0 0"/></frame>'))
    np.testing.assert_allclose(np.linalg.norm(arm.payload_link.moment), 1.1)


def test_a_tool_on_an_earlier_link_and_a_fluid_are_refused():
    with pytest.raises(ValueError, match=r"odd: .*'tool'.*last link"):
        compile_robot("odd", small_arm(on_first='<site name="tool"/>'))
    with pytest.raises(ValueError, match=r"wet: .*density.*not modelled"):
        compile_robot("wet", small_arm(option='<option density="1.2"/>'))


def test_the_plant_model_has_motors_in_place_of_servos_and_nothing_but_the_arm(tmp_path):
    servo = '<actuator><position joint="elbow" kp="500" forcerange="-4 5"/></actuator><keyframe><key ctrl="0.3"/></keyframe>'
    text = TWO_LINKS.replace("</mujoco>", "").replace(
        TWO_LINKS[TWO_LINKS.index("<actuator>") : TWO_LINKS.index("</mujoco>")], ""
    )
    robot = load(tmp_path, text + servo + "</mujoco>")
    model, data = robot.plant_model(2e-3), mujoco.MjData(robot.plant_model(2e-3))
    assert (model.opt.timestep, model.ngeom, model.nu) == (2e-3, 0, 4)  # two motors, and the friction of both
    np.testing.assert_array_equal(robot.torque_limit, [9, 4])
    data.qpos[:] = [0.5, -0.9]
    mujoco.mj_forward(model, data)
    assert not data.qfrc_actuator.any()  # the servo would pull the elbow to zero
    data.ctrl[:2] = [100.0, -100.0]
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_actuator, [9, -4])
    data.ctrl[:2], data.qvel[:] = 0.0, [1.0, -1.0]
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_actuator, [-0.5, 0.2])  # dry friction
    q, qd, tau = (np.array(x)[:, None] for x in ([0.5, -0.9], [0.3, 0.4], [1.0, 2.0]))
    data.qvel[:], data.ctrl[:2] = qd[:, 0], tau[:, 0]
    mujoco.mj_forward(model, data)
    expected = accelerations(robot, "chain", jaxftc.nominal_plant(robot), np.tile(q, 64), np.tile(qd, 64), np.tile(tau, 64))
    np.testing.assert_allclose(data.qacc, expected[:, 0], rtol=1e-3)
    with refuses("dt must be a positive, finite number of seconds, got 0"):
        robot.plant_model(0.0)


@pytest.mark.parametrize(
    ("names", "distinct"),
    [
        (("x", "hat_x"), ("x_1", "hat_x_2")),
        (("J", "j"), ("J_1", "j_2")),
        (("X", "applied_x"), ("X_1", "applied_x_2")),
        (("x", "that_x2"), ("x", "that_x2")),
    ],
)
def test_joints_that_would_share_a_column_get_their_numbers(tmp_path, names, distinct):
    import duckdb

    from jaxftc.io import trace_file

    robot = load(tmp_path, TWO_LINKS.replace('"shoulder"', f'"{names[0]}"').replace('"elbow"', f'"{names[1]}"'))
    assert robot.joint_names == distinct
    signals = [*jaxftc.Trace._fields[1:-1], *(name for name in jaxftc.Output._fields if name != "detected")]
    trace = {name: k + np.tile([0.0, 0.5], (3, 1)) for k, name in enumerate(signals)}
    trace_file.write(tmp_path / "trace.parquet", trace, robot.joint_names)
    with duckdb.connect() as connection:
        table = connection.execute("select * from read_parquet($p)", {"p": str(tmp_path / "trace.parquet")}).fetchnumpy()
    assert len(table) == 2 * len(signals)
    assert all(table[f"{s}_{j}"][0] == k + 0.5 * i for k, s in enumerate(signals) for i, j in enumerate(robot.joint_names))


def test_no_table_is_written_with_two_columns_of_one_name(tmp_path):
    from jaxftc.io.tables import write_parquet

    with refuses("columns 'Q' and 'q' of a.parquet have one name but for their case; rename one"):
        write_parquet(tmp_path / "a.parquet", {"Q": np.zeros(2), "q": np.ones(2)})
    assert not list(tmp_path.iterdir())
