"""Contacts of scenarios: how they are built, drawn and refused."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc.campaigns.calibrate import without_faults
from jaxftc.scenarios.contact import ContactLaw, no_contact
from jaxftc.scenarios.distributions import Uniform
from jaxftc.scenarios.preset import Shares
from jaxftc.scenarios.preset_file import load_preset
from jaxftc.scenarios.sample import draw_all
from jaxftc.scenarios.scenario import stack
from tests.arms import three_hinges


@pytest.fixture(scope="module")
def small():
    return jaxftc.Config(three_hinges(), engine="chain", duration=0.1)


@pytest.fixture(scope="module")
def healthy(small):
    return jaxftc.healthy_scenario(small)


@pytest.fixture(scope="module")
def drawn(small):
    preset = load_preset("contact")
    preset = dataclasses.replace(preset, contact=dataclasses.replace(preset.contact, links=(2, 3)))
    return jax.tree.map(np.asarray, draw_all(preset, small, jax.random.key(1), jnp.arange(3000)))


def test_a_contact_has_its_place_direction_size_and_times(healthy):
    found = healthy.with_contact(
        2, 30.0, 0.1, axis=(0.0, 3.0, 4.0), along=0.4, offset=(0.0, 0.05, 0.0), clear=0.3, rise=0.02
    ).contact
    values = {"link": 2, "along": 0.4, "offset": [0.0, 0.05, 0.0], "axis": [0.0, 0.6, 0.8], "size": 30.0}
    values |= {"onset": 0.1, "clear": 0.3, "rise": 0.02, "period": math.inf, "duty": 1.0}
    for name, leaf in found._asdict().items():
        np.testing.assert_allclose(leaf, values[name], err_msg=name)
    assert healthy.contact is None


def test_a_set_has_contacts_only_where_one_of_it_has(small, healthy):
    assert stack([healthy, healthy.with_actuator_bias(1, 8.0, 0.1)]).contact is None
    mixed = stack([healthy, healthy.with_contact(2, 30.0, 0.1)]).contact
    assert mixed.link.tolist() == [0, 2] and mixed.size.tolist() == [0.0, 30.0]
    for preset, there in (("standard", False), ("contact", True)):
        drawn = jaxftc.sample_scenarios(jax.random.key(0), 4, preset, config=small)
        assert (drawn.contact is not None) is there


def test_one_for_a_set_and_one_for_each_of_it(healthy):
    many = stack([healthy] * 3)
    found = many.with_contact(3, jnp.array([0.0, 10.0, 20.0]), 0.1, axis=np.eye(3)).contact
    assert found.axis.shape == (3, 3) and found.offset.shape == (3, 3) and (np.asarray(found.axis) == np.eye(3)).all()
    np.testing.assert_array_equal(found.size, [0.0, 10.0, 20.0])
    np.testing.assert_array_equal(found.link, [3, 3, 3])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"link": 0}, "link must be an integer of at least 1"),
        ({"link": 4}, "link must be 1 to 3, got 4"),
        ({"force": -1.0}, "force must not be less than 0"),
        ({"force": math.nan}, "force must be finite"),
        ({"axis": (0.0, 0.0, 0.0)}, "axis must not be zero"),
        ({"axis": (1.0, 0.0)}, r"axis must have shape \[3\]"),
        ({"along": 1.5}, r"along must lie in \[0, 1\]"),
        ({"offset": (math.inf, 0.0, 0.0)}, "offset must be finite"),
        ({"onset": -0.1}, "onset must not be less than 0"),
        ({"clear": 0.05}, "clear must be later than the onset"),
        ({"until": 1.0}, "the law of a fault"),
    ],
)
def test_what_no_contact_can_be_is_refused(healthy, arguments, said):
    with pytest.raises(ValueError, match=said):
        healthy.with_contact(**{"link": 2, "force": 10.0, "onset": 0.1} | arguments)


def test_a_simulation_refuses_what_no_contact_is(small, healthy):
    gains = jaxftc.default_gains(small)
    for wrong, said in (({"size": -1.0}, "not negative"), ({"link": -1}, "link's number"), ({"axis": jnp.ones(2)}, "shape")):
        contact = no_contact()._replace(**{name: jnp.asarray(value) for name, value in wrong.items()})
        with pytest.raises(ValueError, match=said):
            jaxftc.simulate(small, gains, healthy._replace(contact=contact), jax.random.key(0))


def test_drawn_contacts_keep_their_law(drawn):
    contact, there = drawn.contact, drawn.contact.size > 0
    assert 0.46 < there.mean() < 0.54 and (contact.link[~there] == 0).all() and set(contact.link[there]) == {2, 3}
    assert 0.45 < (contact.link[there] == 2).mean() < 0.55
    assert contact.size[there].min() >= 20 and contact.size[there].max() <= 100 and 55 < contact.size[there].mean() < 65
    assert contact.along.min() >= 0.0 and contact.along.max() <= 1.0
    np.testing.assert_allclose(np.linalg.norm(contact.offset, axis=1), 0.05, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(contact.axis, axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(contact.axis.mean(0), 0.0, atol=0.04)  # every direction is as likely
    np.testing.assert_allclose(contact.axis.T @ contact.axis / 3000, np.eye(3) / 3, atol=0.03)
    assert not (there & ((drawn.fault_tau.kind > 0).any(1) | (drawn.fault_q.kind > 0).any(1))).any()
    assert contact.onset.min() >= 0.1 and contact.onset.max() <= 0.5


def test_what_calibration_runs_on_has_no_contact(drawn):
    assert without_faults(drawn).contact is None


def test_a_preset_needs_the_law_of_what_it_draws(small):
    preset = load_preset("standard")
    with pytest.raises(ValueError, match=r"contact: missing, but 0\.5 of all scenarios have one"):
        dataclasses.replace(preset, shares=Shares(healthy=0.5, contact=0.5))
    for wrong in ({"size": -1.0}, {"along": Uniform((0.0, 2.0))}, {"radius_m": -0.1}, {"links": ()}, {"links": (0,)}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            ContactLaw(**{"size": 10.0} | wrong)
    far = dataclasses.replace(preset, contact=ContactLaw(size=10.0, links=(4,)))
    with pytest.raises(ValueError, match=r"contact\.links: .* has links 1 to 3"):
        jaxftc.sample_scenarios(jax.random.key(0), 2, far, config=small)
