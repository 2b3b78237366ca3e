"""Sets that are known to have common kinds of fault only run smaller programs, with the same numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc.scenarios.faults import Actuator, Sensor
from jaxftc.scenarios.scenario import healthy_scenario, stack
from jaxftc.simulation.closed_loop import simulate
from tests.arms import two_hinges

KEY = jax.random.key(3)


@pytest.fixture(scope="module")
def config():
    return jaxftc.Config(two_hinges(), engine="chain", duration=0.3)


@pytest.fixture(scope="module")
def drawn(config):
    return jaxftc.sample_scenarios(KEY, 24, "standard", config=config)


def test_a_set_knows_whether_its_preset_has_uncommon_kinds(config, drawn):
    uncommon = jaxftc.sample_scenarios(KEY, 4, "uncommon", config=config)
    assert (drawn.uncommon, uncommon.uncommon) == (None, ())
    assert jaxftc.sample_scenarios(KEY, 4, "paper", config=config).uncommon is None


def test_one_that_has_them_makes_them_known_to_all_of_a_set(config):
    plain = healthy_scenario(config)._replace(uncommon=None)
    assert plain.with_actuator_bias(1, 1.0, 0.1).uncommon is None
    locked = plain.with_locked_joint(1, 0.1)
    assert locked.uncommon == () == stack([plain, locked]).uncommon
    assert stack([plain, plain]).uncommon is None


@pytest.mark.thorough
def test_knowing_it_changes_no_number(config, drawn):
    """To rounding: the programs differ, and so may their last digits."""
    gains = jaxftc.default_gains(config)
    known, asked = (simulate(config, gains, some, KEY) for some in (drawn, drawn._replace(uncommon=())))
    for name in ("q", "y", "tau_applied", "fault_tau", "fault_q"):
        np.testing.assert_allclose(getattr(known, name), getattr(asked, name), rtol=1e-4, atol=1e-5, err_msg=name)
    assert np.mean(np.asarray(known.out.verdict) != np.asarray(asked.out.verdict)) < 1e-3


@pytest.mark.parametrize(("channel", "kind"), [("fault_tau", Actuator.SATURATION), ("fault_q", Sensor.DROPOUT)])
def test_an_uncommon_kind_in_a_set_without_is_refused(config, drawn, channel, kind):
    fault = getattr(drawn, channel)
    wrong = drawn._replace(**{channel: fault._replace(kind=jnp.full_like(fault.kind, int(kind)))})
    with pytest.raises(ValueError, match=rf"common kinds of fault only, got <{type(kind).__name__}\.{kind.name}"):
        simulate(config, jaxftc.default_gains(config), wrong, KEY)


def test_under_a_trace_it_is_no_number(config):
    """Nobody can look at a traced kind: it must not pass for healthy."""
    plain, gains = healthy_scenario(config)._replace(uncommon=None), jaxftc.default_gains(config)

    @jax.jit
    def largest(kind):
        fault = plain.fault_tau._replace(kind=jnp.full(2, kind, jnp.int32))
        return jnp.abs(simulate(config, gains, plain._replace(fault_tau=fault), KEY).q).max()

    assert np.isfinite(largest(int(Actuator.BIAS))) and np.isnan(largest(int(Actuator.LOCKED)))
