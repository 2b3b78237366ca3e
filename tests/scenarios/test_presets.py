"""What presets draw: their laws, independence of the batch, other arms; and how well the verdicts hold on them."""

import dataclasses
from pathlib import Path

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxftc
from jaxftc.evaluation import metrics
from jaxftc.robot.model_file import compile_robot
from jaxftc.scenarios.distributions import Choice, Normal, Uniform, quantile
from jaxftc.scenarios.faults import (
    Actuator,
    ActuatorFaults,
    AngleBias,
    Sensor,
    SensorFaults,
    Share,
    TorqueBias,
    TorqueSize,
    Unsized,
    kinds,
)
from jaxftc.scenarios.preset import Encoder, Joints, Motion, PlantLaws, Preset, Shares
from jaxftc.scenarios.preset_file import load_preset
from jaxftc.scenarios.presets import PRESET_NAMES
from jaxftc.scenarios.sample import draw_all

LIMIT = np.array([97.6, 186.4, 89.4, 24.2, 20.1, 21.3])
DRAWN = PRESET_NAMES[1:]
INERTIAL = '<inertial pos="0 0 .1" mass="1" diaginertia=".1 .1 .1"/>'


@pytest.fixture(scope="module")
def config(puma_config) -> jaxftc.Config:
    return puma_config


@pytest.fixture(scope="module")
def many(config):
    return {name: arrays(jaxftc.sample_scenarios(jax.random.key(3), 4000, preset=name, config=config)) for name in DRAWN}


def arrays(scenarios):
    return jax.tree.map(np.asarray, scenarios)


def drawn(preset, config, n=2000, key=7):
    return arrays(draw_all(preset, config, jax.random.key(key), jnp.arange(n)))


def named(scenarios):
    return {jax.tree_util.keystr(path): leaf for path, leaf in jax.tree_util.tree_leaves_with_path(scenarios)}


def arm(name: str, n: int, motors: bool = True) -> jaxftc.Robot:
    """n links in a row, each with a motor of 10 N m or without any."""
    links = "".join(f'<body pos="0 0 .3"><joint name="j{j}" axis="0 1 0"/>{INERTIAL}' for j in range(n)) + "</body>" * n
    motor = '<motor joint="j{}" ctrllimited="true" ctrlrange="-10 10"/>'
    drives = "<actuator>" + "".join(motor.format(j) for j in range(n)) + "</actuator>" if motors else ""
    return compile_robot(name, f"<mujoco><worldbody>{links}</worldbody>{drives}</mujoco>")


# The built-in presets.


@pytest.mark.parametrize("name", DRAWN)
def test_presets_draw_what_they_drew_when_the_figures_were_made(many, name):
    """Drawn by the release that had the laws in its code; other machines may round the last digit otherwise."""
    rows = [0, 5, 77, 199]
    mine = named(jax.tree.map(lambda leaf: leaf[rows], many[name]))
    with np.load(Path(__file__).parents[1] / "golden" / "presets.npz") as golden:
        wanted = {key.removeprefix(name): golden[key] for key in golden.files if key.startswith(name)}
    assert mine.keys() == wanted.keys()
    for key, leaf in wanted.items():
        assert mine[key].dtype == leaf.dtype
        np.testing.assert_allclose(mine[key], leaf, rtol=1e-13, atol=0, err_msg=key)


@pytest.mark.parametrize("name", DRAWN)
def test_shares_of_the_conditions(many, name):
    kind = (many[name].fault_tau.kind > 0).any(1) + 2 * (many[name].fault_q.kind > 0).any(1)
    kind = kind + 4 * (many[name].contact.size > 0) if many[name].contact else kind
    shares = dataclasses.astuple(load_preset(name).shares)
    np.testing.assert_allclose(np.bincount(kind, minlength=5) / 4000, shares, atol=0.03)


@pytest.mark.parametrize("name", DRAWN)
def test_faults_sit_on_as_many_joints_as_the_law_says(many, name):
    for fault in (many[name].fault_tau, many[name].fault_q):
        count = (fault.kind > 0).sum(1)
        assert set(count) <= {0, load_preset(name).joints.at_once}
        if fault is many[name].fault_q and name == "contact":
            assert not count.any()
            continue
        per_joint = (fault.kind > 0).sum(0)
        assert per_joint.min() > 0.8 * per_joint.mean()


