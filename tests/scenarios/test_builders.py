"""Faults by name: what the fields of a fault are by hand, on one scenario and on sets; what cannot be is refused."""

import math

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc.scenarios import builders
from jaxftc.scenarios.faults import Actuator, Sensor
from jaxftc.scenarios.scenario import trail

SIZED = {  # kind, argument, a size
    "with_actuator_bias": (Actuator.BIAS, "torque", -5.0),
    "with_actuator_loss": (Actuator.LOSS, "share", 0.4),
    "with_actuator_saturation": (Actuator.SATURATION, "share", 0.3),
    "with_actuator_gain": (Actuator.GAIN, "share", -0.2),
    "with_actuator_delay": (Actuator.DELAY, "ticks", 3.0),
    "with_torque_ripple": (Actuator.RIPPLE, "torque", 2.0),
    "with_joint_friction": (Actuator.FRICTION, "torque", 4.0),
    "with_encoder_bias": (Sensor.BIAS, "angle", 0.02),
    "with_encoder_drift": (Sensor.DRIFT, "rate", -0.1),
    "with_encoder_scale": (Sensor.SCALE, "share", -0.05),
    "with_encoder_noise": (Sensor.NOISE, "factor", 30.0),
    "with_encoder_rounding": (Sensor.ROUNDING, "angle", 0.01),
    "with_encoder_wrap": (Sensor.WRAP, "angle", 3.0),
    "with_encoder_delay": (Sensor.DELAY, "ticks", 2.0),
    "with_encoder_crosstalk": (Sensor.CROSSTALK, "share", 0.1),
}
UNSIZED = {
    "with_stuck_actuator": Actuator.STUCK,
    "with_locked_joint": Actuator.LOCKED,
    "with_frozen_encoder": Sensor.FREEZE,
    "with_encoder_dropout": Sensor.DROPOUT,
}


@pytest.fixture(scope="module")
def config():
    return jaxftc.Config(jaxftc.puma560(coulomb=False), engine="chain", duration=0.02)


@pytest.fixture(scope="module")
def healthy(config):
    return jaxftc.healthy_scenario(config)


def stacked(scenario, count):
    return jax.tree.map(lambda leaf: jnp.stack([leaf] * count), scenario)


def test_every_kind_of_fault_has_a_method():
    kinds = [*(kind for kind, *_ in SIZED.values()), *UNSIZED.values()]
    for enum in (Actuator, Sensor):
        assert {kind for kind in kinds if type(kind) is enum} == set(enum) - {enum.NONE}
    public = {name for name in dir(builders) if name.startswith("with_")}
    methods = {name for name in dir(jaxftc.Scenario) if name.startswith("with_")}
    assert public == {*SIZED, *UNSIZED, "with_brown_out"} == methods - {"with_contact"}  # which is no fault of a joint


@pytest.mark.parametrize("name", [*SIZED, *UNSIZED])
def test_a_method_sets_one_joint_of_one_channel(healthy, name):
    kind, argument, size = SIZED.get(name, (UNSIZED.get(name), None, 0.0))
    sized = {argument: size} if argument else {}
    faulty = getattr(healthy, name)(2, **sized, onset=0.3, clear=0.5, rise=0.1, period=0.05, duty=0.5)
    channel, other = ("fault_tau", "fault_q") if type(kind) is Actuator else ("fault_q", "fault_tau")
    fault = getattr(faulty, channel)
    assert [float(leaf[1]) for leaf in fault] == [kind, size, 0.3, 0.5, 0.1, 0.05, 0.5]
    others = jax.tree.map(lambda leaf: np.delete(leaf, 1), (fault, getattr(healthy, channel)))
    chex.assert_trees_all_equal(*others)
    chex.assert_trees_all_equal_shapes_and_dtypes(faulty, healthy)
    chex.assert_trees_all_equal(faulty._replace(**{channel: getattr(healthy, channel)}), healthy)
    assert getattr(faulty, other) is getattr(healthy, other)


def test_a_brown_out_is_a_saturation_of_every_joint(healthy):
    faulty = healthy
    for joint in range(1, 7):
        faulty = faulty.with_actuator_saturation(joint, 0.3, 0.2, clear=0.4)
    chex.assert_trees_all_equal(healthy.with_brown_out(0.3, 0.2, clear=0.4), faulty)


def test_the_papers_conditions_are_built_from_a_healthy_motion(config):
    built = jaxftc.healthy_scenario(config, scenario_id=4)
    chex.assert_trees_all_equal(built, jaxftc.paper_scenario("healthy", config, scenario_id=4))
    for joint in range(1, 7):
        built = built.with_actuator_bias(joint, 5.0, 0.1, clear=0.25)
        built = built.with_encoder_bias(joint, angle=math.radians(1.5), onset=0.1, clear=0.25)
    chex.assert_trees_all_equal(built, jaxftc.paper_scenario("both", config, scenario_id=4))


