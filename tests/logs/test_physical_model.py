"""The physical model from logs: MuJoCo C's torques for a small arm, with friction and motor inertia that its file lacks."""

import json
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small_logs
from jax.test_util import check_grads

import jaxftc
from jaxftc import identify, load_robot, logs
from jaxftc.cli.main import main
from jaxftc.identify import consistent, derivatives
from jaxftc.identify.linear_torque import from_link, inverse, to_link
from jaxftc.robot.dynamics import inverse_dynamics


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("arm")


@pytest.fixture(scope="module")
def arm(folder):
    return small_logs.robot(folder)


def heavier(arm):
    """The arm with another payload at its last link: what the logs are of, and the file is not."""
    last = arm.links[-1]
    more = to_link(last, from_link(last) + 0.6 * np.array([1, 0.3, 0, 0.02, 0.001, 0.09, 0.09, 0, -0.006, 0]))
    return arm.replace(links=(*arm.links[:-1], more))


@pytest.fixture(scope="module")
def recorded(arm, folder):
    """Three logs of the heavier arm, and a fourth of another motion."""
    true = heavier(arm)
    paths = [small_logs.write(folder / f"log{k}.csv", small_logs.table(true, 12.0, seed=k)) for k in range(4)]
    return paths, [logs.read(path, arm) for path in paths]


@pytest.fixture(scope="module")
def found(arm, recorded):
    return identify.dynamics(arm, recorded[1][:3])


def test_the_regressor_times_the_parameters_is_the_inverse_dynamics(arm):
    q, qd, qdd = np.random.default_rng(0).uniform(-1, 1, (3, 50, 3))
    y = identify.regressor(arm, q, qd, qdd)
    theta = np.concatenate([from_link(link) for link in arm.links])
    with jax.enable_x64(True):
        whole = inverse_dynamics(arm, *(jnp.asarray(x.T) for x in (q, qd, qdd)))
    np.testing.assert_allclose(y @ theta, np.asarray(whole).T, atol=1e-9)
    np.testing.assert_allclose(inverse(arm, q, qd, qdd), y @ theta, atol=1e-9)


def test_the_torque_is_differentiable_in_links_and_motion(arm):
    with jax.enable_x64(True):
        q, qd, qdd = jnp.asarray(np.random.default_rng(1).uniform(-1, 1, (3, 3)))
        theta = jnp.stack([jnp.asarray(from_link(link)) for link in arm.links])
        check_grads(lambda *at: identify.link_torque(arm, *at), (theta, q, qd, qdd), order=1)


def test_a_link_goes_to_its_parameters_and_back(arm):
    link = arm.links[1]
    back = to_link(link, from_link(link))
    assert back.mass == link.mass
    np.testing.assert_array_equal(back.inertia, link.inertia)
    j = consistent.pseudo_inertia(from_link(link))
    np.testing.assert_allclose(consistent.from_pseudo_inertia(j), from_link(link), atol=1e-15)


def test_what_the_file_lacks_is_found(arm, found):
    np.testing.assert_allclose(found.robot.coulomb_positive, small_logs.COULOMB, rtol=0.1)
    np.testing.assert_allclose(found.robot.coulomb_negative, small_logs.COULOMB, rtol=0.1)
    np.testing.assert_allclose(found.robot.damping, small_logs.VISCOUS, rtol=0.1)
    np.testing.assert_allclose(found.offset, small_logs.OFFSET, atol=0.15)
    assert found.held_out.share_after < 0.02 < 0.2 < found.held_out.share_before


def test_other_motions_are_explained_to_the_noise(arm, found, recorded):
    held = identify.judge(found.robot, recorded[1][3], offset=found.offset)
    np.testing.assert_allclose(held.after, 0.05, rtol=0.3)  # N m, the noise that was put in
    assert identify.judge(arm, recorded[1][3]).share_after > 10 * held.share_after


def test_links_stay_bodies_and_the_mass_matrix_positive(found):
    for link in found.robot.links:
        assert consistent.margin(from_link(link), 0.3) > 0