@pytest.mark.parametrize(("name", "low"), [("standard", 1.0), ("hard", 0.5)])
def test_sizes_keep_within_their_laws(many, name, low):
    tau, q = many[name].fault_tau, many[name].fault_q
    share = np.abs(tau.magnitude) / LIMIT
    for value, kind, bounds in (
        (share, tau.kind == Actuator.BIAS, (0.05 * low, 0.3)),
        (tau.magnitude, tau.kind == Actuator.LOSS, (0.3 * low, 0.9)),
        (np.rad2deg(np.abs(q.magnitude)), q.kind == Sensor.BIAS, (0.2 * low, 5.0)),
        (np.rad2deg(np.abs(q.magnitude)), q.kind == Sensor.DRIFT, (5.0 * low, 50.0)),
        (np.abs(q.magnitude), q.kind == Sensor.SCALE, (0.02 * low, 0.10)),
        (q.magnitude, q.kind == Sensor.NOISE, (20.0 * low, 100.0)),
    ):
        sizes = value[kind]
        assert sizes.size > 100 and sizes.min() >= bounds[0] * (1 - 1e-5) and sizes.max() <= bounds[1] * (1 + 1e-5)
        assert stats.kstest(np.unique(sizes), stats.uniform(bounds[0], bounds[1] - bounds[0]).cdf).pvalue > 1e-3
    assert 0.4 < (q.magnitude[q.kind == Sensor.BIAS] > 0).mean() < 0.6
    assert (tau.magnitude[tau.kind == Actuator.STUCK] == 0).all() and (q.magnitude[q.kind == Sensor.FREEZE] == 0).all()


def test_both_faults_of_standard_have_an_encoder_bias(many):
    both = (many["standard"].fault_tau.kind > 0).any(1) & (many["standard"].fault_q.kind > 0).any(1)
    assert set(many["standard"].fault_q.kind[both].max(1)) == {Sensor.BIAS}
    assert set(many["doubles"].fault_q.kind.max(1)) == {Sensor.DRIFT, Sensor.FREEZE, Sensor.SCALE, Sensor.NOISE}


def test_times_and_plant(many):
    standard, hard = many["standard"], many["hard"]
    onset, clear = standard.fault_q.onset[:, 0], standard.fault_q.clear[:, 0]
    assert onset.min() >= 0.1 and onset.max() <= 0.5
    assert 0.45 < np.isinf(clear).mean() < 0.55
    lasting = (clear - onset)[np.isfinite(clear)]
    assert lasting.min() >= 0.1 - 1e-6 and lasting.max() <= 0.4 + 1e-6
    assert (standard.fault_q.rise == 0).all() and np.isinf(standard.fault_q.period).all()
    ramps, comes_and_goes = hard.fault_q.rise[:, 0] > 0, np.isfinite(hard.fault_q.period[:, 0])
    assert 0.28 < ramps.mean() < 0.38 and 0.28 < comes_and_goes.mean() < 0.38 and not (ramps & comes_and_goes).any()
    assert np.abs(standard.plant.mass - 1).max() <= 0.02 + 1e-6 and (standard.plant.payload == 0).all()
    assert (standard.plant.armature == 1).all() and (standard.noise == 3e-5).all()
    assert 0.95 < hard.plant.payload.max() <= 1.0 and np.abs(hard.plant.coulomb - 1).max() <= 0.2 + 1e-6
    assert np.rad2deg(np.abs(standard.q_goal - standard.q_start)).max() <= 90 + 1e-4


# A scenario depends on the key and its id alone.


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["standard", "paper"])
def test_neither_number_nor_order_nor_chunk_matter(config, name):
    key, preset = jax.random.key(3), load_preset(name)
    whole = arrays(jaxftc.sample_scenarios(key, 12, preset=name, config=config))
    pick = np.array([[7, 0, 11], [3, 3, 8]], np.int32)
    for ids in (pick[0], pick, pick[0, :1], np.int32(5)):
        part = draw_all(preset, config, key, ids)
        for mine, theirs in zip(jax.tree.leaves(part), jax.tree.leaves(whole), strict=True):
            np.testing.assert_array_equal(mine, theirs[ids])
    far = draw_all(preset, config, key, jnp.array([2**31 - 1, 10**6], jnp.int32))
    np.testing.assert_array_equal(far.id, [2**31 - 1, 10**6])


