"""A run as pictures: what is drawn is the arm that was simulated, coloured by what was wrong with it and what was said."""

import copy
import dataclasses
import importlib.util
import json
import platform
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import jaxftc
from jaxftc.cli.main import main, parse
from jaxftc.cli.view import View
from jaxftc.io import trace_file
from jaxftc.io.files import SUFFIX
from jaxftc.report.figures import COLOURS
from jaxftc.types import Verdict
from jaxftc.view import film, looks, offscreen, replay, scene, stage, window
from jaxftc.view.replay import ALARM, DETECTED, FAULT, HEALTHY

TICKS, DT = 40, 5e-3  # 0.2 s
BARE = """
<mujoco><worldbody><body name="upper" pos="0 0 0.3"><joint name="shoulder" axis="0 1 0" pos="0 0 0.02"/>
  <inertial pos="0 0 0.1" mass="1" diaginertia="0.01 0.01 0.01"/>
  <body name="lower" pos="0.1 0 0.4"><joint name="elbow" axis="1 1 0"/>
    <inertial pos="0 0 0.1" mass="1" diaginertia="0.01 0.01 0.01"/>{hand}</body></body></worldbody></mujoco>
"""
TOOL = '<site name="tool" pos="0 0 0.3"/>'
BOX = '<geom name="hand" type="box" size="0.05 0.05 0.1" mass="0"/>'
COLLISION = '<geom type="box" size="0.05 0.05 0.1" mass="0" group="3"/>'


def run(joints: int = 6) -> dict[str, np.ndarray]:
    """Columns of a run: joint 3 has a torque fault at ticks 10 to 29, called at 15 to 32; joint 1 has a false alarm."""
    t = DT * np.arange(TICKS)
    q_ref = np.linspace(0, 0.6, TICKS)[:, None] * np.ones(joints) + 0.3 * np.arange(joints)
    zero = np.zeros((TICKS, joints))
    columns = {
        "t": t,
        "q": q_ref + zero,
        "q_ref": q_ref,
        "fault_tau": zero.copy(),
        "fault_q": zero.copy(),
        "contact_tau": zero.copy(),
    }
    columns["verdict"] = np.zeros((TICKS, joints), np.int32)
    third = min(2, joints - 1)
    columns["q"][10:30, third] += 0.1
    columns["fault_tau"][10:30, third] = 5.0
    columns["verdict"][15:33, third] = Verdict.ACTUATOR
    columns["verdict"][36:, 0] = Verdict.SENSOR
    return columns


def stored(folder: Path, columns=None, names=None, name="trace.parquet") -> Path:
    columns = run() if columns is None else columns
    names = names or tuple(f"joint{j + 1}" for j in range(columns["q"].shape[1]))
    trace_file.write(folder / name, columns, names)
    return folder / name


@pytest.fixture(scope="module")
def trace(tmp_path_factory) -> Path:
    return stored(tmp_path_factory.mktemp("run"))


@pytest.fixture
def puma_scene(trace, paper_arm) -> scene.Scene:
    return scene.Scene(paper_arm, replay.read(trace))


@pytest.fixture(scope="session")
def backend() -> str:
    """The OpenGL that pictures are drawn with; without one the test is skipped, and says why."""
    try:
        return offscreen.backend()
    except ValueError as error:
        pytest.skip(str(error))


@pytest.fixture
def no_drawing(monkeypatch):
    """Doors are tested where nothing can be drawn, too."""
    monkeypatch.setattr(offscreen, "backend", lambda: "egl")
    monkeypatch.setattr(film, "shoot", lambda *args, **kwargs: pytest.fail("something was drawn"))


def refuses(*parts: str):
    """ValueError whose text holds these parts in this order."""
    return pytest.raises(ValueError, match="(?s)" + ".*".join(map(re.escape, parts)))


# --- the trace ---


