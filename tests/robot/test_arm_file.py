"""An arm's own file: what a robot file lacks, written by a person or by the package, and what it means in the model."""

import dataclasses
import re

import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from benchmarks.arms import serial
from jaxftc.cli.main import main
from jaxftc.robot import dynamics
from jaxftc.robot.arm_table import Recording
from jaxftc.robot.link import Link
from jaxftc.robot.model_file import compile_robot
from jaxftc.robot.rigid_body import pose
from tests.robot.test_robot_files import HAND, TWO, urdf, written

WRITTEN = """
model = "robots/arm.urdf"
tip = "lower"
lock = { f1 = 0.01 }
gravity_ms2 = [0.0, 9.81, 0.0] # on a wall

[joints.j1]
torque_limit_nm = 50
coulomb_nm = [1.5, 1.2] # positive, negative speed
viscous_nms = [0.4, 0.6]
motor_inertia_kgm2 = 0.3
range_rad = [-1.0, inf]

[joints.j2]
coulomb_nm = 0.2

[links.lower]
mass_kg = 3.25
moment_kgm = [0.1, 0.2, 0.3]
inertia_kgm2 = [0.5, 0.6, 0.7, 0.01, 0.02, 0.03]

[log]
sample_time_s = 0.008
torque_gain = [11.5, 9.25] # N m/A
torque_offset_nm = [0.5, 0.0]
encoder_resolution_rad = 0.0015339807878856412
encoder_noise_rad = 1e-5

[log.columns]
t = "timestamp"
q = ["actual_q_0", "actual_q_1"]
tau = ["current_0", "current_1"]
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "robots").mkdir()
    written(tmp_path / "robots", urdf(TWO + HAND))
    (tmp_path / "arm.toml").write_text("\ufeff" + WRITTEN)
    return tmp_path


def same(one: jaxftc.Robot, other: jaxftc.Robot) -> None:
    """Every number, to the last bit."""
    assert one == other and one.notes == other.notes and one.joint_names == other.joint_names
    for field in dataclasses.fields(jaxftc.Robot):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b, err_msg=field.name)
    for a, b in zip((*one.links, one.payload_link), (*other.links, other.payload_link), strict=True):
        for field in dataclasses.fields(Link):
            np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name), err_msg=field.name)


def test_a_file_that_a_person_wrote(folder):
    arm = jaxftc.load_arm(folder)
    robot, recording = arm.robot, arm.recording
    assert robot.joint_names == ("j1", "j2") and "joint 'f1' (locked) is welded at 0.01 m" in robot.notes[0]
    np.testing.assert_array_equal(robot.torque_limit, [50, 40])
    np.testing.assert_array_equal([robot.coulomb_positive, robot.coulomb_negative], [[1.5, 0.2], [1.2, 0.2]])
    np.testing.assert_array_equal([robot.damping_positive, robot.damping_negative], [[0.4, 0.0], [0.6, 0.0]])
    np.testing.assert_array_equal([robot.armature, robot.damping], [[0.3, 0.0], [0.5, 0.0]])
    np.testing.assert_array_equal([robot.q_low[0], robot.q_high[0]], [-1, np.inf])
    np.testing.assert_array_equal(robot.gravity, [0, 9.81, 0])
    lower = robot.links[1]
    assert lower.mass == 3.25 and list(lower.moment) == [0.1, 0.2, 0.3]
    np.testing.assert_array_equal(lower.inertia, [[0.5, 0.01, 0.02], [0.01, 0.6, 0.03], [0.02, 0.03, 0.7]])
    assert robot.mj_model.body("lower").mass[0] == 3.25, "MuJoCo's model follows"
    assert recording.sample_time == 0.008 and recording.torque_gain == (11.5, 9.25)
    assert recording.encoder_resolution == (2 * np.pi / 4096,) * 2 and recording.torque_offset == (0.5, 0.0)
    assert dict(recording.columns)["q"] == ("actual_q_0", "actual_q_1")


def test_the_robot_of_a_file_is_the_same_by_every_way(folder):
    robot = jaxftc.load_arm(folder).robot
    same(jaxftc.load_robot(folder), robot)
    same(jaxftc.load_robot(folder / "arm.toml"), robot)
    hash(robot)
    alone = jaxftc.load_arm(folder / "robots" / "arm.urdf")
    assert alone.recording == Recording() and alone.robot != robot


def test_what_is_saved_is_loaded_to_the_last_bit(folder):
    arm = jaxftc.load_arm(folder)
    draw = np.random.default_rng(0)
    links = tuple(dataclasses.replace(link, mass=link.mass * draw.uniform(0.9, 1.1)) for link in arm.robot.links)
    fitted = arm.robot.replace(
        links=links,
        armature=draw.uniform(0.1, 1, 2),
        coulomb_positive=draw.uniform(0, 1, 2),
        damping_negative=draw.uniform(0, 1, 2),
        torque_limit=np.array([np.inf, 1 / 3]),
    )
    recording = dataclasses.replace(arm.recording, torque_gain=(1 / 3, 1e-17), encoder_noise=None)
    (folder / "out").mkdir()
    jaxftc.save_arm(folder / "out", jaxftc.Arm(fitted, recording))
    back = jaxftc.load_arm(folder / "out" / "arm.toml")
    same(back.robot, fitted)
    assert back.recording == recording
    text = (folder / "out" / "arm.toml").read_text()
    assert 'model = "../robots/arm.urdf"' in text
    jaxftc.save_arm(folder / "out" / "again.toml", back)
    assert (folder / "out" / "again.toml").read_text() == text


def test_an_arm_that_is_as_its_file_is_saved_in_one_line(tmp_path, monkeypatch):
    arm = jaxftc.load_arm(written(tmp_path, urdf(TWO)))
    jaxftc.save_arm(tmp_path, arm)
    assert (tmp_path / "arm.toml").read_text() == 'model = "arm.urdf"\n'
    monkeypatch.chdir(tmp_path)
    same(jaxftc.load_robot("."), arm.robot)


def test_the_built_in_arm_has_a_file_too(tmp_path, puma):
    frictionless = jaxftc.puma560(coulomb=False)
    for robot in (puma, frictionless):
        jaxftc.save_arm(tmp_path, jaxftc.Arm(robot))
        assert jaxftc.load_robot(tmp_path) == robot


def test_what_no_file_holds_is_not_saved(tmp_path):
    arm = jaxftc.load_arm(written(tmp_path, urdf(TWO)))
    with pytest.raises(ValueError, match=r"'text'.*file"):
        jaxftc.save_arm(tmp_path, jaxftc.Arm(compile_robot("text", serial(1))))
    with pytest.raises(ValueError, match=r"q_zero.*cannot hold"):
        jaxftc.save_arm(tmp_path, jaxftc.Arm(arm.robot.replace(q_zero=np.ones(2))))
    assert not (tmp_path / "arm.toml").exists()


BAD = [
    ("", "model must name the MJCF or URDF file, such as model = 'arm.urdf', got None"),
    ('modle = "arm.urdf"', "unknown key 'modle'; did you mean 'model'?"),
    ('model = "none.urdf"', "no robot file at"),
    ('model = "arm.toml"', "model must be an MJCF or URDF file, got 'arm.toml'"),
    ('model = "arm.urdf"\ntip = 3', "tip must name a link, got 3"),
    ('model = "arm.urdf"\ntip = "hand"', "has no link, site or joint 'hand'; did you mean"),
    ('model = "arm.urdf"\nlock = 3', "lock must be a table, got 3"),
    ('model = "arm.urdf"\nlock = { j1 = "open" }', "lock.j1 must be a finite number, got 'open'"),
    ('model = "puma560"\ntip = "link6"', "tip and lock do nothing with the built-in arm; leave them out"),
    ('model = "arm.urdf"\ngravity_ms2 = 9.81', "gravity_ms2 must hold 3 numbers, got 9.81"),
    ('model = "arm.urdf"\n[joints.elbow]\ncoulomb_nm = 1', "unknown key 'joints.elbow'; allowed are j1, j2"),
    ('model = "arm.urdf"\n[joints.j1]\ncolomb_nm = 1', "unknown key 'joints.j1.colomb_nm'; did you mean 'coulomb_nm'?"),
    ('model = "arm.urdf"\n[joints.j1]\ncoulomb_nm = [1, 2, 3]', "joints.j1.coulomb_nm must hold 2 numbers, got 3"),
    (
        'model = "arm.urdf"\n[joints.j1]\ncoulomb_nm = -1',
        "coulomb_positive of joint 'j1' must be finite and not negative, got -1",
    ),
    (
        'model = "arm.urdf"\n[joints.j1]\nmotor_inertia_kgm2 = nan',
        "joints.j1.motor_inertia_kgm2 must be a finite number, got nan",
    ),
    ('model = "arm.urdf"\n[joints.j1]\nviscous_nms = true', "joints.j1.viscous_nms must be a finite number, got True"),
    ('model = "arm.urdf"\n[joints.j1]\ntorque_limit_nm = 0', "torque_limit of joint 'j1' must be above zero, got 0"),
    ('model = "arm.urdf"\n[joints.j1]\nrange_rad = 1', "joints.j1.range_rad must be [low, high], got 1"),
    ('model = "arm.urdf"\n[links.upper]\nmass = 1', "unknown key 'links.upper.mass'; did you mean 'mass_kg'?"),
    ('model = "arm.urdf"\n[links.upper]\nmoment_kgm = [1, 2]', "links.upper.moment_kgm must hold 3 numbers, got 2"),
    (
        'model = "arm.urdf"\n[links.lower]\ninertia_kgm2 = [-9, -9, -9, 0, 0, 0]',
        "link 'lower' has an inertia that no body can have",
    ),
    ('model = "arm.urdf"\n[log]\nsample_time_s = 0', "log.sample_time_s must be above zero, got 0.0"),
    ('model = "arm.urdf"\n[log]\ntorque_gain = [1, 0]', "log.torque_gain must not be zero, got [1, 0]"),
    ('model = "arm.urdf"\n[log]\nencoder_noise_rad = -1', "log.encoder_noise_rad must not be negative, got -1"),
    ('model = "arm.urdf"\n[log.columns]\nq = ["a"]', "log.columns.q must hold 2 names, got 1"),
    ('model = "arm.urdf"\n[log.columns]\nangle = "a"', "unknown key 'log.columns.angle'; allowed are t, q, tau, qd"),
    ("model = ", "cannot read"),
    ("model = " + "[" * 5000, "cannot read"),
]


@pytest.mark.parametrize(("text", "said"), BAD, ids=[said[:40] for _, said in BAD])
def test_bad_files_are_refused_in_one_line(tmp_path, capsys, text, said):
    written(tmp_path, urdf(TWO))
    (tmp_path / "arm.toml").write_text(text)
    with pytest.raises(ValueError, match=re.escape(said)):
        jaxftc.load_robot(tmp_path)
    with pytest.raises(SystemExit):
        main(["inspect", str(tmp_path)])
    assert capsys.readouterr().err.count("\n") == 1


def test_a_tip_beside_a_file_that_names_its_own(folder):
    with pytest.raises(ValueError, match="names tip and locked joints itself; change them there"):
        jaxftc.load_robot(folder, tip="upper")


def test_the_page_of_an_arm_shows_its_logs_and_friction(folder, capsys):
    main(["inspect", str(folder)])
    page = capsys.readouterr().out
    for part in ("+1.5 -1.2", "+0.4 -0.6", "torque_gain: (11.5, 9.25)", "gravity: 0, 9.81, 0 m/s^2"):
        assert part in page


# What the numbers mean.


@pytest.fixture
def rubbed(tmp_path):
    """Friction of each kind that depends on the direction, beside the same arm with its mean."""
    robot = jaxftc.load_robot(written(tmp_path, urdf(TWO)))
    sided = robot.replace(damping_positive=np.array([0.4, 0.2]), damping_negative=np.array([0.6, 0.1]))
    mean = sided.replace(damping_positive=sided.damping, damping_negative=sided.damping)
    return sided, mean


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_viscous_friction_by_direction(rubbed, sign):
    sided, mean = rubbed
    qd = sign * np.array([2.0, 3.0])
    wanted = (sided.damping_positive if sign > 0 else sided.damping_negative) * qd
    np.testing.assert_allclose(dynamics.viscous(sided, jnp.asarray(qd)), wanted, rtol=1e-9)
    np.testing.assert_array_equal(dynamics.viscous(mean, jnp.asarray(qd)), mean.damping * qd)
    assert sided != mean and hash(sided) != hash(mean)


def test_forward_undoes_inverse_with_friction_by_direction(rubbed):
    q, qd, qdd = np.random.default_rng(0).uniform(-2, 2, (3, 2, 7))
    for robot in rubbed:
        tau = jaxftc.inverse_dynamics(robot, q, qd, qdd)
        np.testing.assert_allclose(jaxftc.forward_dynamics(robot, q, qd, tau, engine="chain"), qdd, atol=1e-9)


def test_the_nominal_model_knows_friction_by_direction(rubbed):
    """What the observer has left over: nothing with the same friction, with the mean of both directions their difference."""
    sided, mean = rubbed
    both = {}
    for name, nominal in (("same", sided), ("mean", mean)):
        zero, q, qd = np.zeros(2), np.array([0.3, -0.2]), np.array([1.5, 2.0])
        tau = np.asarray(jaxftc.inverse_dynamics(sided, q, qd, zero))
        modelled = np.asarray(dynamics.nominal_torque(nominal, pose(nominal, jnp.asarray(q)), jnp.asarray(qd), jnp.zeros(2)))
        both[name] = tau - modelled - np.asarray(dynamics.coulomb(nominal, jnp.asarray(qd)))
    np.testing.assert_allclose(both["same"], 0, atol=1e-12)
    np.testing.assert_allclose(both["mean"], [-0.1 * 1.5, 0.05 * 2.0], rtol=1e-9)


def test_a_robot_of_other_numbers_is_another_static_argument(rubbed):
    sided, _ = rubbed
    heavier = sided.replace(links=tuple(dataclasses.replace(link, mass=2 * link.mass) for link in sided.links))
    assert heavier != sided and heavier.replace(links=sided.links) == sided
    with pytest.raises(ValueError, match=r"did you mean 'links'"):
        sided.replace(link=())
    with pytest.raises(ValueError, match=r"armature.*\[2\].*got \[3\]"):
        sided.replace(armature=np.ones(3))