def test_other_keys_draw_others(config, many):
    other = jaxftc.sample_scenarios(jax.random.key(4), 7, preset="standard", config=config)
    assert (many["standard"].q_start[:7] != np.asarray(other.q_start)).all()


@pytest.mark.parametrize("name", ["hard", "paper"])
def test_drawing_is_traceable_and_an_equal_preset_does_not_compile_again(config, name):
    chex.clear_trace_counter()
    program = jax.jit(chex.assert_max_traces(draw_all, n=1), static_argnums=(0, 1))
    key = jax.random.key(3)
    preset = load_preset(name)
    again = dataclasses.replace(preset)
    assert again is not preset and again == preset and hash(again) == hash(preset)
    for laws, ids in ((preset, [0, 1, 2]), (again, [5, 4, 3])):
        inside = program(laws, config, key, jnp.array(ids))
        outside = draw_all(preset, config, key, jnp.array(ids))
        for mine, theirs in zip(jax.tree.leaves(inside), jax.tree.leaves(outside), strict=True):
            np.testing.assert_allclose(mine, theirs, rtol=1e-13)


def test_paper_deals_its_conditions_in_turn_from_any_id(config):
    some = arrays(draw_all(load_preset("paper"), config, jax.random.key(0), jnp.array([4, 7, 2, 1])))
    assert (some.fault_tau.kind[:, 0].tolist(), some.fault_q.kind[:, 0].tolist()) == ([0, 1, 0, 1], [0, 1, 1, 0])
    np.testing.assert_array_equal(some.id, [4, 7, 2, 1])


# Laws.


GRID = (np.arange(1000) + 0.5) / 1000


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    ("law", "inverse"),
    [
        (2.5, lambda u: np.full_like(u, 2.5)),
        (Uniform((-1.0, 3.0)), stats.uniform(-1, 4).ppf),
        (Normal((2.0, 0.5)), stats.norm(2, 0.5).ppf),
        (Normal((2.0, 0.5), (1.5, 4.0)), lambda u: np.clip(stats.norm(2, 0.5).ppf(u), 1.5, 4.0)),
        (Choice((3.0, -1.0, 7.0)), lambda u: np.array([3.0, -1.0, 7.0])[(3 * u).astype(int)]),
    ],
    ids=["number", "uniform", "normal", "clipped normal", "choice"],
)
def test_a_law_is_its_inverse_distribution_function_of_one_uniform_number(law, inverse, dtype):
    value = quantile(law, jnp.asarray(GRID, dtype))
    assert value.dtype == dtype
    np.testing.assert_allclose(value, inverse(GRID), rtol=0, atol=1e-5 if dtype == np.float32 else 1e-12)
    ends = quantile(law, jnp.asarray([0.0, 1 - np.finfo(dtype).eps], dtype))  # the least and the most that are drawn
    assert np.isfinite(ends).all()


@pytest.fixture(scope="module")
def own() -> Preset:
    """Laws of every form, none like a built-in one."""
    return dataclasses.replace(
        load_preset("standard"),
        shares=Shares(actuator=0.5, both=0.5),
        motion=Motion(start_deg=Normal((5.0, 10.0)), travel_deg=Choice((-45.0, 20.0))),
        actuator=ActuatorFaults(
            bias=TorqueBias(size=Normal((2.0, 0.5)), unit="N m", weight=3.0),
            saturation=Share(size=0.25),
            stuck=Unsized(weight=2.0),
        ),
        sensor=SensorFaults(dropout=Unsized()),
        sensor_in_both=SensorFaults(
            bias=AngleBias(size=Uniform((0.01, 0.02)), unit="rad", sign="random"), dropout=Unsized()
        ),
        encoder=Encoder(noise_rad=Uniform((1e-5, 5e-5))),
        joints=Joints(at_once=2, allowed=(6, 1, 3)),
        plant=PlantLaws(
            mass=Normal((1.0, 0.05), (0.9, 1.2)),
            armature=Uniform((0.7, 1.3)),
            torque_constant=0.95,
            payload_kg=Uniform((1.0, 2.0)),
        ),
    )