def test_a_trace_comes_back_as_it_was_written(trace):
    columns = run()
    for path in (trace, trace.parent):
        found = replay.read(path)
        assert found.joints == tuple(f"joint{j}" for j in range(1, 7))
        for name in ("t", "q", "q_ref", "fault_tau", "fault_q", "contact_tau", "verdict"):
            np.testing.assert_array_equal(getattr(found, name), columns[name])


def test_states_and_truth(trace):
    found = replay.read(trace)
    third, first = found.states[:, 2], found.states[:, 0]
    assert third.tolist() == [HEALTHY] * 10 + [FAULT] * 5 + [DETECTED] * 15 + [ALARM] * 3 + [HEALTHY] * 7
    assert first.tolist() == [HEALTHY] * 36 + [ALARM] * 4
    assert not found.states[:, [1, 3, 4, 5]].any()
    both = dataclasses.replace(found, fault_q=found.fault_tau / 100, fault_tau=found.fault_tau[:, ::-1])
    assert both.truth[20].tolist() == [0, 0, Verdict.SENSOR, Verdict.ACTUATOR, 0, 0]
    assert dataclasses.replace(found, fault_q=found.fault_tau).truth[20, 2] == Verdict.BOTH


def test_time_goes_to_the_nearest_tick(trace):
    found = replay.read(trace)
    assert found.tick(np.array([-1.0, 0.0, 0.0024, 0.0026, 0.1, 9.0])).tolist() == [0, 0, 0, 1, 20, TICKS - 1]
    assert found.moment() == pytest.approx(15 * DT + replay.SETTLE)
    assert dataclasses.replace(found, verdict=0 * found.verdict).moment() == pytest.approx(TICKS // 2 * DT)


def test_a_run_ends_where_the_arm_diverges_and_an_absent_reference_is_the_arm(tmp_path):
    columns = run()
    columns["q"][30:, 1] = np.nan
    columns["q_ref"][5, 4] = np.nan
    found = replay.read(stored(tmp_path, columns))
    assert len(found.t) == len(found.verdict) == 30
    assert found.q_ref[5, 4] == columns["q"][5, 4] and np.isfinite(found.q_ref).all()


def test_what_is_no_trace_is_refused(tmp_path):
    with refuses("no trace at", "none", "jaxftc simulate"):
        replay.read(tmp_path / "none")
    with refuses("no trace at", "trace.parquet"):
        replay.read(tmp_path)
    (tmp_path / "text.parquet").write_text("t,q1\n")
    with refuses("cannot read", "text.parquet"):
        replay.read(tmp_path / "text.parquet")
    columns = run()
    del columns["verdict"]
    with refuses("is no trace", "'verdict_joint1'"):
        replay.read(stored(tmp_path, columns))
    with refuses("is no trace", "'q_ref_joint1'"):
        replay.read(stored(tmp_path, {"t": columns["t"], "q": columns["q"]}))
    with refuses("has nothing to show", "not finite from the start"):
        replay.read(stored(tmp_path, run() | {"q": np.full((TICKS, 6), np.nan)}))
    with refuses("has nothing to show", "no row"):
        replay.read(stored(tmp_path, {name: values[:0] for name, values in run().items()}))


# --- what is drawn is the arm ---


def test_the_robot_is_left_as_it_was(paper_arm, trace):
    """MJX and the chain get a model without a shape: what is drawn is compiled apart."""
    before = copy.copy(paper_arm.mj_model)
    drawn = scene.Scene(paper_arm, replay.read(trace)).model
    assert paper_arm.mj_model.ngeom == paper_arm.mj_model.nmesh == paper_arm.mj_model.nlight == 0 < drawn.ngeom
    for name in dir(before):
        value = getattr(before, name)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(value, getattr(paper_arm.mj_model, name), err_msg=name)


def test_shapes_neither_weigh_nor_touch_anything(puma_scene, paper_arm):
    drawn, bodies = puma_scene.model, paper_arm.mj_model.nbody
    assert drawn.nbody == bodies and not drawn.geom_contype.any() and not drawn.geom_conaffinity.any()
    np.testing.assert_allclose(drawn.body_mass, paper_arm.mj_model.body_mass, rtol=1e-6)
    spared = [b for b in range(bodies) if drawn.body(b).name != "link3"]  # whose true inertia the compiler refuses
    np.testing.assert_allclose(drawn.body_inertia[spared], paper_arm.mj_model.body_inertia[spared], rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("arm", ["puma", "bare"])
def test_it_stands_where_the_robot_stands(arm, paper_arm, tmp_path):
    """Forward kinematics at random angles: tool, joints' anchors and axes."""
    robot, source = paper_arm, None
    if arm == "bare":
        source = tmp_path / "arm.xml"
        source.write_text(BARE.format(hand=TOOL))
        robot = jaxftc.load_robot(source)
    drawn = stage.build(robot).model
    data, truth = mujoco.MjData(drawn), mujoco.MjData(robot.mj_model)
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (20, robot.n)):
        data.qpos[:] = truth.qpos[:] = q
        mujoco.mj_kinematics(drawn, data)
        mujoco.mj_kinematics(robot.mj_model, truth)
        np.testing.assert_allclose(data.site("tool").xpos, truth.site("tool").xpos, atol=1e-9)
        np.testing.assert_allclose(data.site("tool").xmat, truth.site("tool").xmat, atol=1e-9)
        np.testing.assert_allclose(data.xanchor, truth.xanchor, atol=1e-9)
        np.testing.assert_allclose(data.xaxis, truth.xaxis, atol=1e-9)


def test_the_puma_has_the_pumas_measures(paper_arm):
    """Shapes reach from axis to axis: shoulder 0.67 m up, 0.43 m to the elbow, 0.43 m to the wrist, 56 mm to the flange."""
    model = stage.build(paper_arm).model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    boxes = {g: data.geom_xpos[g] + data.geom_xmat[g].reshape(3, 3) @ model.geom_aabb[g, :3] for g in range(model.ngeom)}
    for link, part in ((link, part) for link in range(6) for part in looks.PUMA560 if part.joint == link):
        geom = next(g for g in boxes if model.geom(g).name == f"jaxftc_part{looks.PUMA560.index(part)}")
        axis, off = data.xaxis[link], boxes[geom] - data.xanchor[link]
        assert np.linalg.norm(np.cross(axis, off)) < 1e-6, f"the drum of joint {link + 1} is on its axis"
    thick = [max(part.size[:2]) for part in looks.PUMA560 if part.kind == "plate"]
    assert thick[0] > thick[1], "the forearm is the slimmer one"


def test_the_ghost_is_the_reference(puma_scene, paper_arm):
    truth = mujoco.MjData(paper_arm.mj_model)
    for tick, off in ((5, False), (20, True)):
        puma_scene.show(tick)
        truth.qpos[:] = puma_scene.replay.q_ref[tick]
        mujoco.mj_kinematics(paper_arm.mj_model, truth)
        np.testing.assert_allclose(puma_scene.ghost.site("tool").xpos, truth.site("tool").xpos, atol=1e-9)
        truth.qpos[:] = puma_scene.replay.q[tick]
        mujoco.mj_kinematics(paper_arm.mj_model, truth)
        np.testing.assert_allclose(puma_scene.data.site("tool").xpos, truth.site("tool").xpos, atol=1e-9)
        assert (puma_scene.tool_off() > 0.02) == off

        picture, camera = mujoco.MjvScene(puma_scene.model, maxgeom=200), puma_scene.camera(4 / 3)
        puma_scene.add_ghost(picture, mujoco.MjvOption(), camera)
        seen = {model_geom(geom): geom.rgba for geom in picture.geoms[: picture.ngeom] if geom.rgba[3] > 0}
        links = {int(puma_scene.model.geom_bodyid[geom]) for geom in seen}
        assert links == ({puma_scene.model.body(f"link{j}").id for j in (3, 4, 5, 6)} if off else set())
        assert all(rgba[3] <= scene.GHOST[3] + 1e-6 for rgba in seen.values()), "translucent"


def model_geom(geom) -> int:
    assert geom.objtype == mujoco.mjtObj.mjOBJ_GEOM
    return int(geom.objid)


def test_colours_tell_fault_detection_and_false_alarm(puma_scene):
    model, parts = puma_scene.model, {part.joint for part in looks.PUMA560} - {None}
    assert parts == set(range(6)), "every joint can show its state"
    plain = model.geom_rgba.copy()
    for tick, states in ((0, {}), (12, {2: FAULT}), (20, {2: DETECTED}), (31, {2: ALARM}), (38, {0: ALARM})):
        puma_scene.show(tick)
        expected = plain.copy()
        for number, part in enumerate(looks.PUMA560):
            if part.joint in states:
                expected[model.geom(f"jaxftc_part{number}").id] = scene.COLOURS[states[part.joint]]
        np.testing.assert_allclose(model.geom_rgba, expected, atol=1e-6, err_msg=f"tick {tick}")


def test_colours_are_those_of_the_reports_and_all_different():
    hexes = {state: "#" + "".join(f"{round(255 * c):02X}" for c in colour[:3]) for state, colour in scene.COLOURS.items()}
    assert len(set(hexes.values())) == 3 and set(hexes.values()) <= set(COLOURS)


def test_an_arm_without_shapes_gets_capsules_from_joint_to_joint(tmp_path):
    for hand, whole in ((TOOL, True), (TOOL + COLLISION, True), (TOOL + BOX, False)):
        source = tmp_path / "arm.xml"
        source.write_text(BARE.format(hand=hand))
        robot = jaxftc.load_robot(source)
        model, tinted = stage.build(robot)
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        names = [model.geom(g).name for g in range(model.ngeom)]
        capsules = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE)
        ends = [
            [data.geom_xpos[g] + s * model.geom_size[g, 1] * data.geom_xmat[g].reshape(3, 3)[:, 2] for s in (-1, 1)]
            for g in capsules
        ]
        shoulder, elbow, tool = *data.xanchor, data.site("tool").xpos
        wanted = [(np.zeros(3), shoulder), (shoulder, elbow), (elbow, tool)] if whole else [(shoulder, elbow)]
        np.testing.assert_allclose(np.sort(ends, axis=1), np.sort(wanted, axis=1), atol=1e-9)
        if whole:
            assert [len(geoms) for geoms in tinted] == [1, 1], "a drum a joint"
        else:
            assert tinted[1].tolist() == [names.index("hand")], "the arm's own shape takes the colour"
        assert not model.geom_contype[[n.startswith("jaxftc_") for n in names]].any()