def test_what_the_motions_do_not_show_stays(arm, recorded):
    """The first link turns about the vertical: of its ten parameters only one moves a torque. A held joint shows nothing."""
    told = []
    model = identify.dynamics(arm, recorded[1][:3], tell=told.extend)
    left = {(p.name, p.joint) for p in model.parameters if p.status == "left"}
    assert {("mass", 1), ("mx", 1), ("mz", 1), ("ixx", 1)} <= left & set(told)
    before, after = arm.links[0], model.robot.links[0]
    assert (after.mass, *after.moment) == (before.mass, *before.moment)
    table = small_logs.table(arm, 8.0)
    q = np.stack([table[f"q{j}"] for j in (1, 2, 3)], 1)
    q[:, 2] = 0.5
    still = logs.Log(q, np.zeros_like(q), dt=0.01)
    model = identify.dynamics(
        arm, still._replace(tau=1e-3 * np.random.default_rng(0).standard_normal(q.shape)), tell=told.extend
    )
    assert np.isfinite(model.held_out.after).all()


def test_of_one_direction_friction_is_found_and_no_offset(arm):
    """Both push alike; that of a sensor is small, and it would be taken for the torque of a joint that stands."""
    rng, found = np.random.default_rng(5), []
    for speed in (0.02, 0.05, 0.1):
        t = 0.01 * np.arange(1500)
        q = np.outer(speed * t, [1, 0, 0]) + np.array([0.0, -0.6, 0.9])
        qd = np.tile([speed, 0, 0], (1500, 1))
        tau = small_logs.torque(arm, q, qd, 0 * q) - small_logs.OFFSET + 0.1 * rng.standard_normal(q.shape)
        tau[:, 0] = 3.0 + 0.1 * rng.standard_normal(1500)
        found.append(logs.Log(q + 1e-6 * rng.standard_normal(q.shape), tau, dt=0.01))
    model = identify.dynamics(arm, found)
    assert model.offset[0] == pytest.approx(0, abs=0.01)
    assert model.robot.coulomb_positive[0] == pytest.approx(3, rel=0.1) and model.robot.coulomb_speed <= 0.02
    left = {(p.name, p.joint) for p in model.parameters if p.status == "left"}
    assert ("offset", 1) in left


def test_poor_logs_do_not_make_the_model_worse(arm):
    """Two seconds of one joint, in noise: plain least squares would throw the other parameters anywhere."""
    _, q, qd, qdd = small_logs.motion(3, 100, 7)
    q = np.stack([q[:, 0], np.full(300, -0.6), np.full(300, 0.9)], 1)
    qd, qdd = qd * [1, 0, 0], qdd * [1, 0, 0]
    tau = inverse(arm, q, qd, qdd) + 0.3 * np.random.default_rng(0).standard_normal(q.shape)
    model = identify.dynamics(arm, logs.Log(q, tau, dt=0.01))
    assert model.held_out.share_after <= model.held_out.share_before
    _, q, qd, qdd = small_logs.motion(6, 100, 8)
    other = logs.Log(q, inverse(arm, q, qd, qdd), dt=0.01)
    assert identify.judge(model.robot, other, offset=model.offset).share_after < 0.25


def test_an_exact_file_is_kept(arm):
    _, q, qd, qdd = small_logs.motion(6, 100, 9)
    model = identify.dynamics(arm, logs.Log(q, inverse(arm, q, qd, qdd), dt=0.01))
    assert model.held_out.share_after <= model.held_out.share_before < 0.05


def test_the_gain_of_currents_is_found(arm, folder):
    constant = np.array([8.0, 9.0, 7.0])
    table = small_logs.table(arm, 12.0, seed=3)
    amperes = {f"current_{j + 1}": table[f"tau{j + 1}"] / constant[j] for j in range(3)}
    path = small_logs.write(folder / "amperes.csv", {k: v for k, v in table.items() if k[:3] != "tau"} | amperes)
    log = logs.read(path, arm)
    assert log.unit == "A"
    model = identify.dynamics(arm, log)
    np.testing.assert_allclose(model.gain[1:], constant[1:], rtol=0.1)  # the first carries no weight: a guess
    assert model.held_out.share_after < 0.05
    with pytest.raises(ValueError, match="give torque_per_ampere"):
        identify.judge(arm, log)
    config = jaxftc.Config(arm, dt=log.dt, t_final=log.dt, engine="chain")
    with pytest.raises(ValueError, match=r"the log has torques in A, .* or torque_per_ampere"):
        logs.diagnose(config, jaxftc.default_gains(config), log)


def test_stretches_are_taken_one_by_one(arm):
    _, q, qd, qdd = small_logs.motion(6, 100, 2)
    keep = np.r_[0:250, 330:600]
    cut = logs.Log(q[keep], np.zeros((520, 3)), dt=0.01, segments=((0, 250), (250, 520)))
    m = identify.motion(cut)
    np.testing.assert_allclose(m.qd[m.inside], qd[keep][m.inside], atol=0.02)
    np.testing.assert_allclose(m.qdd[m.inside], qdd[keep][m.inside], atol=0.3)