@pytest.fixture(scope="module")
def mine(own, config):
    return drawn(own, config)


def test_drawn_values_follow_the_laws(mine, config):
    start = np.rad2deg(mine.q_start) - [30, 120, 30, 120, 50, 180]
    tau, q = mine.fault_tau, mine.fault_q
    for value, law in (
        (start, stats.norm(5, 10)),
        (tau.magnitude[tau.kind == Actuator.BIAS], stats.norm(2, 0.5)),
        (np.abs(q.magnitude[q.kind == Sensor.BIAS]), stats.uniform(0.01, 0.01)),
        (mine.noise, stats.uniform(1e-5, 4e-5)),
        (mine.plant.armature, stats.uniform(0.7, 0.6)),
        (mine.plant.payload, stats.uniform(1, 1)),
    ):
        assert stats.kstest(np.unique(value), law.cdf).pvalue > 1e-3
    travel = np.rad2deg(mine.q_goal - mine.q_start).round(6)
    assert set(travel.ravel()) == {-45.0, 20.0} and 0.48 < (travel > 0).mean() < 0.52
    at_end = stats.norm(1, 0.05).cdf(0.9)
    assert abs((mine.plant.mass == 0.9).mean() - at_end) < 0.005 and mine.plant.mass.min() == 0.9
    assert stats.kstest(mine.plant.mass[mine.plant.mass > 0.9], stats.truncnorm(-2, np.inf, 1, 0.05).cdf).pvalue > 1e-3
    assert (mine.plant.torque_constant == 0.95).all() and (mine.plant.damping == 1).all()
    assert (tau.magnitude[tau.kind == Actuator.SATURATION] == 0.25).all()


def test_joints_are_drawn_apart_and_values_of_a_scenario_are_not_the_same_number(mine):
    """Each value has its own uniform number: nothing that is drawn goes with anything else."""
    values = [*mine.q_start.T, *mine.plant.armature.T, *mine.plant.mass.T, mine.noise, mine.plant.payload]
    values += [mine.fault_tau.onset[:, 0], (mine.fault_tau.kind > 0)[:, 0], (mine.fault_q.kind > 0)[:, 0]]
    correlation = np.corrcoef(np.array(values, float)) - np.eye(len(values))
    assert np.abs(correlation[:-1, :-1]).max() < 0.1  # 4.5 standard deviations for 2000
    assert np.abs(correlation[-1, :-2]).max() < 0.1


def test_weights_say_how_likely_a_kind_is(mine):
    kind = mine.fault_tau.kind.max(1)
    counts = [np.mean(kind == k) for k in (Actuator.BIAS, Actuator.STUCK, Actuator.SATURATION, Actuator.LOSS)]
    np.testing.assert_allclose(counts, [3 / 6, 2 / 6, 1 / 6, 0], atol=0.035)


def test_signs(mine):
    bias = mine.fault_q.magnitude[mine.fault_q.kind == Sensor.BIAS]
    assert 0.4 < (bias > 0).mean() < 0.6
    assert (mine.fault_tau.magnitude >= 0).all()  # 2 N m is four standard deviations above zero


def test_allowed_joints_are_the_only_ones_and_all_of_them(mine):
    for fault in (mine.fault_tau, mine.fault_q):
        at_fault = fault.kind > 0
        assert set(at_fault.sum(1)) <= {0, 2}
        share = at_fault.mean(0) / at_fault.any(1).mean()
        np.testing.assert_allclose(share, [2 / 3, 0, 2 / 3, 0, 0, 2 / 3], atol=0.05)


def test_encoder_faults_beside_an_actuator_fault_are_those_of_sensor_if_no_others_are_said(own, config):
    shares = Shares(sensor=0.5, both=0.5)
    with_table = drawn(dataclasses.replace(own, shares=shares), config, 500)
    both = (with_table.fault_tau.kind > 0).any(1)
    assert set(with_table.fault_q.kind[both].max(1)) == {Sensor.BIAS, Sensor.DROPOUT}
    assert set(with_table.fault_q.kind[~both].max(1)) == {Sensor.DROPOUT}
    without = drawn(dataclasses.replace(own, shares=shares, sensor_in_both=None), config, 500)
    assert set(without.fault_q.kind.max(1)) == {Sensor.DROPOUT}