def test_a_urdf_without_shapes_is_drawn_too(tmp_path):
    text = """<robot name="lamp"><link name="base"/><link name="arm"><inertial><mass value="1"/>
      <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="hinge" type="continuous"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.3"/>
      <axis xyz="0 1 0"/></joint></robot>"""
    (tmp_path / "lamp.urdf").write_text(text)
    robot = jaxftc.load_robot(tmp_path / "lamp.urdf")
    model, tinted = stage.build(robot)
    assert (model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE).sum() == 1 and len(tinted[0]) == 1


def test_an_own_floor_light_and_background_are_kept(tmp_path):
    own = """<mujoco><asset><texture type="skybox" builtin="flat" width="8" height="8"/></asset><worldbody>
      <light pos="0 0 2"/><geom type="plane" size="1 1 1"/>"""
    (tmp_path / "arm.xml").write_text(BARE.format(hand=BOX).replace("<mujoco><worldbody>", own))
    robot = jaxftc.load_robot(tmp_path / "arm.xml")
    model = stage.build(robot).model
    assert model.nlight == model.ntex == 1 and (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).sum() == 1
    assert mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, stage.FLOOR) == -1


def test_the_joints_of_another_arm_are_refused(trace, tmp_path):
    (tmp_path / "arm.xml").write_text(BARE.format(hand=BOX))
    with refuses("the trace is of joints joint1, joint2", "robot arm has shoulder, elbow", "--robot FILE"):
        scene.Scene(jaxftc.load_robot(tmp_path / "arm.xml"), replay.read(trace))


