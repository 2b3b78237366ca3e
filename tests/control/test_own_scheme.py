"""Schemes of a user's own: found by name, with gains of their own, in every place where the package's are."""

import dataclasses
import json
import os
import subprocess
import sys
import types
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
import tuning
from benchmarks.arms import serial
from jaxftc import variants
from jaxftc.campaigns import store
from jaxftc.robot.model_file import compile_robot

FOLDER = Path(__file__).parents[2] / "docs" / "schemes"
START = np.array([0.3, -0.2])


@pytest.fixture(scope="module", autouse=True)
def on_the_path():
    sys.path.insert(0, str(FOLDER))
    yield
    sys.path.remove(str(FOLDER))


@pytest.fixture(scope="module")
def base():
    return jaxftc.Config(compile_robot("two", serial(2)), engine="chain", duration=0.3)


@pytest.fixture(scope="module")
def pd(base):
    return dataclasses.replace(base, scheme="pd_gravity")


@pytest.fixture(scope="module")
def observer(base):
    return dataclasses.replace(base, scheme="disturbance_observer")


def test_the_examples_are_short():
    for path in FOLDER.glob("*.py"):
        assert len(path.read_text().splitlines()) < 60, path


def test_a_scheme_goes_by_a_name_that_finds_it_again(base):
    import delayed
    import pd_gravity

    for given, name in ((pd_gravity, "pd_gravity"), ("delayed:pd_1", "delayed:pd_1"), ("pd_gravity", "pd_gravity")):
        config = dataclasses.replace(base, scheme=given)
        assert config.scheme == name and variants.load(name) in (pd_gravity, delayed.pd_1)
    assert dataclasses.replace(base, scheme=pd_gravity) == dataclasses.replace(base, scheme="pd_gravity")


def test_what_is_no_scheme_is_refused_in_one_line(base, monkeypatch):
    half = types.ModuleType("half")
    half.init, half.State = print, tuple
    half.Unhashable = types.SimpleNamespace(**dict.fromkeys(variants.CONTRACT), __module__="half")
    monkeypatch.setitem(sys.modules, "half", half)
    for name, message in (
        ("half", r"scheme 'half' lacks step, gains_used, DIAGNOSES; a scheme has State, init, step"),
        ("half:Unhashable", r"must be hashable"),
        ("half:none", r"or module:object, got 'half:none' \(module 'half' has no attribute 'none'\); is its folder on"),
        ("nowhere:PD", r"got 'nowhere:PD' \(No module named 'nowhere'\)"),
        ("momentun", r"did you mean 'momentum'"),
    ):
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(base, scheme=name)
    with pytest.raises(ValueError, match=r"module:object"):
        dataclasses.replace(base, scheme=object())


def test_a_scheme_that_is_defined_anew_is_another(base, monkeypatch):
    """As in a notebook: no program of the old one is run for the new one."""
    notebook = types.ModuleType("notebook")
    monkeypatch.setitem(sys.modules, "notebook", notebook)

    def define(torque):
        import pd_gravity

        class Law:
            State, init, gains_used, GAINS, DIAGNOSES = (
                getattr(pd_gravity, name) for name in ("State", "init", "gains_used", "GAINS", "DIAGNOSES")
            )

            @staticmethod
            def step(config, gains, state, reference, measurement):
                state, out = pd_gravity.step(config, gains, state, reference, measurement)
                return state, out._replace(tau=jnp.full_like(out.tau, torque))

        Law.__module__, Law.__qualname__ = "notebook", "Law"
        notebook.Law = Law
        return dataclasses.replace(base, scheme=Law)

    step = jax.jit(jaxftc.step, static_argnums=0)
    for torque in (1.0, 2.0):
        config = define(torque)
        assert config.scheme == "notebook:Law"
        gains, still = jaxftc.default_gains(config), jnp.zeros(2)
        told = jaxftc.Reference(still, still, still), jaxftc.Measurement(still, still)
        assert step(config, gains, jaxftc.init(config, gains, still), *told)[1].tau[0] == torque