def test_a_motion_of_ones_own(config):
    start, goal = np.zeros(6), np.linspace(0, 1, 6)
    scenario = jaxftc.healthy_scenario(config, q_start=start, q_goal=goal, noise=0.0)
    np.testing.assert_array_equal(scenario.q_start, start)
    np.testing.assert_array_equal(scenario.q_goal, goal)
    assert scenario.noise == 0.0 and not scenario.fault_tau.kind.any()


def test_a_set_takes_a_size_a_scenario(healthy):
    many = stacked(healthy, 3)
    faulty = many.with_encoder_bias(6, np.array([0.1, 0.2, 0.3]), onset=0.4)
    for k in range(3):
        one = healthy.with_encoder_bias(6, 0.1 * (k + 1), 0.4)
        chex.assert_trees_all_close(jax.tree.map(lambda leaf, k=k: leaf[k], faulty), one, rtol=1e-15)


def test_sizes_may_be_traced(healthy):
    def torque(size):
        return healthy.with_actuator_bias(3, size, onset=size).fault_tau.magnitude.sum()

    assert jax.grad(torque)(2.0) == 1.0 and jax.jit(torque)(2.0) == 2.0


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (
            lambda s: s.with_actuator_bias(0, 5.0, 0.1),
            "at least 1, got 0; joints count from 1 to 6",
        ),
        (lambda s: s.with_actuator_bias(7, 5.0, 0.1), "joint must be 1 to 6, got 7"),
        (lambda s: s.with_actuator_bias(1.0, 5.0, 0.1), "joint must be an integer"),
        (lambda s: s.with_actuator_bias(1, math.nan, 0.1), "magnitude must be finite, got nan"),
        (lambda s: s.with_encoder_bias(1, 0.1, math.inf), "onset must be finite, got inf"),
        (lambda s: s.with_encoder_bias(1, 0.1, -0.1), "onset must not be less than 0, got -0.1"),
        (lambda s: s.with_encoder_drift(1, 0.1, 0.2, clear=0.2), "clear must be later than the onset, got 0.2"),
        (lambda s: s.with_encoder_drift(1, 0.1, 0.2, clear=math.nan), "clear must be later than the onset, got nan"),
        (lambda s: s.with_actuator_loss(1, 1.5, 0.2), r"share must lie in \[0, 1\], got 1.5"),
        (lambda s: s.with_actuator_saturation(1, -0.5, 0.2), r"share must lie in \[0, 1\], got -0.5"),
        (lambda s: s.with_encoder_delay(1, 6, 0.2), r"ticks must lie in \[0, 5\], got 6"),
        (lambda s: s.with_actuator_delay(1, -1, 0.2), r"ticks must lie in \[0, 5\], got -1"),
        (lambda s: s.with_joint_friction(1, -1.0, 0.2), "torque must not be less than 0, got -1.0"),
        (lambda s: s.with_encoder_rounding(1, -0.1, 0.2), "angle must not be less than 0, got -0.1"),
        (lambda s: s.with_encoder_wrap(1, 0.0, 0.2), "angle must be positive, got 0.0"),
        (lambda s: s.with_encoder_noise(1, -1.0, 0.2), "factor must not be less than 0, got -1.0"),
        (lambda s: s.with_frozen_encoder(1, 0.2, duty=2.0), r"duty must lie in \[0, 1\], got 2.0"),
        (lambda s: s.with_frozen_encoder(1, 0.2, period=0.0), "period must be positive, got 0.0"),
        (lambda s: s.with_frozen_encoder(1, 0.2, raise_=1.0), "did you mean 'rise'"),
        (lambda s: s.with_encoder_bias(1, np.ones(2), 0.2), r"magnitude must be a number or have shape \[\], got \[2\]"),
        (lambda s: trail(stacked(s, 2)).with_frozen_encoder(1, 0.2), "or to a set with a leading axis, got fault_q of"),
    ],
)
def test_what_cannot_be_is_refused(healthy, call, text):
    with pytest.raises(ValueError, match=text):
        call(healthy)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"q_start": np.zeros(5)}, r"q_start must have shape \[6\], an angle in rad a joint, got \[5\]"),
        ({"q_goal": [math.nan] * 6}, "q_goal must be finite"),
        ({"noise": -1.0}, "noise must be finite and not negative"),
        ({"resolution": True}, "resolution must be finite and not negative, in rad, got True"),
    ],
)
def test_a_motion_that_cannot_be_is_refused(config, options, text):
    with pytest.raises(ValueError, match=text):
        jaxftc.healthy_scenario(config, **options)