def test_the_camera_has_the_whole_motion_in_its_part_of_the_picture(puma_scene):
    for aspect, left in ((4 / 3, 0.0), (4 / 3, 0.34), (16 / 9, 0.34), (0.6, 0.2)):
        camera = puma_scene.camera(aspect, left)
        axes = scene._axes(camera.azimuth, camera.elevation)
        for tick in range(0, TICKS, 5):
            puma_scene.show(tick)
            seen = (puma_scene.data.geom_xpos[puma_scene.model.geom_bodyid > 0] - camera.lookat) @ axes
            depth = (seen[:, 2] + camera.distance) * np.tan(np.deg2rad(puma_scene.model.vis.global_.fovy) / 2)
            across, up = seen[:, 0] / (aspect * depth), seen[:, 1] / depth
            assert (np.abs(up) < 1).all() and (across < 1).all() and (across > 2 * left - 1).all()


# --- films ---


def test_frames_keep_the_speed(trace):
    found = replay.read(trace)
    assert film.ticks(found, ".mp4", 0.25, 25).tolist() == list(range(0, 39, 2))
    assert len(film.ticks(found, ".gif", 1.0, 10)) == 2 and film.ticks(found, ".gif", 1.0, 10).tolist() == [0, 20]
    with refuses("speed must be a positive number, got 0"):
        film.ticks(found, ".mp4", 0.0, 30)
    with refuses("more than the 600 of a .gif", "raise the speed"):
        film.ticks(found, ".gif", 0.001, 30)


