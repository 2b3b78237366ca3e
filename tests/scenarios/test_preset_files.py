"""Preset files: the format, its errors in one line, what a base gives, and the way back to a file."""
# ruff: noqa: E501  an error is one line, and so it is here

import dataclasses
import importlib.resources
import subprocess
import sys
import tomllib

import jax
import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

import jaxftc
from jaxftc.scenarios.distributions import Choice, Normal, Uniform, extent, quantile
from jaxftc.scenarios.faults import (
    ActuatorFaults,
    AngleBias,
    Drift,
    SensorFaults,
    Share,
    Signed,
    Sized,
    TorqueBias,
    Unsized,
)
from jaxftc.scenarios.preset import Encoder, Incipient, Intermittent, Joints, Motion, PlantLaws, Preset, Shares, Times
from jaxftc.scenarios.preset_file import as_dict, load_preset
from jaxftc.scenarios.presets import PRESET_NAMES

BUILT_IN = importlib.resources.files("jaxftc.scenarios.presets")


@pytest.fixture(scope="module")
def config(puma_config) -> jaxftc.Config:
    return puma_config


@pytest.fixture
def load(tmp_path, monkeypatch):
    """A function from the text of ``my.toml`` to its preset."""
    monkeypatch.chdir(tmp_path)

    def from_text(text: str) -> Preset:
        (tmp_path / "my.toml").write_text(text, encoding="utf-8")
        return load_preset("my.toml")

    return from_text


def base(text: str) -> str:
    return f'base = "standard"\n{text}'


# The format.


def test_the_names_are_the_files_and_paper():
    files = {file.name.removesuffix(".toml") for file in BUILT_IN.iterdir() if file.name.endswith(".toml")}
    assert PRESET_NAMES[0] == "paper" and set(PRESET_NAMES[1:]) == files


def test_names_cost_no_import():
    program = "import sys, jaxftc, jaxftc.scenarios.presets as p; assert p.PRESET_NAMES; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    assert not {"jax", "numpy", "pydantic"} & set(loaded)


@pytest.mark.parametrize("name", PRESET_NAMES[1:])
def test_a_copy_of_a_built_in_file_is_that_preset(load, name):
    copy = load((BUILT_IN / f"{name}.toml").read_text(encoding="utf-8"))
    assert copy == load_preset(name) and hash(copy) == hash(load_preset(name))
    assert load_preset(copy) is copy


def test_what_standard_leaves_as_a_comment_works(load):
    """Every example that standard.toml only mentions."""
    text = (BUILT_IN / "standard.toml").read_text(encoding="utf-8").replace("# allowed", "allowed")
    more = """
[actuator.saturation]
size = { normal = [0.3, 0.1], within = [0.1, 0.5] }
[sensor.dropout]
weight = 0.5
[times.incipient]
share = 0.3
rise_s = { choice = [0.1, 0.2] }
[times.intermittent]
share = 0.2
period_s = 0.1
duty = 0.5
"""
    preset = load(text + more)
    assert preset.joints.allowed == (1, 2, 3)
    assert preset.actuator.saturation == Share(size=Normal((0.3, 0.1), (0.1, 0.5)))
    assert preset.sensor.dropout == Unsized(weight=0.5)
    assert preset.times.incipient == Incipient(0.3, Choice((0.1, 0.2)))
    assert preset.times.intermittent == Intermittent(0.2, 0.1, 0.5)


def test_an_own_file_is_drawn_from(load, config, tmp_path):
    load(base("[shares]\nhealthy = 1\nactuator = 0\nsensor = 0\nboth = 0\n[encoder]\nnoise_rad = 1e-4"))
    for preset in ("my.toml", tmp_path / "my.toml"):
        scenarios = jaxftc.sample_scenarios(jax.random.key(0), 5, preset, config=config)
        assert (np.asarray(scenarios.noise) == 1e-4).all() and (np.asarray(scenarios.fault_q.kind) == 0).all()


def test_encoders_that_read_in_counts_change_no_other_draw(load, config):
    fine = jaxftc.sample_scenarios(jax.random.key(0), 50, "hard", config=config)
    load('base = "hard"\n[encoder]\nresolution_rad = { choice = [1e-5, 1e-4] }')
    coarse = jaxftc.sample_scenarios(jax.random.key(0), 50, "my.toml", config=config)
    assert fine.resolution is None and set(np.asarray(coarse.resolution).astype(np.float32)) == {
        np.float32(1e-5),
        np.float32(1e-4),
    }
    jax.tree.map(np.testing.assert_array_equal, coarse._replace(resolution=None), fine)