def test_a_law_that_changes_changes_no_other_draw(many, config):
    preset = dataclasses.replace(
        load_preset("standard"),
        motion=Motion(start_deg=Uniform((-30.0, 30.0)), travel_deg=1.0),
        plant=dataclasses.replace(load_preset("standard").plant, mass=1.1, armature=Uniform((0.5, 2.0))),
    )
    before, after = named(many["standard"]), named(drawn(preset, config, 50, key=3))
    changed = {name for name, leaf in after.items() if not np.array_equal(leaf, before[name][:50])}
    assert changed == {".q_goal", ".plant.mass", ".plant.armature"}


@pytest.mark.thorough
def test_a_condition_without_a_share_never_comes(own, config):
    """Shares whose float32 sum ends below 1 included."""
    with jax.enable_x64(False):
        scenarios = drawn(dataclasses.replace(own, shares=Shares(0.1, 0.2, 0.7, 0.0)), config, 4000)
    both = (scenarios.fault_tau.kind > 0).any(1) & (scenarios.fault_q.kind > 0).any(1)
    assert not both.any()
    for condition, channel in (("healthy", None), ("actuator", scenarios.fault_tau)):
        some = drawn(dataclasses.replace(own, shares=Shares(**{condition: 1.0})), config, 300)
        assert (some.fault_q.kind == 0).all() and ((some.fault_tau.kind > 0).any(1) == (channel is not None)).all()


# Arms.


def test_a_three_joint_arm():
    config = jaxftc.Config(arm("three", 3), engine="chain", duration=0.02)
    scenarios = arrays(jaxftc.sample_scenarios(jax.random.key(0), 300, preset="hard", config=config))
    chex.assert_shape([scenarios.q_start, scenarios.plant.payload], [(300, 3), (300,)])
    assert np.rad2deg(np.abs(scenarios.q_start)).max() <= 30
    bias = scenarios.fault_tau.magnitude[scenarios.fault_tau.kind == Actuator.BIAS]
    assert bias.size and np.abs(bias).min() >= 0.25 and np.abs(bias).max() <= 3.0


@pytest.mark.slow
def test_what_is_drawn_for_a_three_joint_arm_can_be_run():
    config = jaxftc.Config(arm("three", 3), engine="chain", duration=0.02)
    scenarios = jaxftc.sample_scenarios(jax.random.key(0), 300, preset="hard", config=config)
    trace = jaxftc.simulate(config, jaxftc.default_gains(config), scenarios, jax.random.key(1))
    assert np.isfinite(trace.q).all()


def test_an_arm_with_fewer_joints_than_are_at_fault_at_once_has_all_at_fault():
    config = jaxftc.Config(arm("one", 1), engine="chain")
    scenarios = drawn(load_preset("hard"), config, 100)
    assert ((scenarios.fault_tau.kind > 0) | (scenarios.fault_q.kind > 0)).any(1).mean() > 0.6


def test_joints_beyond_the_arm_are_refused():
    config = jaxftc.Config(arm("three", 3), engine="chain")
    preset = dataclasses.replace(load_preset("standard"), joints=Joints(allowed=(2, 5)))
    for call in (
        lambda: jaxftc.sample_scenarios(jax.random.key(0), 2, preset, config=config),
        lambda: draw_all(preset, config, jax.random.key(0), jnp.arange(2)),
    ):
        with pytest.raises(ValueError, match=r"joints.allowed.*'three'.*1 to 3.*\[2, 5\]"):
            call()


def test_an_arm_without_torque_limits_is_refused():
    config = jaxftc.Config(arm("free", 1, motors=False), engine="chain")
    with pytest.raises(ValueError, match=r"'standard'.*torque limits.*'free'.*\[inf\]"):
        jaxftc.sample_scenarios(jax.random.key(0), 2, preset="standard", config=config)


@pytest.mark.parametrize("kind", ["ripple", "friction"])
def test_no_fault_is_sized_by_limits_that_are_not_there(kind):
    config = jaxftc.Config(arm("free", 1, motors=False), engine="chain")
    preset = dataclasses.replace(load_preset("standard"), actuator=ActuatorFaults(**{kind: TorqueSize(size=0.1)}))
    with pytest.raises(ValueError, match=rf"torque limits \(actuator.{kind}\), 'free' has"):
        jaxftc.sample_scenarios(jax.random.key(0), 2, preset, config=config)