@pytest.mark.parametrize(
    ("path", "width", "height", "fps", "message"),
    [
        ("film.avi", 640, 480, 30.0, "a video must be a .mp4, .gif or .png file, got film.avi"),
        ("film", 640, 480, 30.0, "a video must be a .mp4, .gif or .png file, got film"),
        ("none/film.mp4", 640, 480, 30.0, "cannot write none/film.mp4: no folder none"),
        ("film.mp4", 641, 480, 30.0, "width of an mp4 must be even, got 641"),
        ("film.png", 640, 63, 30.0, "height must lie in 64 to 4096 pixels, got 63"),
        ("film.mp4", 640, 480, 0.5, "fps must lie in 1 to 240 for .mp4, got 0.5"),
        ("film.gif", 640, 480, 60.0, "fps must lie in 1 to 50 for .gif, got 60"),
        ("film.mp4", 640, 480, float("nan"), "fps must lie in 1 to 240 for .mp4, got nan"),
    ],
)
def test_files_that_cannot_be_are_refused(path, width, height, fps, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with refuses(message):
        film.check(Path(path), width, height, fps)


def test_a_folder_is_no_film(tmp_path):
    (tmp_path / "a.png").mkdir()
    with refuses("a.png: it is a folder"):
        film.check(tmp_path / "a.png", 640, 480, 30.0)


def test_what_is_not_installed_is_named(tmp_path, monkeypatch):
    spec = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name in ("av", "PIL") else spec(name))
    with refuses("writing .mp4 needs PyAV and Pillow; pip install 'jaxftc[view]'"):
        film.check(tmp_path / "film.mp4", 640, 480, 30.0)
    with refuses("writing .gif needs Pillow; pip install"):
        film.check(tmp_path / "film.gif", 640, 480, 30.0)


def test_an_interrupted_film_leaves_nothing(tmp_path):
    def frames():
        from PIL import Image

        yield Image.new("RGB", (64, 64))
        raise KeyboardInterrupt

    for name in ("film.mp4", "film.gif", "picture.png"):
        with pytest.raises(KeyboardInterrupt):
            film.write(tmp_path / name, frames(), 30.0)
    assert not list(tmp_path.iterdir())


def view(*arguments: str) -> None:
    """The command, with what it raises."""
    parse(["view", *arguments]).run()