def test_commands_take_the_default_gains_for_encoders_that_read_in_counts(load, config):
    from jaxftc.cli import common

    usual = jaxftc.default_gains(config)
    for text, level in {
        "noise_rad = 1e-4": {},
        "resolution_rad = 4e-4": {"noise": 3e-5, "resolution": 4e-4},
        "resolution_rad = { choice = [1e-4, 4e-4] }": {"noise": 3e-5, "resolution": 4e-4},
        "noise_rad = { uniform = [1e-6, 2e-5] }\nresolution_rad = 1e-3": {"noise": 2e-5, "resolution": 1e-3},
    }.items():
        preset = load(f'base = "hard"\n[encoder]\n{text}')
        assert preset.encoder.level == pytest.approx(level)
        gains = common.load_or_default(common.Options(), config, preset=preset)
        assert (gains.observer.jump > usual.observer.jump).all() == bool(level)


def test_the_order_of_tables_does_not_matter(load):
    one = load(base("[sensor.noise]\nsize = 30\n[sensor.bias]\nsize = 1\n[joints]\nat_once = 2"))
    two = load(base("[joints]\nat_once = 2\n[sensor.bias]\nsize = 1\n[sensor.noise]\nsize = 30"))
    assert one == two and hash(one) == hash(two)


def test_defaults(load):
    """What is neither said nor taken from a base: an exact plant, the encoder's noise, abrupt faults on one joint."""
    preset = load(
        "[shares]\nsensor = 1\n[motion]\nstart_deg = 0\ntravel_deg = 90\n[times]\nonset_s = 0.1\npermanent = 1\n"
        "[sensor.bias]\nsize = 2"
    )
    assert preset == Preset(
        shares=Shares(sensor=1.0),
        motion=Motion(0.0, 90.0),
        times=Times(0.1, 1.0),
        sensor=SensorFaults(bias=AngleBias(size=2.0, unit="deg", sign="as_drawn", weight=1.0)),
        encoder=Encoder(3e-5),
        joints=Joints(1, None),
        plant=PlantLaws(1.0, 1.0, 1.0, 1.0, 1.0, 0.0),
    )


# Bases.


def test_a_base_gives_what_is_not_said(load):
    standard = load_preset("standard")
    assert load(base("")) == standard
    preset = load(base("[plant]\nmass = 1.2\n[times]\npermanent = 1\n[shares]\nhealthy = 0.4\nboth = 0"))
    assert preset == dataclasses.replace(
        standard,
        plant=dataclasses.replace(standard.plant, mass=1.2),
        times=dataclasses.replace(standard.times, permanent=1.0),
        shares=Shares(0.4, 0.3, 0.3, 0.0),
    )


def test_the_kinds_of_a_channel_and_laws_are_replaced_as_a_whole(load):
    standard = load_preset("standard")
    preset = load(base("[sensor.dropout]\n[plant]\nmass = { normal = [1.0, 0.01], within = [0.9, 1.1] }"))
    assert preset.sensor == SensorFaults(dropout=Unsized()) and preset.actuator == standard.actuator
    assert preset.sensor_in_both == standard.sensor_in_both
    assert preset.plant.mass == Normal((1.0, 0.01), (0.9, 1.1))


def test_a_base_may_have_a_base(load):
    hard = load_preset("hard")
    preset = load('base = "hard"\n[times.incipient]\nshare = 0')
    assert preset == dataclasses.replace(
        hard, times=dataclasses.replace(hard.times, incipient=Incipient(0.0, hard.times.incipient.rise_s))
    )


def test_the_paper_stands_alone(load):
    assert load('base = "paper"') == load_preset("paper") != load_preset("standard")
    with pytest.raises(ValueError, match=r"^my.toml: joints: base = \"paper\" stands alone"):
        load('base = "paper"\n[joints]\nat_once = 2')
    with pytest.raises(ValueError, match=r"^shares: the paper's conditions draw from no law"):
        dataclasses.replace(load_preset("paper"), shares=Shares(healthy=1.0))


# Errors: one line with the file, the place, what came and what is allowed.