def test_the_encoder_is_seen(arm):
    q = small_logs.motion(10, 100, 4)[1]
    count = 2 * np.pi / 4096
    resolution, _ = identify.encoder([logs.Log(count * np.round(q / count), q, dt=0.01)])
    np.testing.assert_allclose(resolution, count, rtol=1e-6)
    noisy = q + 1e-4 * np.random.default_rng(0).standard_normal(q.shape)
    np.testing.assert_allclose(identify.encoder([logs.Log(noisy, q, dt=0.01)])[1], 1e-4, rtol=0.3)


def test_logs_that_cannot_be_fitted_are_refused(arm):
    q = np.zeros((200, 3))
    for log, words in (
        (logs.Log(q, np.full_like(q, np.nan), dt=0.01), "log 1 has no torques"),
        (logs.Log(q, q), "log 1 has no sample time; give it"),
        (
            logs.Log(np.where(np.arange(200)[:, None] == 7, np.nan, q), q, dt=0.01),
            "log 1: q is not finite at tick 7 of joint 1",
        ),
        (logs.Log(q[:, :2], q[:, :2], dt=0.01), r"log 1 must have q and tau of \[T, 3\]"),
        ([], "at least one log is needed"),
    ):
        with pytest.raises(ValueError, match=words):
            identify.dynamics(arm, log)


def run(capsys, *words):
    main([str(word) for word in words])
    return json.loads(capsys.readouterr().out)


def test_the_command_writes_an_arm_that_explains_other_logs(arm, folder, recorded, capsys, tmp_path):
    paths, words = recorded[0], ("--json", "--no-compilation-cache")
    out = tmp_path / "arm"
    made = run(capsys, "identify", *paths[:3], "--robot", folder / "small.urdf", "--out", out, *words)
    assert made["sample_time_s"] == 0.01 and made["held_out"]["share_after"] < 0.02 < made["held_out"]["share_before"]
    assert len(made["held_out"]["torque_rms_nm"]) == len(made["held_out"]["after_rms_nm"]) == 3
    assert {"name", "joint", "unit", "before", "after", "status"} <= made["parameters"][0].keys()
    assert json.loads((out / "result.json").read_text()) == made
    page = (out / "report.html").read_text()
    assert "Friction over speed" in page and "Torque, recorded and modelled" in page
    table = tomllib.loads((out / "arm.toml").read_text())
    assert table["log"]["sample_time_s"] == 0.01 and "pan" in table["joints"]
    assert load_robot(out).coulomb_positive[0] == pytest.approx(3.0, rel=0.1)
    judged = run(capsys, "identify", paths[3], "--robot", out, "--judge", "--out", tmp_path / "judge", *words)
    held = judged["held_out"]
    np.testing.assert_allclose(held["after_rms_nm"], 0.05, rtol=0.3)
    assert held["share_before"] == held["share_after"] and judged["parameters"] == []
    assert not (tmp_path / "judge" / "arm.toml").exists()


def test_what_the_command_refuses_is_one_line(folder, capsys, tmp_path):
    for words, said in (
        ((), "give at least one log"),
        ((folder / "nope.csv",), "there is no such file"),
        ((folder / "log0.csv", "--columns", "q1"), "--columns takes pairs such as q1=position_1"),
    ):
        with pytest.raises(SystemExit) as left:
            main(["identify", *map(str, words), "--robot", str(folder / "small.urdf"), "--out", str(tmp_path / "x")])
        assert left.value.code == 2 and said in capsys.readouterr().err


@pytest.mark.parametrize("rows", [1000, 6000])  # shorter and longer than the spectrum is made of
def test_the_band_of_a_fast_joint_and_of_one_at_rest_are_the_limits_in_short_logs_too(rows):
    t, noise = 1e-3 * np.arange(rows), 1e-5 * np.random.default_rng(3).standard_normal((rows, 2))
    q = np.stack([np.sin(2 * np.pi * 20.0 * t), np.zeros(rows)], axis=1) + noise
    found = derivatives.band(logs.Log(q, np.zeros_like(q), dt=1e-3))
    np.testing.assert_array_equal(found, [derivatives.RIGID, derivatives.LOWEST])