def test_its_gains_are_as_good_as_ours(base, pd, tmp_path):
    gains = jaxftc.default_gains(pd)
    np.testing.assert_array_equal(gains.own.kp, [1000.0, 1000.0])
    assert gains.replace({"own.kd": 30.0}).own.kd[1] == 30.0
    with pytest.raises(ValueError, match=r"did you mean 'baseline.kp' or 'own.kp'"):
        gains.replace({"kp": 30.0})
    with pytest.raises(ValueError, match=r"own.weight must lie in \(0, 1\], got"):
        jaxftc.simulate(pd, gains.replace({"own.weight": 2.0}), jaxftc.healthy_scenario(pd), jax.random.key(0))
    with pytest.raises(ValueError, match=r"gains.own.*'pd_gravity'.*NoneType.*default_gains"):
        jaxftc.init(pd, jaxftc.default_gains(base), START)
    assert "on the angle's error" in type(gains.own).__doc__

    file = tmp_path / "gains.toml"
    jaxftc.save_gains(file, gains.replace({"own.kp": [900.0, 50.0], "control.lam": 7.0}), pd)
    assert 'unit = "N m/rad"' in file.read_text() and 'scheme = "pd_gravity"' in file.read_text()
    np.testing.assert_array_equal(jaxftc.load_gains(file, pd).own.kp, [900.0, 50.0])
    others = jaxftc.load_gains(file, base)  # the rest of the file serves every scheme
    assert others.own is None and others.control.lam[0] == 7.0
    ours = tmp_path / "ours.toml"
    jaxftc.save_gains(ours, others, base)
    with pytest.raises(ValueError, match=r"lacks own.kp, own.kd, own.weight"):
        jaxftc.load_gains(ours, pd)
    file.write_text(file.read_text().replace("[own.kp]", "[own.kq]"))
    with pytest.raises(ValueError, match=r"unknown gain 'own.kq'; did you mean 'own.kp'"):
        jaxftc.load_gains(file, pd)


def test_the_observer_finds_a_torque_fault(observer):
    gains = jaxftc.default_gains(observer)
    faulty = jaxftc.healthy_scenario(observer).with_actuator_bias(joint=2, torque=5.0, onset=0.1)
    trace = jaxftc.simulate(observer, gains, faulty, jax.random.key(0))
    np.testing.assert_allclose(trace.out.fault_tau_hat[-1], [0.0, 5.0], atol=0.5)
    assert not np.any(trace.out.verdict[:100]) and list(np.asarray(trace.out.verdict[-1])) == [0, 1]
    assert np.abs(trace.q - trace.q_ref)[-1].max() < 0.01


def test_it_is_run_with_the_tick(observer):
    gains = jaxftc.default_gains(observer)
    tick, step = jaxftc.Tick(observer, gains), jax.jit(jaxftc.step, static_argnums=0)
    packed, plain, tau = tick.init(START), jaxftc.init(observer, gains, START), np.full(2, np.nan)
    wanted = jaxftc.Reference(START + 0.01, np.zeros(2), np.zeros(2))
    for k in range(5):
        told = wanted, jaxftc.Measurement(START + 1e-4 * k if k != 3 else START * np.nan, tau)
        (packed, ours), (plain, theirs) = tick.step(packed, *told), step(observer, gains, plain, *told)
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)
        tau = ours.tau


@pytest.mark.thorough
def test_it_is_tuned(pd):
    """Its own gains and nothing else; a search needs no gradient to be compiled."""
    assert tuning.tunable(pd) == ("own.kp", "own.kd", "own.weight")
    scenarios = jaxftc.sample_scenarios(jax.random.key(0), 8, config=pd)
    settings = tuning.Settings(method="random", steps=2, batch=4, validation=4)
    terms = {"tracking": tuning.OBJECTIVE["tracking"]}
    start = jaxftc.default_gains(pd).replace({"own.kp": 100.0})
    found = tuning.fit(pd, start, scenarios, key=jax.random.key(1), objective=terms, settings=settings)
    assert not np.array_equal(found.gains.own.kp, start.own.kp)
    np.testing.assert_array_equal(found.gains.control.lam, start.control.lam)
    with pytest.raises(ValueError, match=r"'control\.lam' does nothing.*'pd_gravity'"):
        tuning.fit(pd, start, scenarios, key=jax.random.key(1), only=("control.lam",), settings=settings)


