"""Robot files as they are published: the arm is picked out, the rest is welded with its mass, and what is wrong is named."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest

import jaxftc
from jaxftc.cli import common
from jaxftc.cli.main import main
from jaxftc.robot.arm_file import read_robot
from jaxftc.robot.doubts import doubts
from jaxftc.robot.link import oddity
from jaxftc.robot.numbers import mass_matrices
from jaxftc.scenarios.scenario import paper_motion

INERTIAL = '<inertial><origin xyz="0.1 0.02 0" rpy="0.3 -0.2 0.5"/><mass value="{m}"/>{i}</inertial>'
TENSOR = '<inertia ixx="0.02" iyy="0.03" izz="0.025" ixy="0.001" ixz="-0.002" iyz="0.003"/>'
SHAPE = '<visual><geometry><mesh filename="package://nowhere/a.dae"/></geometry></visual>'
SHAPE += '<collision><geometry><box size="1 1 1"/></geometry></collision>'


def link(name: str, mass: float | str = 2.0, tensor: str = TENSOR, shape: str = SHAPE) -> str:
    return f'<link name="{name}">{INERTIAL.format(m=mass, i=tensor)}{shape}</link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", more: str = "", axis: str = "0 1 0") -> str:
    limit = "" if "<limit" in more else '<limit lower="-2" upper="2.5" effort="40" velocity="3"/>'
    limit = "" if kind in ("fixed", "continuous", "floating", "planar") else limit
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.3 0.1 0.05" rpy="0.2 0.4 -0.3"/><axis xyz="{axis}"/>{limit}{more}</joint>'
    )


FRICTION = '<dynamics damping="0.7" friction="0.3"/>'
TWO = (
    link("base")
    + link("upper")
    + link("lower")
    + joint("j1", "base", "upper", more=FRICTION)
    + joint("j2", "upper", "lower")
)
HAND = link("palm", 0.7) + link("left", 0.1) + link("right", 0.1) + joint("wrist", "lower", "palm", "fixed")
HAND += joint("f1", "palm", "left", "prismatic") + joint(
    "f2", "palm", "right", "revolute", '<mimic joint="f1" offset="0.4"/>'
)


def urdf(body: str) -> str:
    return f'<robot name="arm">{body}</robot>'


def written(folder: Path, text: str | bytes, name: str = "arm.urdf") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def load(folder: Path, text: str, name: str = "arm.urdf", **ask) -> jaxftc.Robot:
    return jaxftc.load_robot(written(folder, text, name), **ask)


# What a URDF holds, by world poses and Jacobians of each link: none of the package's code.


def transform(element) -> np.ndarray:
    frame = np.eye(4)
    if element is not None:
        x, y, z = (float(v) for v in element.get("rpy", "0 0 0").split())
        turns = [np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])]
        turns.append(np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]]))
        turns.append(np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]]))
        frame[:3, :3] = turns[2] @ turns[1] @ turns[0]
        frame[:3, 3] = [float(v) for v in element.get("xyz", "0 0 0").split()]
    return frame


def moved(joint, value: float) -> np.ndarray:
    axis = np.array([float(v) for v in joint.find("axis").get("xyz").split()])
    axis, frame = axis / np.linalg.norm(axis), np.eye(4)
    if joint.get("type") == "prismatic":
        frame[:3, 3] = value * axis
    else:
        flat = np.zeros(9)
        mujoco.mju_quat2Mat(flat, np.array([np.cos(value / 2), *(np.sin(value / 2) * axis)]))
        frame[:3, :3] = flat.reshape(3, 3)
    return frame


def by_hand(
    text: str, names: tuple[str, ...], q: np.ndarray, welded: dict[str, float]
) -> tuple[np.ndarray, np.ndarray, float]:
    """(M [n, n], gravity torque [n], mass that moves) of a URDF."""
    root, n = ET.fromstring(text), len(names)
    above = {j.find("child").get("link"): j for j in root.findall("joint")}
    matrix, gravity, mass = np.zeros((n, n)), np.zeros(n), 0.0
    for element in root.findall("link"):
        way, at = [], element.get("name")
        while at in above:
            way.append(above[at])
            at = above[at].find("parent").get("link")
        frame, hinges = np.eye(4), []
        for j in reversed(way):
            frame = frame @ transform(j.find("origin"))
            if j.get("name") in names:
                k = names.index(j.get("name"))
                axis = np.array([float(v) for v in j.find("axis").get("xyz").split()])
                hinges.append((k, frame[:3, :3] @ axis / np.linalg.norm(axis), frame[:3, 3].copy()))
                frame = frame @ moved(j, q[k])
            elif j.get("type") != "fixed":
                frame = frame @ moved(j, welded.get(j.get("name"), 0.0))
        inertial = element.find("inertial")
        if inertial is None or not hinges:
            continue
        kg, com = float(inertial.find("mass").get("value")), frame @ transform(inertial.find("origin"))
        entry = {key: float(value) for key, value in inertial.find("inertia").items()}
        rows = [[entry["i" + "".join(sorted(a + b))] for b in "xyz"] for a in "xyz"]
        tensor = com[:3, :3] @ np.array(rows) @ com[:3, :3].T
        swing, spin = np.zeros((3, n)), np.zeros((3, n))
        for k, axis, origin in hinges:
            spin[:, k], swing[:, k] = axis, np.cross(axis, com[:3, 3] - origin)
        matrix += kg * swing.T @ swing + spin.T @ tensor @ spin
        gravity, mass = gravity + 9.81 * kg * swing[2], mass + kg
    return matrix, gravity, mass


def agrees(robot: jaxftc.Robot, text: str, welded: dict[str, float] | None = None) -> None:
    q = np.linspace(0.4, -0.9, robot.n)
    matrix, gravity, mass = by_hand(text, robot.joint_names, q, welded or {})
    np.testing.assert_allclose(mass_matrices(robot.links, q[None])[0], matrix, atol=1e-12)
    zero = np.zeros(robot.n)
    np.testing.assert_allclose(jaxftc.inverse_dynamics(robot, q, zero, zero), gravity, atol=1e-10)
    assert sum(link.mass for link in robot.links) == pytest.approx(mass, rel=1e-12)


def test_mass_and_inertia_are_those_of_the_file_rotations_included(tmp_path):
    agrees(load(tmp_path, urdf(TWO)), urdf(TWO))


def test_a_hand_is_welded_with_its_mass_and_each_joint_is_said(tmp_path):
    robot = load(tmp_path, urdf(TWO + HAND))
    assert robot.joint_names == ("j1", "j2") and robot.link_names == ("upper", "lower")
    agrees(robot, urdf(TWO + HAND), {"f2": 0.4})
    assert robot.notes == (
        "joint 'f1' (slide) is welded at 0 m; its mass stays on 'lower'",
        "joint 'f2' (mimics 'f1') is welded at 0.4 rad; its mass stays on 'lower'",
    )


def test_a_locked_joint_stands_where_it_is_locked(tmp_path):
    robot = load(tmp_path, urdf(TWO + HAND), lock={"j1": 0.7, "f1": 0.2})
    assert robot.joint_names == ("j2",)
    text = urdf(TWO + HAND)
    q, welded = np.array([0.4]), {"j1": 0.7, "f1": 0.2, "f2": 0.6}
    matrix, gravity, _ = by_hand(text, ("j2",), q, welded)
    np.testing.assert_allclose(mass_matrices(robot.links, q[None])[0], matrix, atol=1e-12)
    np.testing.assert_allclose(jaxftc.inverse_dynamics(robot, q, 0 * q, 0 * q), gravity, atol=1e-10)
    assert "joint 'j1' (locked) is welded at 0.7 rad; it does not move with the arm" in robot.notes


def test_a_collision_shape_weighs_nothing(tmp_path):
    """MuJoCo would give the box of the flange 1000 kg."""
    text = urdf(TWO + f'<link name="flange">{SHAPE}</link>' + joint("weld", "lower", "flange", "fixed"))
    robot = load(tmp_path, text)
    agrees(robot, text)
    assert robot.notes == ("link 'flange' moves and has no <inertial>: taken as without mass, as the file has it",)


def chain_of(prefix: str, start: str, count: int) -> str:
    text, before = "", start
    for k in range(1, count + 1):
        text += link(f"{prefix}{k}") + joint(f"{prefix}_j{k}", before, f"{prefix}{k}")
        before = f"{prefix}{k}"
    return text


TORSO = link("base") + link("chest") + joint("waist", "base", "chest")
FORKS = {
    "fingers": (
        link("base") + chain_of("a", "base", 3) + chain_of("x", "a3", 2) + chain_of("y", "a3", 1),
        ["a_j1", "a_j2", "a_j3"],
    ),
    "equal fingers": (
        link("base") + chain_of("a", "base", 2) + chain_of("x", "a2", 2) + chain_of("y", "a2", 2),
        ["a_j1", "a_j2"],
    ),
    "a head": (TORSO + chain_of("head", "chest", 1) + chain_of("a", "chest", 3), ["waist", "a_j1", "a_j2", "a_j3"]),
    "wheels": (
        link("base") + chain_of("w", "base", 1) + chain_of("v", "base", 1) + chain_of("a", "base", 2),
        ["a_j1", "a_j2"],
    ),
    "a passive link": (link("base") + chain_of("a", "base", 3) + chain_of("rod", "a1", 1), ["a_j1", "a_j2", "a_j3"]),
    "a jaw": (link("base") + chain_of("a", "base", 2) + chain_of("jaw", "a2", 1), ["a_j1", "a_j2", "jaw_j1"]),
}


@pytest.mark.parametrize("fork", FORKS)
def test_where_the_arm_goes_and_ends_without_a_tip(tmp_path, fork):
    text, names = FORKS[fork]
    robot = load(tmp_path, urdf(text))
    assert list(robot.joint_names) == names
    agrees(robot, urdf(text))
    assert any("may be a gripper's" in note for note in robot.notes) == (fork == "a jaw")


TWO_ARMS = TORSO + chain_of("left", "chest", 3) + chain_of("right", "chest", 3)


@pytest.mark.parametrize("tip", ["left3", "left_j3"])
def test_a_tip_picks_one_arm_of_two(tmp_path, tip):
    robot = load(tmp_path, urdf(TWO_ARMS), tip=tip, lock={"waist": 0.3})
    assert robot.joint_names == ("left_j1", "left_j2", "left_j3")
    q = np.array([0.4, -0.3, 0.2])
    matrix, gravity, _ = by_hand(urdf(TWO_ARMS), robot.joint_names, q, {"waist": 0.3})
    np.testing.assert_allclose(jaxftc.inverse_dynamics(robot, q, 0 * q, 0 * q), gravity, atol=1e-10)
    np.testing.assert_allclose(mass_matrices(robot.links, q[None])[0], matrix, atol=1e-12)


def test_a_tip_is_for_the_commands_that_read_logs_too(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(urdf(TWO_ARMS))
    arm = common.whole_arm(str(path), "left3", ("waist=0.3",))
    assert arm.robot.joint_names == ("left_j1", "left_j2", "left_j3") and not arm.recording.columns


def test_a_tip_leaves_out_what_comes_after_it(tmp_path):
    robot = load(tmp_path, urdf(FORKS["a jaw"][0]), tip="a2")
    assert robot.joint_names == ("a_j1", "a_j2") and robot.tool == "the tip 'a2'"
    assert robot.notes == ("joint 'jaw_j1' (hinge) is welded at 0 rad; its mass stays on 'a2'",)
    agrees(robot, urdf(FORKS["a jaw"][0]))


@pytest.mark.parametrize("name", ["tool0", "left_ee_link", "flange", "my/tcp"])
def test_a_payload_hangs_at_the_tool(tmp_path, name):
    tool = f'<link name="{name}"/>' + joint("to_tool", "lower", name, "fixed")
    robot, bare = load(tmp_path, urdf(TWO + tool)), load(tmp_path, urdf(TWO), "bare.urdf")
    assert (robot.tool, bare.tool) == (repr(name), "the origin of 'lower'")
    at = transform(ET.fromstring(joint("to_tool", "lower", name, "fixed")).find("origin"))[:3, 3]
    np.testing.assert_allclose(np.linalg.norm(robot.payload_link.moment), np.linalg.norm(at), rtol=1e-12)
    assert not bare.payload_link.moment.any()


def test_what_a_file_without_friction_and_motor_inertia_lacks_is_said(tmp_path, capsys):
    path = written(tmp_path, urdf(TWO.replace(FRICTION, "")))
    robot = jaxftc.load_robot(path)
    assert len(robot.cautions) == 1 and "no motor inertia (armature) and no friction for any joint" in robot.cautions[0]
    assert not jaxftc.load_robot(written(tmp_path, urdf(TWO), "rubbed.urdf")).cautions
    main(["inspect", str(path)])
    page = capsys.readouterr().out
    for part in ("2 joints, 4 kg that move", "j1", "-115 to 143", "40", "no friction for any joint;", "doubtful"):
        assert part in page


def test_the_page_as_json_has_everything(tmp_path, capsys):
    import json

    main(["inspect", str(written(tmp_path, urdf(TWO + HAND))), "--lock", "f1=0.01", "--json"])
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    assert [j["name"] for j in found["joints"]] == ["j1", "j2"] and found["moving_mass_kg"] == pytest.approx(4.9)
    assert found["lock"] == {"f1": 0.01} and len(found["notes"]) == 2
    first = found["joints"][0]
    assert (first["torque_limit_nm"], first["viscous_nms"], first["coulomb_nm"]) == (40, [0.7, 0.7], [0.3, 0.3])


def test_what_looks_like_a_placeholder(tmp_path):
    same = [f"every joint has the same {what}" for what in ("torque limit, 40 N m", "speed limit, 3 rad/s")]
    wide = link("base") + chain_of("a", "base", 3).replace('ixx="0.02" iyy="0.03"', 'ixx="20" iyy="30"')
    found = doubts(load(tmp_path, urdf(wide.replace('izz="0.025"', 'izz="25"'))))
    for line in (*same, "every joint has the same range, -115 to 143 deg", "every link has the same mass, 2 kg"):
        assert line in found
    assert any(line.startswith("no motor inertia for any joint") for line in found)
    assert any("radius of gyration of " in line for line in found)
    assert not doubts(jaxftc.puma560())


ARM = """<mujoco><compiler angle="radian" meshdir="nowhere"/>
  <asset><mesh name="look" file="look.stl"/><texture name="t" type="2d" file="none.png"/>
    <material name="m" texture="t"/></asset>
  <worldbody><geom type="mesh" mesh="look"/>
    <body name="cube" pos="1 0 0"><freejoint/><geom type="box" size=".1 .1 .1"/></body>
    <body name="upper"><joint name="j1" axis="0 0 1" damping="1" {first}/><inertial pos="0.1 0 0" mass="2" {inertia}/>
      <geom type="mesh" mesh="look" material="m"/>
      <body name="lower" pos="0.4 0 0"><joint name="j2" axis="0 1 0" {second}/><inertial pos="0.2 0 0" mass="1"
        diaginertia="0.02 0.02 0.01"/>
        <body name="finger" pos="0.4 0 0" gravcomp="1"><joint name="f1" type="slide" axis="1 0 0" stiffness="30" ref="0.01"/>
          <inertial pos="0.01 0 0" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/></body>
        <body name="thumb" pos="0.4 0.1 0"><joint name="f2" axis="0 0 1"/>
          <geom type="box" size=".02 .01 .01" mass="0.1"/></body>
      </body></body></worldbody>
  <equality><joint joint1="f2" joint2="f1" polycoef="0.1 2 0 0 0"/></equality>
  <sensor><jointpos joint="f1"/></sensor><keyframe><key qpos="0 0 0 1 0 0 0 0 0 0 0"/></keyframe>
  <actuator><position joint="j1" kp="10"/><motor joint="j2" {motor}/></actuator></mujoco>"""
PLAIN = {"first": "", "second": "", "inertia": 'diaginertia="0.01 0.02 0.02"', "motor": 'ctrlrange="-9 9"'}


def mjcf(**changes: str) -> str:
    return ARM.format(**PLAIN | changes)


def test_an_mjcf_with_a_gripper_loose_objects_and_no_meshes(tmp_path):
    """MuJoCo itself, of the same file without meshes: the welded joints at rest, f2 where its rule puts it."""
    robot = load(tmp_path, mjcf(), "arm.xml")
    assert robot.joint_names == ("j1", "j2") and list(robot.torque_limit) == [np.inf, 9]
    spec = mujoco.MjSpec.from_string(mjcf())
    for kind in ("sensors", "keys", "equalities", "actuators"):
        for element in list(getattr(spec, kind)):
            spec.delete(element)
    for geom in list(spec.geoms):
        if geom.meshname:
            spec.delete(geom)
    for kind in ("materials", "textures", "meshes"):
        for element in list(getattr(spec, kind)):
            spec.delete(element)
    spec.body("finger").gravcomp = 0
    model = spec.compile()
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    q, dofs = np.array([0.3, -0.8]), [model.joint(name).dofadr[0] for name in ("j1", "j2")]
    for name, value in (("j1", q[0]), ("j2", q[1]), ("f2", 0.1)):
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    np.testing.assert_allclose(mass_matrices(robot.links, q[None])[0], full[np.ix_(dofs, dofs)], atol=1e-12)
    np.testing.assert_allclose(jaxftc.inverse_dynamics(robot, q, 0 * q, 0 * q), data.qfrc_bias[dofs], atol=1e-10)
    assert robot.notes[0].startswith("joint 'joint1' (free) is welded where it stands; it does not move")
    assert robot.notes[1].startswith("joint 'f1' (slide) is welded at 0.01 m; its mass stays on 'lower'")
    assert robot.notes[2].startswith("joint 'f2' (mimics 'f1') is welded at 0.1 rad")


def test_a_link_that_no_body_can_be_is_loaded_and_said_while_the_arm_can_be(tmp_path):
    """What an identification makes of single links: M(q) is still positive definite, and exact in both engines."""
    odd = link("upper", 3, TENSOR.replace('izz="0.025"', 'izz="-0.01"'))
    text = urdf(TWO.replace(link("upper"), odd))
    with pytest.warns(UserWarning, match=r"'upper'.*inertia.*below zero"):
        robot = load(tmp_path, text)
    agrees(robot, text)
    q = np.array([0.4, -0.9])
    data, full = mujoco.MjData(robot.mj_model), np.zeros((2, 2))
    data.qpos[:] = q
    mujoco.mj_forward(robot.mj_model, data)
    mujoco.mj_fullM(robot.mj_model, data, full)
    np.testing.assert_allclose(full, by_hand(text, robot.joint_names, q, {})[0], atol=1e-12)
    tensor = 'fullinertia="0.01 0.02 0.05 0 0 0"'
    with pytest.warns(UserWarning, match=r"'upper'.*above the sum"):
        assert load(tmp_path, mjcf(inertia=tensor), "arm.xml").links[0].inertia[2, 2] == pytest.approx(0.05 + 2 * 0.01)


def test_what_no_body_can_be():
    assert oddity(1.0, np.diag([1.0, 1.0, 2.0])) == "" == oddity(0.0, np.zeros((3, 3)))
    assert "below zero" in oddity(-1.0, np.eye(3)) and "no mass" in oddity(0.0, np.eye(3))


def test_a_link_without_mass_in_the_middle_of_the_arm(tmp_path):
    between = '<link name="upper"/>'
    robot = load(tmp_path, urdf(TWO.replace(link("upper"), between)))
    agrees(robot, urdf(TWO.replace(link("upper"), between)))
    assert any("link 'upper' moves and has no <inertial>" in note for note in robot.notes)


WRONG = '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'
BAD_URDF = {
    "no mass": (
        TWO.replace(link("lower"), f'<link name="lower">{SHAPE}</link>'),
        "without mass (0 kg) move the links 'lower'; "
        "joint 'j2' moves an inertia of 0 kg m^2, which must be above zero; give link 'lower'",
    ),
    "no inertials": (
        re.sub("<inertial>.*?</inertial>", "", TWO),
        "without mass (0 kg) move the links 'upper', 'lower'; joint 'j1'",
    ),
    "a point on its axis": (
        TWO.replace(link("lower"), f'<link name="lower"><inertial><mass value="1"/>{WRONG}</inertial></link>'),
        "joint 'j2' moves an inertia of 0 kg m^2, which must be above zero",
    ),
    "negative mass": (
        TWO.replace(link("lower"), link("lower", -2)),
        "link 'lower' has a mass below zero, -2 kg; joint 'j1' moves",
    ),
    "mass that is no number": (
        TWO.replace(link("lower"), link("lower", "nan")),
        "line 1: value of the mass of link 'lower' must be a finite number, got 'nan'",
    ),
    "infinite mass": (
        TWO.replace(link("lower"), link("lower", "inf")),
        "mass of link 'lower' must be a finite number, got 'inf'",
    ),
    "inertia that is no number": (
        TWO.replace(link("lower"), link("lower", 1, TENSOR.replace("0.03", "nan"))),
        "iyy of the inertia of link 'lower' must be a finite number, got 'nan'",
    ),
    "a large negative inertia": (
        TWO.replace(link("lower"), link("lower", 1, TENSOR.replace("0.02", "-9"))),
        "link 'lower' has an inertia that no body can have: principal moments -95, -9, ",
    ),
    "inertial without mass": (
        TWO.replace('<mass value="2.0"/>', "", 3),
        "link 'upper' has an <inertial> without <mass>; give it one",
    ),
    "axis that is no number": (
        TWO.replace('"0 1 0"', '"0 nan 0"'),
        "xyz of the axis of joint 'j1' must be 3 finite numbers",
    ),
    "axis of nothing": (TWO.replace('"0 1 0"', '"0 0 0"'), "axis of joint 'j1' must have a direction, got [0.0, 0.0, 0.0]"),
    "two numbers for three": (
        TWO.replace('"0 1 0"', '"0 1"'),
        "xyz of the axis of joint 'j1' must be 3 finite numbers with blanks",
    ),
    "a comma": (TWO.replace('"0.3 0.1 0.05"', '"0.3,0.1,0.05"'), "xyz of the origin of joint 'j1' must be 3 finite numbers"),
    "negative damping": (
        TWO.replace('damping="0.7"', 'damping="-1"'),
        "damping_positive of joint 'j1' must be finite and not negative",
    ),
    "friction that is no number": (
        TWO.replace('friction="0.3"', 'friction="nan"'),
        "friction of the dynamics of joint 'j1' must be",
    ),
    "effort that is no number": (TWO.replace('effort="40"', 'effort="nan"'), "effort of the limit of joint 'j1' must be"),
    "an element twice": (
        TWO.replace('<parent link="base"/>', '<parent link="base"/>\n<parent link="base"/>'),
        "line 2: <parent> stands twice in <joint>; leave one of them",
    ),
    "a link twice": (TWO + link("upper"), "has the link 'upper' twice; give each its own name"),
    "a joint twice": (TWO + link("x") + joint("j1", "lower", "x"), "has the joint 'j1' twice"),
    "a parent that is not there": (
        TWO + link("x") + joint("j3", "nobody", "x"),
        "joint 'j3' has the parent link 'nobody', which is",
    ),
    "two parents": (TWO + joint("j3", "base", "lower"), "link 'lower' is the child of two joints"),
    "two bases": (TWO + link("alone"), "must have one base link, but links 'base', 'alone' have no parent"),
    "a circle": (TWO + joint("j3", "lower", "base"), "must have one base link, but its joints form a circle"),
    "a type nobody knows": (TWO.replace('"revolute"', '"screw"', 1), "joint 'j1' has the type 'screw'; URDF has revolute, "),
    "no name": (TWO.replace('<link name="upper">', "<link>"), "<link> has no name; give it one"),
    "no joint": (link("base"), "has no joint; a serial arm of at least one hinge is needed"),
    "no hinge": (
        link("base") + link("x") + joint("s", "base", "x", "prismatic"),
        "has no free hinge; only hinges are supported, and its joints are 's' (slide)",
    ),
    "a slide between hinges": (
        TWO.replace('name="j1" type="revolute"', 'name="j1" type="prismatic"') + link("x") + joint("j0", "x", "base"),
        "joint 'j1' is a slide joint; only hinges are supported, so weld it: lock={'j1': 0.0}, or --lock j1=0",
    ),
    "a floating base": (
        TWO + link("x") + joint("root", "x", "base", "floating"),
        "joint 'root' is a floating joint; only hinges",
    ),
    "two arms": (
        TWO_ARMS,
        "holds 2 arms of equal length, to 'left3', 'right3'; say which by its last link: tip='left3', or --tip",
    ),
    "no link": ('<group name="arm"/>', "has no <link>, so it is no URDF (an SRDF names groups of joints only)"),
    "xacro": (
        '<xacro:property name="a" value="1"/>' + TWO,
        "line 1: <xacro:property> is xacro, not URDF; expand the file first",
    ),
}


@pytest.mark.parametrize("case", BAD_URDF)
def test_bad_urdfs_are_refused_in_one_line(tmp_path, capsys, case):
    body, text = BAD_URDF[case]
    path = written(tmp_path, urdf(body))
    with pytest.raises(ValueError, match=re.escape(text)) as refused:
        jaxftc.load_robot(path)
    assert str(refused.value).startswith(f"{path}: ") and "\n" not in str(refused.value)
    with pytest.raises(SystemExit):
        main(["inspect", str(path)])
    assert capsys.readouterr().err == f"jaxftc: {refused.value}\n"


BAD_MJCF = {
    "infinite mass": (
        mjcf().replace('mass="2"', 'mass="inf"'),
        "link 'upper' must have a finite mass and inertia, got inf kg",
    ),
    "axis that is no number": (
        mjcf().replace('axis="0 1 0"', 'axis="0 nan 0"'),
        "axis and position of joint 'j2' must be finite",
    ),
    "gravity that is no number": (mjcf().replace("<asset>", '<option gravity="0 0 nan"/><asset>'), "gravity must be finite"),
    "negative armature": (mjcf(first='armature="-1"'), "armature of joint 'j1' must be finite and not negative, got -1"),
    "negative damping": (
        mjcf(second='damping="-1"'),
        "damping_positive of joint 'j2' must be finite and not negative, got -1",
    ),
    "negative friction": (
        mjcf(second='frictionloss="-1"'),
        "coulomb_positive of joint 'j2' must be finite and not negative",
    ),
    "a spring in the arm": (mjcf(second='stiffness="5"'), "joint 'j2' has a spring (stiffness), which is not modelled here"),
    "gravcomp in the arm": (
        mjcf().replace('<body name="upper"', '<body name="upper" gravcomp="1"'),
        "body 'upper' has gravcomp",
    ),
    "a mesh to weigh that is not there": (
        mjcf().replace('<inertial pos="0.1 0 0" mass="2" diaginertia="0.01 0.02 0.02"/>', ""),
        "link 'upper' takes its mass from",
    ),
    "a ball joint": (
        mjcf().replace('name="j1" axis="0 0 1" damping="1"', 'name="j1" type="ball"'),
        "joint 'j1' is a ball joint",
    ),
    "air": (
        mjcf().replace("<asset>", '<option density="1.2"/><asset>'),
        "air or water (option density, viscosity) is not modelled",
    ),
    "a word MuJoCo does not know": (mjcf().replace("<asset>", "<oops/><asset>"), "does not compile: XML Error"),
    "not XML": ("<mujoco><worldbody>", "is not XML: no element found: line 1"),
    "nothing": ("", "is not XML: no element found"),
    "SDF": ("<sdf version='1.9'><model name='a'/></sdf>", "is SDF, which is not read here; give the robot's URDF"),
    "HTML": ("<html><body/></html>", "begins with <html>; an MJCF begins with <mujoco>, a URDF with <robot>"),
}


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("case", BAD_MJCF)
def test_bad_mjcfs_are_refused_in_one_line(tmp_path, case):
    text, said = BAD_MJCF[case]
    with pytest.raises(ValueError, match=re.escape(said)) as refused:
        load(tmp_path, text, "arm.xml")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("ask", "text"),
    [
        ({"tip": "uper"}, "has no link, site or joint 'uper'; did you mean 'upper'"),
        ({"tip": "base"}, "has no hinge on the way to 'base'; give the last link of the arm"),
        ({"lock": {"j3": 0.0}}, "has no joint 'j3'; did you mean 'j2' or 'j1'?"),
        ({"lock": {"j1": np.nan}}, "lock 'j1' must be a finite number of rad or m, got nan"),
        (
            {"lock": {"j1": 0.0, "j2": 0.0}},
            "has no free hinge; only hinges are supported, and its joints are 'j1' (locked), 'j2' (locked)",
        ),
    ],
)
def test_bad_tips_and_locks_are_refused(tmp_path, ask, text):
    with pytest.raises(ValueError, match=re.escape(text)):
        load(tmp_path, urdf(TWO), **ask)


ODD = {
    "effort and velocity 0": (
        TWO.replace('effort="40" velocity="3"', 'effort="0" velocity="0"', 1),
        "joint 'j1' has effort 0 N m, a placeholder: taken as no limit",
    ),
    "a range of nothing": (
        TWO.replace('lower="-2" upper="2.5"', 'lower="0" upper="0"', 1),
        "joint 'j1' has a range from 0 to 0, a placeholder: taken as no range",
    ),
    "a static link that no body can be": (TWO.replace(link("base"), link("base", -1)), ""),
    "a static link with an inertial that is none": (TWO.replace(link("base"), link("base", "oops")), ""),
    "an axis of any length": (TWO.replace('xyz="0 1 0"', 'xyz="0 3 0"'), ""),
    "xacro in a comment": ("<!-- <xacro:macro name='x'> ${y} -->" + TWO, ""),
    "elements of other programs": ('<gazebo/><transmission name="t"/><ns:thing a="1"/>' + TWO, ""),
    "a mimic joint in the arm": (
        TWO.replace("<axis", '<mimic joint="j2"/><axis', 1) + link("x") + joint("j3", "lower", "x"),
        "joint 'j1' (mimics 'j2') is welded at 0 rad; it does not move with the arm",
    ),
    "a lift under the arm": (
        TWO + link("x") + joint("lift", "x", "base", "prismatic"),
        "joint 'lift' (slide) is welded at 0 m; it does not move with the arm",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", ODD)
def test_odd_urdfs_are_loaded_and_the_oddity_is_said(tmp_path, case):
    body, note = ODD[case]
    robot = load(tmp_path, "\ufeff" + urdf(body))
    assert not note or note in robot.notes
    assert robot.n == 2
    if case == "effort and velocity 0":
        assert list(robot.torque_limit) == [np.inf, 40] and list(robot.speed_limit) == [np.inf, 3]


def test_a_motor_that_pulls_one_way(tmp_path):
    robot = load(tmp_path, mjcf(motor='ctrlrange="0 50"'), "arm.xml")
    assert list(robot.torque_limit) == [np.inf, 50]
    assert "joint 'j2' has the ctrlrange 0 to 50 N m, on one side of zero: 50 N m taken both ways" in robot.notes


def test_notes_and_cautions_are_lines_on_stderr(tmp_path, capsys, monkeypatch):
    from jaxftc.cli import common
    from jaxftc.cli.simulate import Simulate

    path = written(tmp_path, urdf(TWO.replace(FRICTION, "") + HAND))
    robot = common.load_arm(Simulate(robot=str(path), lock=("f1=0.01",)))
    out, err = capsys.readouterr()
    assert robot.n == 2 and out == "" and err.splitlines() == [f"arm: {line}" for line in robot.notes + robot.cautions]
    assert "'f1' (locked) is welded at 0.01 m" in err and "no motor inertia" in err
    for words, text in ((("f1",), "--lock takes names with a number each"), (("f1=0", "f1=1"), "--lock has 'f1' twice")):
        with pytest.raises(ValueError, match=text):
            common.load_arm(Simulate(robot=str(path), lock=words))
    with pytest.raises(ValueError, match="--tip and --lock are for robot files"):
        common.load_arm(Simulate(tip="link6"))


# Motions.


def six(low: float, high: float) -> str:
    narrow = f'<limit lower="{low}" upper="{high}" effort="40" velocity="3"/>'
    names = ["base", *(f"l{k}" for k in range(6))]
    return urdf("".join(map(link, names)) + "".join(joint(f"j{k}", names[k], names[k + 1], more=narrow) for k in range(6)))


@pytest.mark.parametrize(("low", "high"), [(-0.5, 0.3), (1.0, 9.0), (-4.0, -3.5)])
def test_motions_stay_within_the_ranges_of_the_joints(tmp_path, low, high):
    config = jaxftc.Config(load(tmp_path, six(low, high)), engine="chain", duration=0.05)
    start, goal = paper_motion(config)
    drawn = jaxftc.sample_scenarios(jax.random.key(0), 200, "standard", config=config)
    for q in (start, goal, drawn.q_start, drawn.q_goal):
        assert low < np.min(q) and np.max(q) < high
    assert np.abs(goal - start).min() > 0 and np.ptp(drawn.q_start, axis=0).min() > 0


def test_an_arm_without_ranges_moves_as_before(puma):
    start, goal = paper_motion(jaxftc.Config(puma))
    np.testing.assert_allclose(np.rad2deg(start), (30, 120, 30, 120, 50, 180), rtol=1e-6)
    np.testing.assert_allclose(np.rad2deg(goal), (180, 30, 330, -50, 280, 16), rtol=1e-6)


def test_arms_with_other_ranges_are_other_arms(tmp_path):
    """Motions of presets are compiled in, so their programs must not be shared."""
    assert load(tmp_path, six(-1, 1)) != load(tmp_path, six(-1, 2))
    assert read_robot(written(tmp_path, six(-1, 1))) == read_robot(written(tmp_path, six(-1, 1), "same.urdf"))