WAYS = "must be a number, { uniform = [low, high] }, { normal = [mean, std] } (also with within = [low, high]) or { choice = [..] }"
ERRORS = {
    # keys
    "[sensor.bais]\nsize = 1": "sensor.bais: unknown key; did you mean 'bias'?",
    "[actuator.bias]\nsize = { unifrom = [0.1, 0.3] }": "actuator.bias.size.unifrom: unknown key; did you mean 'uniform'?",
    "[actuator.bias]\nsize = 1\nweigth = 2": "actuator.bias.weigth: unknown key; did you mean 'weight'?",
    "[shares]\nhealty = 0.5": "shares.healty: unknown key; did you mean 'healthy'?",
    "[times.incipent]\nshare = 0.5": "times.incipent: unknown key; did you mean 'incipient'?",
    "[encoder]\nnoise = 1": "encoder.noise: unknown key; did you mean 'noise_rad'?",
    "[actuator.loss]\nsize = 1\nsign = 'random'": "actuator.loss.sign: unknown key; the keys here are weight, size, unit",
    "[actuator.stuck]\nsize = 1": "actuator.stuck.size: unknown key; the keys here are weight",
    "[sensor]\n'<uniform>' = 3": "sensor.'<uniform>': unknown key; the keys here are bias, drift, freeze, scale, noise, dropout, rounding, wrap, delay, crosstalk",
    '"two\\nlines" = 3': "'two\\nlines': unknown key; the keys here are shares, motion, times, actuator, sensor, "
    "sensor_in_both, encoder, joints, plant, contact, base",
    "[actuator.bias]": "actuator.bias.size: missing; give a number or a law such as { uniform = [low, high] }",
    "[times.incipient]\nshare = 0.6": "times.incipient.rise_s: missing; give it, "
    'or take what is not said from a preset, with base = "standard" on top',
    # laws
    "[actuator.bias]\nsize = { uniform = [0.3, 0.05] }": "actuator.bias.size.uniform: low must be below high, got [0.3, 0.05]",
    "[actuator.bias]\nsize = { uniform = [1, 2, 3] }": "actuator.bias.size.uniform: must be [low, high], got [1.0, 2.0, 3.0]",
    "[actuator.bias]\nsize = { uniform = 3 }": "actuator.bias.size.uniform: must be a list of numbers, got 3",
    "[actuator.bias]\nsize = { uniform = [1, 'x'] }": "actuator.bias.size.uniform[1]: must be a number, got 'x'",
    "[actuator.bias]\nsize = { normal = [1, 0] }": "actuator.bias.size.normal: must be [mean, std] with std above zero, "
    "got [1.0, 0.0]",
    "[plant]\nmass = { normal = [1, 0.1], within = [1.1, 0.9] }": "plant.mass.within: low must be below high, got [1.1, 0.9]",
    "[times]\nonset_s = { choice = [] }": "times.onset_s.choice: must hold at least one number, got []",
    "[actuator.bias]\nsize = { normal = [1, 1], choice = [1] }": "actuator.bias.size.choice: unknown key; "
    "the keys here are normal, within",
    "[actuator.bias]\nsize = 'big'": f"actuator.bias.size: {WAYS}, got 'big'",
    "[actuator.bias]\nsize = true": f"actuator.bias.size: {WAYS}, got True",
    "[actuator.bias]\nsize = {}": f"actuator.bias.size: {WAYS}, got {{}}",
    "[actuator.bias]\nsize = [1, 2]": f"actuator.bias.size: {WAYS}, got [1, 2]",
    "[actuator.bias]\nsize = 2020-01-01": f"actuator.bias.size: {WAYS}, got datetime.date(2020, 1, 1)",
    f"[actuator.bias]\nsize = 1{'0' * 400}": f"actuator.bias.size: {WAYS}, got 1{'0' * 59}...",
    "[motion]\nstart_deg = nan": "motion.start_deg: must be a finite number, got nan",
    "[motion]\ntravel_deg = { uniform = [0, inf] }": "motion.travel_deg.uniform: must be a finite number, got inf",
    # ranges
    "[shares]\nhealthy = 0.5": "shares: must add up to 1, got healthy 0.5 + actuator 0.3 + sensor 0.3 + both 0.2 + contact 0 = 1.3",
    "[shares]\nhealthy = -0.5\nboth = 0.9": "shares.healthy: must stay within 0 and 1, got -0.5",
    "[shares]\nhealthy = { uniform = [0, 1] }": "shares.healthy: must be a number, got {'uniform': [0, 1]}",
    "[actuator.loss]\nsize = 1.2": "actuator.loss.size: must stay within 0 and 1, got 1.2",
    "[actuator.loss]\nsize = { uniform = [0.3, 1.2] }": "actuator.loss.size: must stay within 0 and 1 whatever is drawn, "
    "got { uniform = [0.3, 1.2] }",
    "[actuator.saturation]\nsize = { normal = [0.3, 0.1] }": "actuator.saturation.size: must stay within 0 and 1 whatever is "
    "drawn, got { normal = [0.3, 0.1] }; give the normal law within = [low, high]",
    "[sensor.noise]\nsize = { choice = [-1, 3] }": "sensor.noise.size: must not fall below 0 whatever is drawn, "
    "got { choice = [-1.0, 3.0] }",
    "[sensor.freeze]\nweight = 0": "sensor.freeze.weight: must stay above 0, got 0.0",
    "[encoder]\nnoise_rad = -1e-5": "encoder.noise_rad: must not fall below 0, got -1e-05",
    "[plant]\nmass = { uniform = [0, 1] }": "plant.mass: must stay above 0 whatever is drawn, got { uniform = [0.0, 1.0] }",
    "[plant]\narmature = { normal = [1, 0.1] }": "plant.armature: must stay above 0 whatever is drawn, "
    "got { normal = [1.0, 0.1] }; give the normal law within = [low, high]",
    "[plant]\ntorque_constant = 0": "plant.torque_constant: must stay above 0, got 0.0",
    "[plant]\ndamping = -1": "plant.damping: must not fall below 0, got -1.0",
    "[plant]\npayload_kg = -1": "plant.payload_kg: must not fall below 0, got -1.0",
    "[times]\nonset_s = -1": "times.onset_s: must not fall below 0, got -1.0",
    "[times]\npermanent = 1.5": "times.permanent: must stay within 0 and 1, got 1.5",
    "[times]\nlasting_s = { uniform = [-1, 1] }": "times.lasting_s: must not fall below 0 whatever is drawn, "
    "got { uniform = [-1.0, 1.0] }",
    "[times.incipient]\nshare = 0.5\nrise_s = -1": "times.incipient.rise_s: must not fall below 0, got -1.0",
    "[times.intermittent]\nshare = 0.6\nperiod_s = 0\nduty = 0.5": "times.intermittent.period_s: must stay above 0, got 0.0",
    "[times.intermittent]\nshare = 0.6\nperiod_s = 1\nduty = 1.5": "times.intermittent.duty: must stay within 0 and 1, got 1.5",
    "[times]\nincipient = { share = 0.6, rise_s = 1 }\nintermittent = { share = 0.6, period_s = 1, duty = 1 }": "times: "
    "incipient.share + intermittent.share must be at most 1, got 0.6 + 0.6",
    # texts, joints, tables
    "[actuator.bias]\nsize = 1\nunit = 'Nm'": "actuator.bias.unit: must be one of 'limit', 'N m', got 'Nm'; did you mean 'N m'?",
    "[sensor.drift]\nsize = 1\nunit = 'deg'": "sensor.drift.unit: must be one of 'deg/s', 'rad/s', got 'deg'; "
    "did you mean 'deg/s'?",
    "[sensor.scale]\nsize = 1\nunit = '%'": "sensor.scale.unit: must be one of '1', got '%'",
    "[sensor.bias]\nsize = 1\nunit = 1": "sensor.bias.unit: must be a text, got 1",
    "[sensor.bias]\nsize = 1\nsign = 'randm'": "sensor.bias.sign: must be one of 'as_drawn', 'random', got 'randm'; "
    "did you mean 'random'?",
    "[joints]\nat_once = 0": "joints.at_once: must be an integer of 1 to 1000, got 0; shares.healthy is for runs without a fault",
    "[joints]\nat_once = 1.5": "joints.at_once: must be an integer, got 1.5",
    "[joints]\nat_once = true": "joints.at_once: must be an integer, got True",
    "[joints]\nat_once = 10000000000000000000000": "joints.at_once: must be an integer of 1 to 1000, got 10000000000000000000000; "
    "shares.healthy is for runs without a fault",
    "[joints]\nallowed = [0, 1]": "joints.allowed: must be different joints, counted from 1, got [0, 1]",
    "[joints]\nallowed = [1, 1]": "joints.allowed: must be different joints, counted from 1, got [1, 1]",
    "[joints]\nallowed = []": "joints.allowed: must be different joints, counted from 1, got []",
    "[joints]\nallowed = ['elbow']": "joints.allowed[0]: must be an integer, got 'elbow'",
    "[joints]\nallowed = [1]\nat_once = 2": "joints.at_once: must be at most 1, the number of allowed joints, got 2",
    "shares = 3": "shares: must be a table of healthy, actuator, sensor, both, contact, got 3",
    "[sensor]\nbias = 3": "sensor.bias: must be a table of weight, size, unit, sign, got 3",
    "[actuator]": "actuator: no kind of fault, but 0.5 of all scenarios have one; add a table [actuator.bias]",
    "[sensor_in_both]": "sensor_in_both: no kind of fault, but 0.2 of all scenarios have one; add a table [sensor_in_both.bias]",
}


