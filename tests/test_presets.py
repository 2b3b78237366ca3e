"""The presets' laws, and how well the verdicts hold on them with thresholds set on healthy runs."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc import metrics
from jaxftc.arm.robot import compile_robot
from jaxftc.faults.kinds import Actuator, Sensor
from jaxftc.faults.sample import PRESETS, _draw_all

LIMIT = np.array([97.6, 186.4, 89.4, 24.2, 20.1, 21.3])


@pytest.fixture(scope="module")
def many(config):
    return {name: jax.tree.map(np.asarray, jaxftc.sample_scenarios(jax.random.key(3), 4000, preset=name, config=config))
            for name in PRESETS}  # fmt: skip


def test_a_scenario_depends_on_the_key_and_its_id_alone(config, many):
    few = jaxftc.sample_scenarios(jax.random.key(3), 7, preset="standard", config=config)
    other = jaxftc.sample_scenarios(jax.random.key(4), 7, preset="standard", config=config)
    for a, b in zip(*map(jax.tree.leaves, (few, many["standard"])), strict=True):
        np.testing.assert_array_equal(a, b[:7])
    assert (np.asarray(few.q_start) != np.asarray(other.q_start)).all()


@pytest.mark.parametrize("name", list(PRESETS))
def test_shares_of_the_conditions(many, name):
    kinds = (many[name].fault_tau.kind > 0).any(1) + 2 * (many[name].fault_q.kind > 0).any(1)
    np.testing.assert_allclose(np.bincount(kinds, minlength=4) / 4000, PRESETS[name].shares, atol=0.03)


@pytest.mark.parametrize("name", list(PRESETS))
def test_faults_sit_on_as_many_joints_as_the_law_says(many, name):
    for fault in (many[name].fault_tau, many[name].fault_q):
        count = (fault.kind > 0).sum(1)
        assert set(count) <= {0, PRESETS[name].joints}
        per_joint = (fault.kind > 0).sum(0)
        assert per_joint.min() > 0.8 * per_joint.mean()


@pytest.mark.parametrize("name", ["standard", "hard"])
def test_sizes_keep_within_their_laws(many, name):
    low = PRESETS[name].smaller
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
        drawn = value[kind]
        assert drawn.size > 100 and drawn.min() >= bounds[0] * (1 - 1e-5) and drawn.max() <= bounds[1] * (1 + 1e-5)
        middle = (bounds[0] + bounds[1]) / 2
        assert 0.4 < (drawn < middle).mean() < 0.6
    assert 0.4 < (q.magnitude[q.kind == Sensor.BIAS] > 0).mean() < 0.6


def test_both_faults_of_standard_have_an_encoder_bias(many):
    both = (many["standard"].fault_tau.kind > 0).any(1) & (many["standard"].fault_q.kind > 0).any(1)
    assert set(many["standard"].fault_q.kind[both].max(1)) == {Sensor.BIAS}
    assert Sensor.BIAS not in set(many["doubles"].fault_q.kind.max(1))


def test_times_and_plant(many):
    standard, hard = many["standard"], many["hard"]
    onset, clear = standard.fault_q.onset[:, 0], standard.fault_q.clear[:, 0]
    assert onset.min() >= 0.1 and onset.max() <= 0.5
    assert 0.45 < np.isinf(clear).mean() < 0.55
    lasting = (clear - onset)[np.isfinite(clear)]
    assert lasting.min() >= 0.1 - 1e-6 and lasting.max() <= 0.4 + 1e-6
    assert (standard.fault_q.rise == 0).all() and np.isinf(standard.fault_q.period).all()
    assert 0.28 < (hard.fault_q.rise[:, 0] > 0).mean() < 0.38 and 0.28 < np.isfinite(hard.fault_q.period[:, 0]).mean() < 0.38
    assert np.abs(standard.plant.mass - 1).max() <= 0.02 + 1e-6 and (standard.plant.payload == 0).all()
    assert 0.95 < hard.plant.payload.max() <= 1.0 and np.abs(hard.plant.coulomb - 1).max() <= 0.2 + 1e-6
    assert np.rad2deg(np.abs(standard.q_goal - standard.q_start)).max() <= 90 + 1e-4


def test_an_arm_without_torque_limits_is_refused():
    arm = compile_robot("free", '<mujoco><worldbody><body><joint axis="0 1 0"/><inertial pos="0 0 .1" mass="1" '
                                'diaginertia=".1 .1 .1"/>'
                                "</body></worldbody></mujoco>")  # fmt: skip
    with pytest.raises(
        ValueError, match=r"preset 'standard' sizes faults by torque limits, 'free' has \[inf\] N m; give every"
    ):
        jaxftc.sample_scenarios(jax.random.key(0), 2, preset="standard", config=jaxftc.Config(arm, engine="chain"))


KINDS = {
    "actuator bias": (("actuator", Actuator.BIAS), 0.98),
    "actuator loss": (("actuator", Actuator.LOSS), 0.93),
    "actuator stuck": (("actuator", Actuator.STUCK), 0.88),
    "encoder bias": (("sensor", Sensor.BIAS), 0.98),
    "encoder drift": (("sensor", Sensor.DRIFT), 0.88),
    "encoder freeze": (("sensor", Sensor.FREEZE), 0.93),
    "encoder scale": (("sensor", Sensor.SCALE), 0.95),
    "encoder noise": (("sensor", Sensor.NOISE), 0.88),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(KINDS))
def test_kind_and_joint_are_right_on_standard(name, puma, capsys):
    """500 single faults of a kind against +-2 % masses and +-10 % friction; every other joint must stay quiet."""
    (channel, kind), least = KINDS[name]
    with jax.enable_x64(False):
        config = jaxftc.Config(puma, engine="chain")
        gains = calibrated(config, np.float32)
        laws = dataclasses.replace(
            PRESETS["standard"],
            shares=(0.0, 1.0, 0.0, 0.0) if channel == "actuator" else (0.0, 0.0, 1.0, 0.0),
            actuator_kinds=(kind,) if channel == "actuator" else (Actuator.BIAS,),
            sensor_kinds=(kind,) if channel == "sensor" else (Sensor.BIAS,),
        )
        scenarios = _draw_all(laws, config, jax.random.key(21), jnp.arange(500, dtype=jnp.int32))
        verdict = run(config, gains, jaxftc.trail(scenarios), jax.random.key(22))["verdict"]
    fault = scenarios.fault_tau if channel == "actuator" else scenarios.fault_q
    wanted = np.where(np.asarray(fault.kind) > 0, 1 if channel == "actuator" else 2, 0)
    present = np.arange(config.ticks)[:, None] * config.dt >= np.asarray(fault.onset)[:, 0]
    results = [metrics.detection(config, verdict[..., i], wanted[i], present[:, i]) for i in range(500)]
    found = np.array([np.isfinite(result.delay_s) for result in results])
    right = np.array([result.isolated for result in results])[found].mean()
    with capsys.disabled():
        print(f"\n{name}: detected {found.mean():.3f}, kind and joint right {right:.3f}, "
              f"median delay {1e3 * np.median([r.delay_s for r in results]):.0f} ms")  # fmt: skip
    assert found.mean() >= 0.95
    assert right >= least


def run(config, gains, scenarios, key):
    """Only what the test needs leaves the compiled program."""
    return {k: np.asarray(v) for k, v in _observe(config, gains, scenarios, key).items()}


def _signals(config, gains, scenarios, key):
    out = jaxftc.simulate(config, gains, scenarios, key).out
    return {"verdict": out.verdict, "s_tau": jnp.abs(out.statistic_tau).max(0), "s_q": jnp.abs(out.statistic_q).max(0)}


_observe = jaxftc.jit(_signals, static_argnums=0)


def calibrated(config, dtype):
    """Thresholds 1.2 times what 500 healthy runs reach in all but 1 in 1200 of cases a joint, 0.01 deg at least."""
    gains = jaxftc.default_gains(config)
    healthy = dataclasses.replace(PRESETS["standard"], shares=(1.0, 0.0, 0.0, 0.0))
    scenarios = jaxftc.trail(_draw_all(healthy, config, jax.random.key(20), jnp.arange(500, dtype=jnp.int32)))
    top = run(config, gains, scenarios, jax.random.key(23))
    diagnosis = dataclasses.replace(
        gains.diagnosis,
        alpha_tau=jnp.asarray(1.2 * np.quantile(top["s_tau"], 1 - 0.01 / 12, axis=1), dtype),
        alpha_q=jnp.asarray(np.maximum(1.2 * np.quantile(top["s_q"], 1 - 0.01 / 12, axis=1), np.deg2rad(0.01)), dtype),
    )
    gains = dataclasses.replace(gains, diagnosis=diagnosis)
    assert (run(config, gains, scenarios, jax.random.key(24))["verdict"] == 0).all((0, 1)).mean() >= 0.99
    return gains