def test_mp4_plays_in_browsers(trace, backend, tmp_path, capsys):
    import av

    path = tmp_path / "film.mp4"
    view(
        str(trace.parent),
        "--video",
        str(path),
        "--width",
        "320",
        "--height",
        "240",
        "--fps",
        "25",
        "--speed",
        "0.5",
        "--json",
    )
    told = json.loads(capsys.readouterr().out)
    assert told == {"video": str(path), "frames": 10, "width": 320, "height": 240, "seconds": 0.4}
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height, stream.average_rate) == (320, 240, 25)
        assert sum(1 for _ in container.decode(video=0)) == 10
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat"), "it starts to play before it has all come"
    assert not list(tmp_path.glob(f"*{SUFFIX}"))


def test_gif_keeps_its_length_and_its_colours(trace, backend, tmp_path, capsys):
    from PIL import Image

    path = tmp_path / "film.gif"
    view(str(trace), "--video", str(path), "--width", "160", "--height", "120", "--fps", "30", "--speed", "0.4")
    assert capsys.readouterr().out == f"Written: {path}\n"
    lengths, shades = [], set()
    with Image.open(path) as gif:
        assert gif.size == (160, 120) and gif.info["loop"] == 0
        for frame in range(gif.n_frames):
            gif.seek(frame)
            lengths.append(gif.info["duration"])
            shades |= {state for state in scene.COLOURS if has(np.asarray(gif.convert("RGB")), state, 0)}
    assert len(lengths) == 15 and sum(lengths) == pytest.approx(1e3 * 15 / 30, abs=10)
    assert shades == set(scene.COLOURS)
    assert path.stat().st_size < 200_000


def has(pixels: np.ndarray, state: int, tolerance: int = 12) -> bool:
    """Whether a picture has the colour of a state, as it is in the legend."""
    distance = np.abs(pixels.astype(int) - np.round(255 * np.array(scene.COLOURS[state][:3]))).max(-1)
    return bool((distance <= tolerance).sum() > 8)


def test_png_shows_the_moment_asked_for(trace, backend, tmp_path, capsys):
    from PIL import Image

    told, pictures = [], []
    for name, more in (("a", []), ("b", ["--at", "0.0601"]), ("c", ["--at", "0.0601", "--no-ghost"])):
        size = ["--width", "480", "--height", "360"]
        view(str(trace), "--video", str(tmp_path / f"{name}.PNG"), *size, *more, "--json")
        told.append(json.loads(capsys.readouterr().out))
        with Image.open(tmp_path / f"{name}.PNG") as picture:
            assert picture.format == "PNG" and picture.size == (480, 360) and picture.mode == "RGB"
            pictures.append(np.asarray(picture))
    assert [t["at_s"] for t in told] == pytest.approx([15 * DT + replay.SETTLE, 12 * DT, 12 * DT])
    assert told[0]["frames"] == 1
    arm = [picture[40:300, 240:] for picture in pictures]
    assert reddish(arm[1]) > 40 and bluish(arm[1]) == 0, "fault, not found"
    assert bluish(arm[0]) > 40 and reddish(arm[0]) == 0, "found"
    assert (arm[1] != arm[2]).any(-1).sum() > 30, "the ghost"
    assert (pictures[0].reshape(-1, 3).mean(0) > 200).all(), "light enough for a white page"


def reddish(pixels: np.ndarray) -> int:
    r, g, b = np.moveaxis(pixels.astype(int), -1, 0)
    return int(((r - b > 90) & (r - g > 60)).sum())


def bluish(pixels: np.ndarray) -> int:
    r, _, b = np.moveaxis(pixels.astype(int), -1, 0)
    return int((b - r > 80).sum())