@pytest.mark.parametrize("text", list(ERRORS))
def test_errors_on_top_of_a_base(load, text):
    with pytest.raises(ValueError) as caught:
        load(base(text))
    assert str(caught.value) == f"my.toml: {ERRORS[text]}"
    assert type(caught.value) is ValueError


ALONE = {
    "": 'my.toml: shares: missing; give it, or take what is not said from a preset, with base = "standard" on top',
    'bse = "standard"': "my.toml: bse: unknown key; did you mean 'base'?",
    'base = "standrd"': "my.toml: base: must be one of 'paper', 'standard', 'hard', 'doubles', 'uncommon', 'contact', got 'standrd'; "
    "did you mean 'standard'?",
    "base = 3": "my.toml: base: must be one of 'paper', 'standard', 'hard', 'doubles', 'uncommon', 'contact', got 3",
    "[shares]\nhealthy = 1\n[motion]\nstart_deg = 0\ntravel_deg = 0\n[times]\nonset_s = 0\npermanent = 0.5": "my.toml: "
    "times.lasting_s: missing; only with permanent = 1 no fault clears, got permanent = 0.5",
    "[shares": "cannot read preset from my.toml: Expected ']' at the end of a table declaration (at end of document)",
}


@pytest.mark.parametrize("text", list(ALONE))
def test_errors_without_a_base(load, text):
    with pytest.raises(ValueError) as caught:
        load(text)
    assert str(caught.value) == ALONE[text]