def test_a_delay_is_a_scheme_around_another(base):
    config = dataclasses.replace(base, scheme="delayed:pd_2")
    gains, wanted = jaxftc.default_gains(config), jaxftc.Reference(START + 0.1, np.zeros(2), np.zeros(2))
    state = jaxftc.init(config, gains, START)
    held = state.tau
    told = wanted, jaxftc.Measurement(START, held)
    taus = []
    for _ in range(3):
        state, out = jaxftc.step(config, gains, state, *told)
        taus.append(out.tau)
    np.testing.assert_allclose(taus[0], held)
    np.testing.assert_allclose(taus[1], held)
    assert np.abs(taus[2] - held).max() > 10.0


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with the schemes and an arm, and a command line in it whose Python finds nothing there by itself."""
    for path in FOLDER.glob("*.py"):
        (tmp_path / path.name).write_text(path.read_text())
    (tmp_path / "arm.xml").write_text(serial(2))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def call(*words):
    """(exit code, stdout, stderr) of a command in a process of its own, whose Python does not look in its folder."""
    here = os.environ | {"PYTHONPATH": str(Path(jaxftc.__file__).parents[1]), "XDG_CACHE_HOME": os.getcwd()}
    line = "import sys; sys.path = [p for p in sys.path if p]; from jaxftc.cli.main import main; main()"
    done = subprocess.run([sys.executable, "-c", line, *words], capture_output=True, text=True, env=here, check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.slow
def test_campaigns_find_it_in_another_process(here):
    """Compared with one of ours, gone on with, replayed from the folder alone, and refused when its code has changed."""
    run = ["campaign", "--robot", "arm.xml", "--duration", "0.15", "--out", "run", "--scheme", "pd_gravity", "--worst", "0"]
    code, _, error = call(*run, "-n", "4")
    assert code == 0, error
    manifest = store.read_manifest(here / "run")
    assert store.scheme_of(manifest) == "pd_gravity"
    code, text, error = call("simulate", "--from", "run", "--id", "3", "--out", "again", "--json")
    assert code == 0, error
    assert json.loads(text)["same_as_stored"] is True
    with (here / "pd_gravity.py").open("a") as file:
        file.write("\n# changed\n")
    code, _, error = call(*run, "-n", "8")
    assert code == 2 and "holds another campaign: --scheme pd_gravity of content" in error
    code, _, error = call("simulate", "--from", "run", "--id", "3", "--out", "other")
    assert code == 2 and "was run with another scheme_source" in error
    code, _, error = call("campaign", "--robot", "arm.xml", "--scheme", "nowhere:PD", "--out", "none")
    assert code == 2 and error.startswith("jaxftc: scheme must be one of 'cascade'") and "'smc'" in error


@pytest.mark.slow
def test_it_is_compared_calibrated_and_tuned_from_the_command_line(here):
    arm = ("--robot", "arm.xml", "--duration", "0.2")
    code, _, error = call("calibrate", *arm, "--scheme", "disturbance_observer", "--runs", "800", "--out", "thresholds")
    assert code == 0, error
    names = "cascade,disturbance_observer,delayed:pd_1"
    code, text, error = call("campaign", *arm, "-n", "64", "--compare", names, "--false-alarms", "0.05", "--out", "run")
    assert code == 0, error
    assert {path.parent.name for path in here.glob(f"run/*/{store.MANIFEST}")} == {*names.replace(":", ".").split(",")}
    small = ("--steps", "2", "--batch", "4", "--validation", "4", "--held-out", "4", "--gains", "thresholds/gains.toml")
    code, text, error = call("tune", *arm, "--scheme", "disturbance_observer", "--only", "own", *small, "--out", "tuned")
    assert code == 0, error
    moved = text.partition("before -> after")[2]
    assert "own.kp" in moved and "observer.alpha_i" not in moved
    config = jaxftc.Config(jaxftc.load_robot("arm.xml"), engine="chain", scheme="disturbance_observer")
    assert jaxftc.load_gains("tuned/gains.toml", config).own.c[0] > 0


@pytest.mark.slow
def test_it_is_tuned_by_gradients_with_a_delay_of_0_to_3_ticks(base):
    """The commands of the arm that is tuned come late; the gradient goes through the queue of those under way."""
    terms = {"tracking": tuning.OBJECTIVE["tracking"]}
    for scheme in ("pd_gravity", "delayed:pd_1", "delayed:pd_2", "delayed:pd_3"):
        config = dataclasses.replace(base, scheme=scheme)
        start = jaxftc.default_gains(config).replace({"own.kp": 100.0, "own.kd": 20.0})
        scenarios = jaxftc.sample_scenarios(jax.random.key(0), 320, "paper", config=config)
        settings = tuning.Settings(steps=40, batch=8, validation=16, learning_rate=0.2)
        key = jax.random.key(1)
        found = tuning.fit(config, start, scenarios, key=key, objective=terms, settings=settings, only=("own",))
        before, after = found.history["validation"][0], found.history["validation"].min()
        kp, kd = (np.asarray(gain).round(1) for gain in (found.gains.own.kp, found.gains.own.kd))
        print(f"{scheme}: tracking {before:.3f} -> {after:.3f}, kp {kp}, kd {kd}")
        assert after < 0.8 * before