# --- the command's doors ---


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["none"], "jaxftc: no trace at none; give a folder that `jaxftc simulate` wrote"),
        ([".", "--video", "film.avi"], "jaxftc: a video must be a .mp4, .gif or .png file, got film.avi"),
        ([".", "--video", "film.mp4", "--at", "1"], "jaxftc: --at does nothing for a .mp4; leave it out"),
        ([".", "--video", "film.gif", "--at", "1"], "jaxftc: --at does nothing for a .gif; leave it out"),
        ([".", "--video", "a.png", "--speed", "1"], "jaxftc: --speed does nothing for a .png; leave it out"),
        ([".", "--video", "a.png", "--fps", "10"], "jaxftc: --fps does nothing for a .png; leave it out"),
        ([".", "--width", "320"], "jaxftc: --width does nothing in the window; it is for --video; leave it out"),
        ([".", "--json"], "jaxftc: --json does nothing in the window; it is for --video; leave it out"),
        ([".", "--video", "a.png", "--at", "9"], "jaxftc: --at must lie in the run, 0 to 0.195 s, got 9"),
        ([".", "--video", "a.mp4", "--speed", "-1"], "jaxftc: speed must be a positive number, got -1"),
        ([".", "--speed", "nan"], "jaxftc: speed must be a positive number, got nan"),
        ([".", "--video", "a.png", "--robot", "no.xml"], "jaxftc: no robot file at no.xml"),
        ([".", "--video", "a.png", "--robot", "arm.xml"], "jaxftc: the trace is of joints joint1, joint2"),
    ],
)
def test_refusals_are_one_line(arguments, line, tmp_path, monkeypatch, capsys, no_drawing):
    monkeypatch.chdir(tmp_path)
    stored(tmp_path)
    Path("arm.xml").write_text(BARE.format(hand=BOX))
    with pytest.raises(SystemExit) as stop:
        main(["view", *arguments])
    err = capsys.readouterr().err
    assert stop.value.code == 2 and err.startswith(line) and err.count("\n") == 1
    assert {path.name for path in tmp_path.iterdir()} == {"trace.parquet", "arm.xml"}