def test_an_arm_without_torque_limits_has_faults_that_do_not_need_them():
    config = jaxftc.Config(arm("free", 1, motors=False), engine="chain")
    standard = load_preset("standard")
    faults = ActuatorFaults(bias=TorqueBias(size=2.0, unit="N m"), stuck=Unsized())
    scenarios = drawn(dataclasses.replace(standard, actuator=faults), config, 100)
    assert set(scenarios.fault_tau.magnitude.ravel()) == {0.0, 2.0}
    encoder_only = drawn(dataclasses.replace(standard, shares=Shares(healthy=0.5, sensor=0.5)), config, 100)
    assert all(np.isfinite(leaf).all() for leaf in (encoder_only.fault_tau.magnitude, encoder_only.fault_q.magnitude))


# Verdicts.


KINDS = {
    "actuator bias": 0.98,
    "actuator loss": 0.93,
    "actuator stuck": 0.88,
    "sensor bias": 0.98,
    "sensor drift": 0.88,
    "sensor freeze": 0.93,
    "sensor scale": 0.95,
    "sensor noise": 0.88,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(KINDS))
def test_kind_and_joint_are_right_on_standard(name, puma, capsys):
    """500 single faults of a kind against +-2 % masses and +-10 % friction; every other joint must stay quiet."""
    channel, kind = name.split()
    with jax.enable_x64(False):
        config = jaxftc.Config(puma, engine="chain")
        gains = calibrated(config, np.float32)
        standard = load_preset("standard")
        faults = getattr(standard, channel)
        only = {channel: type(faults)(**{kind: kinds(faults)[kind]}), "shares": Shares(**{channel: 1.0})}
        laws = dataclasses.replace(standard, **only)
        scenarios = draw_all(laws, config, jax.random.key(21), jnp.arange(500))
        verdict = run(config, gains, scenarios, jax.random.key(22))["verdict"]
    fault = scenarios.fault_tau if channel == "actuator" else scenarios.fault_q
    wanted = np.where(np.asarray(fault.kind) > 0, 1 if channel == "actuator" else 2, 0)
    present = np.arange(config.ticks)[:, None] * config.dt >= np.asarray(fault.onset)[:, 0]
    results = [metrics.detection(config, verdict[i], wanted[i], present[:, i]) for i in range(500)]
    found = np.array([np.isfinite(result.delay_s) for result in results])
    right = np.array([result.isolated for result in results])[found].mean()
    with capsys.disabled():
        print(f"\n{name}: detected {found.mean():.3f}, kind and joint right {right:.3f}, "
              f"median delay {1e3 * np.median([r.delay_s for r in results]):.0f} ms")  # fmt: skip
    assert found.mean() >= 0.95
    assert right >= KINDS[name]


def run(config, gains, scenarios, key):
    """Only what the test needs leaves the compiled program."""
    return {k: np.asarray(v) for k, v in _observe(config, gains, scenarios, key).items()}


def _signals(config, gains, scenarios, key):
    out = jaxftc.simulate(config, gains, scenarios, key).out
    return {"verdict": out.verdict, "s_tau": jnp.abs(out.statistic_tau).max(1), "s_q": jnp.abs(out.statistic_q).max(1)}


_observe = jax.jit(_signals, static_argnums=0)


def calibrated(config, dtype):
    """Thresholds 1.2 times what 500 healthy runs reach in all but 1 in 1200 of cases a joint, 0.01 deg at least."""
    gains = jaxftc.default_gains(config)
    healthy = dataclasses.replace(load_preset("standard"), shares=Shares(healthy=1.0))
    scenarios = draw_all(healthy, config, jax.random.key(20), jnp.arange(500))
    top = run(config, gains, scenarios, jax.random.key(23))
    tau, q = (1.2 * np.quantile(top[name], 1 - 0.01 / 12, axis=0) for name in ("s_tau", "s_q"))
    gains = gains.replace({"diagnosis.alpha_tau": tau, "diagnosis.alpha_q": np.maximum(q, np.deg2rad(0.01))})
    assert (run(config, gains, scenarios, jax.random.key(24))["verdict"] == 0).all((1, 2)).mean() >= 0.99
    return gains