def test_files_that_cannot_be_read(load, tmp_path, config):
    with pytest.raises(ValueError, match=r"^cannot read preset from none.toml: .*No such file"):
        load_preset("none.toml")
    with pytest.raises(ValueError, match=r"^cannot read preset from .*: .*directory"):
        load_preset(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b"# \xe9")
    with pytest.raises(ValueError, match=r"^cannot read preset from latin.toml: 'utf-8' codec"):
        jaxftc.sample_scenarios(jax.random.key(0), 2, "latin.toml", config=config)


def test_unknown_names():
    for name in ("papr", 3, None):
        hint = r"; did you mean 'paper'\?" if name == "papr" else ""
        allowed = "'paper', 'standard', 'hard', 'doubles', 'uncommon', 'contact'"
        with pytest.raises(ValueError, match=rf"^preset must be one of {allowed}, got {name!r}{hint} \(a file of your own"):
            load_preset(name)


def test_joints_beyond_the_arm_name_the_file(load, config):
    load(base("[joints]\nallowed = [1, 7]"))
    with pytest.raises(ValueError, match=r"'my.toml'.*joints.allowed.*1 to 6.*\[1, 7\]"):
        jaxftc.sample_scenarios(jax.random.key(0), 2, "my.toml", config=config)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Uniform((3.0, 1.0)), "uniform: low must be below high, got [3.0, 1.0]"),
        (lambda: Uniform([0.0, 1.0]), "uniform: must be a tuple of numbers, got [0.0, 1.0]"),
        (lambda: PlantLaws(mass=(0.9, 1.1)), f"mass: {WAYS}, got (0.9, 1.1)"),
        (lambda: Shares(0.5, True), "actuator: must be a finite number, got True"),
        (lambda: Joints(allowed=[1]), "allowed: must be a tuple of integers, got [1]"),
        (lambda: TorqueBias(size=1.0, unit="deg"), "unit: must be one of 'limit', 'N m', got 'deg'"),
        (lambda: dataclasses.replace(load_preset("hard"), shares=(1.0, 0.0, 0.0, 0.0)), "shares: must be Shares, got (1.0,"),
        (
            lambda: dataclasses.replace(load_preset("standard"), actuator=ActuatorFaults()),
            "actuator: no kind of fault, but 0.5 of all scenarios have one; add a table [actuator.bias]",
        ),
    ],
)
def test_python_is_checked_as_a_file_is(make, text):
    with pytest.raises(ValueError) as caught:
        make()
    assert str(caught.value).startswith(text)