def test_the_arm_of_a_file_is_drawn(tmp_path, backend, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("arm.xml").write_text(BARE.format(hand=TOOL))
    stored(tmp_path, run(2), ("shoulder", "elbow"))
    view(".", "--video", "arm.png", "--robot", "arm.xml", "--at", "0.06", "--width", "320", "--height", "240")
    from PIL import Image

    with Image.open("arm.png") as picture:
        assert reddish(np.asarray(picture)[20:200, 160:]) > 40


def test_every_option_has_a_default_and_a_line_of_help():
    options = {field.name: field.default for field in dataclasses.fields(View) if field.name != "source"}
    given = parse(["view", "folder"])
    assert {name: getattr(given, name) for name in options} == options
    every = ["--video", "a.gif", "--robot", "arm.xml", "--speed", "2", "--no-ghost", "--fps", "10", "--at", "0.1"]
    given = parse(["view", "folder", *every, "--width", "100", "--height", "90", "--json"])
    assert dataclasses.astuple(given) == (
        Path("folder"),
        Path("a.gif"),
        "arm.xml",
        None,
        (),
        2.0,
        False,
        10.0,
        0.1,
        100,
        90,
        True,
    )


# --- screens ---


@pytest.fixture
def fresh_backend(monkeypatch):
    """``backend`` with nothing remembered, and no process started: what each backend says is in the dict."""
    answers = dict.fromkeys(("egl", "osmesa", "glfw", "cgl"), "no library")
    monkeypatch.setattr(offscreen, "_try", lambda name: answers[name])
    monkeypatch.setattr(offscreen.sys, "platform", "linux")
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    return answers, offscreen.backend.__wrapped__


def test_egl_comes_first_and_osmesa_where_it_does_not_work(fresh_backend, monkeypatch):
    answers, choose = fresh_backend
    answers["osmesa"] = None
    assert choose() == "osmesa"
    answers["egl"] = None
    assert choose() == "egl"
    monkeypatch.setenv("MUJOCO_GL", "OSMesa")
    assert choose() == "osmesa"


def test_without_opengl_it_says_what_to_install(fresh_backend, monkeypatch):
    answers, choose = fresh_backend
    with refuses("no OpenGL to draw with", "egl: no library", "osmesa: no library", "install libegl1", "libosmesa6"):
        choose()
    answers["egl"] = None
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    with refuses("the one that MUJOCO_GL=osmesa asks for (osmesa: no library)"):
        choose()
    monkeypatch.setenv("MUJOCO_GL", "off")
    with refuses("MUJOCO_GL=off switches drawing off; unset it"):
        choose()


def test_a_backend_is_tried_in_a_process_of_its_own(monkeypatch):
    monkeypatch.setattr(offscreen, "_PROBE", "import sys; print('one'); sys.exit('{0}: no library')")
    assert offscreen._try("egl") == "egl: no library"
    monkeypatch.setattr(offscreen, "_PROBE", "import os; os.abort()  # {0}")
    assert offscreen._try("egl") == "exit code -6"
    monkeypatch.setattr(offscreen, "_PROBE", "pass  # {0}")
    assert offscreen._try("egl") is None


def test_without_a_screen_the_window_says_to_use_video(puma_scene, monkeypatch):
    monkeypatch.setattr(window.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with refuses("there is no screen to open a window on", "--video FILE.mp4"):
        window.show(puma_scene, 0.25)
    if platform.system() == "Linux":
        monkeypatch.setenv("DISPLAY", ":9876")
        with refuses("no window can be opened", "DISPLAY=:9876", "--video FILE.mp4"):
            window.show(puma_scene, 0.25)


class Handle:
    """What the window needs of MuJoCo's handle, for a number of frames."""

    def __init__(self, model, frames: int) -> None:
        self.cam, self.opt, self.user_scn = mujoco.MjvCamera(), mujoco.MjvOption(), mujoco.MjvScene(model, maxgeom=200)
        self.left, self.frames, self.texts = frames, [], []

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        return None

    lock = lambda self: self  # noqa: E731

    def is_running(self) -> bool:
        self.left -= 1
        return self.left >= 0

    def set_texts(self, texts) -> None:
        self.texts.append(texts[3])

    def sync(self) -> None:
        self.frames.append(self.user_scn.ngeom)


def test_the_window_replays_with_ghost_and_text(puma_scene, monkeypatch):
    from mujoco import viewer

    handle, times = Handle(puma_scene.model, 6), iter(np.arange(6) * 0.1)
    monkeypatch.setattr(window, "_check_screen", lambda: None)
    monkeypatch.setattr(viewer, "launch_passive", lambda *args, **kwargs: handle)
    monkeypatch.setattr(window.time, "perf_counter", lambda: next(times))
    monkeypatch.setattr(window.time, "sleep", lambda seconds: None)
    window.show(puma_scene, 0.25)
    assert [text.split()[0] for text in handle.texts] == ["0.000", "0.025", "0.050", "0.075", "0.100", "0.125"]
    assert "fault actuator, verdict none" in handle.texts[2] and "fault actuator, verdict actuator" in handle.texts[4]
    assert [n > 0 for n in handle.frames] == [False, False, True, True, True, True]
    assert handle.cam.distance == puma_scene.camera(4 / 3).distance


def test_the_clock_slows_stops_and_starts_again(puma_scene):
    clock = window.Clock(puma_scene, 0.1)
    assert [clock.tick(now) for now in (5.0, 5.5, 6.0)] == [0, 10, 20]
    clock.key(window.SPACE)
    assert clock.tick(7.0) == 20
    clock.key(ord("A"))
    clock.key(window.SPACE)
    assert [clock.tick(now) for now in (7.1, 8.0, 8.5, 9.0)] == [22, 39, 39, 0]


def test_a_viewer_that_does_not_start_says_what_to_do(puma_scene, monkeypatch):
    from mujoco import viewer

    def no_main_thread(*args, **kwargs):
        raise RuntimeError("must be run under mjpython on macOS")

    monkeypatch.setattr(window, "_check_screen", lambda: None)
    monkeypatch.setattr(viewer, "launch_passive", no_main_thread)
    with refuses("the viewer does not start: must be run under mjpython", "--video FILE.mp4"):
        window.show(puma_scene, 0.25)