# The way back.


@pytest.mark.parametrize("name", PRESET_NAMES)
def test_a_built_in_preset_comes_back_from_its_own_file(load, name):
    preset = load_preset(name)
    assert load(tomli_w.dumps(as_dict(preset))) == preset


def reals(low=-1e6, high=1e6):
    return st.floats(low, high, allow_nan=False) | st.integers(int(np.ceil(low)), int(high)).map(float)


def laws(low=-1e6, high=1e6):
    """Laws that stay within low..high."""
    pairs = st.tuples(reals(low, high), reals(low, high)).filter(lambda p: p[0] < p[1])
    clipped = st.builds(Normal, st.tuples(reals(), reals(1e-3, 10.0)), pairs)
    return reals(low, high) | pairs.map(Uniform) | clipped | st.lists(reals(low, high), min_size=1, max_size=3).map(
        lambda values: Choice(tuple(values))
    )  # fmt: skip


weights = reals(1e-3, 100.0)
signs = st.sampled_from(["as_drawn", "random"])
kind = st.none() | st.builds(Unsized, weight=weights)
maybe = lambda table, size, **more: st.none() | st.builds(table, size=size, weight=weights, **more)  # noqa: E731
sensors = st.builds(
    SensorFaults,
    bias=st.builds(AngleBias, size=laws(), unit=st.sampled_from(["deg", "rad"]), sign=signs, weight=weights),
    drift=maybe(Drift, laws(), unit=st.sampled_from(["deg/s", "rad/s"]), sign=signs),
    freeze=kind,
    scale=maybe(Signed, laws(), sign=signs),
    noise=maybe(Sized, laws(0.0, 1e3)),
    dropout=kind,
)
share = laws(0.0, 1.0)
presets = st.builds(
    Preset,
    shares=st.sampled_from([Shares(0.1, 0.2, 0.3, 0.4), Shares(1 / 3, 1 / 3, 1 / 3), Shares(both=1.0)]),
    motion=st.builds(Motion, laws() | st.builds(Normal, st.tuples(reals(), reals(1e-3, 10.0))), laws()),
    times=st.builds(
        Times,
        laws(0.0, 10.0),
        reals(0.0, 1.0),
        laws(0.0, 10.0),
        st.none() | st.builds(Incipient, reals(0.0, 0.5), laws(0.0, 10.0)),
        st.none() | st.builds(Intermittent, reals(0.0, 0.5), laws(1e-3, 10.0), share),
    ),
    actuator=st.builds(
        ActuatorFaults,
        bias=maybe(TorqueBias, laws(), unit=st.sampled_from(["limit", "N m"]), sign=signs),
        loss=maybe(Share, share),
        stuck=st.builds(Unsized, weight=weights),
        saturation=maybe(Share, share),
    ),
    sensor=sensors,
    sensor_in_both=st.none() | sensors,
    encoder=st.builds(Encoder, laws(0.0, 1.0)),
    joints=st.sampled_from([Joints(), Joints(3), Joints(2, (4, 1, 2))]),
    plant=st.builds(PlantLaws, laws(0.1, 10.0), laws(0.0, 10.0), laws(0.0, 10.0), laws(0.1, 10.0), laws(0.1, 10.0)),
)


@given(preset=presets)
def test_any_preset_comes_back_from_its_own_file(tmp_path_factory, preset):
    path = tmp_path_factory.mktemp("preset") / "my.toml"
    path.write_text(tomli_w.dumps(as_dict(preset)), encoding="utf-8")
    back = load_preset(path)
    assert back == preset and hash(back) == hash(preset)
    assert tomllib.loads(path.read_text(encoding="utf-8")) == as_dict(preset)


@given(law=laws(0.5, 2.0), u=st.floats(0.0, 1.0, exclude_max=True))
def test_a_law_draws_nothing_beyond_its_extent(law, u):
    """What the checks of ranges rely on."""
    value = float(quantile(law, jax.numpy.asarray(u)))
    low, high = extent(law)
    assert 0.5 <= low <= high <= 2.0
    assert low * (1 - 1e-12) <= value <= high * (1 + 1e-12)
