"""Held-out comparison: paired figures, intervals that hold what they promise, seeds of its own."""

import jax
import numpy as np
import pytest

import jaxftc
from tests.arms import two_hinges
from tuning import Comparison, Term, compare


def comparison(before, after, weights=(1.0, 2.0)):
    return Comparison("standard", "smooth", ("a", "b"), np.array(weights), before, after, None, None)


def test_figures_of_a_known_case():
    before = np.array([[1.0, 3.0, 2.0], [0.0, 0.0, 0.0]])
    c = comparison(before, np.array([[0.5, 1.5, 1.0], [0.0, 0.0, 0.0]]))
    assert c.objective == (2.0, 1.0)
    assert c.ratio == (0.5, 0.5, 0.5)  # paired: every scenario is halved, whichever are drawn
    assert c.term_ratio("a").value == 0.5 and c.term_ratio("b") == (1.0, 1.0, 1.0)
    assert c.median[0].value == 2.0
    assert c.as_dict()["terms"]["a"]["before"] == 2.0
    assert c.diverged == (0, 0)
    assert comparison(before, np.array([[10.0, 10.0, 1.0], [10.0, 0.0, 10.0]])).diverged == (0, 1)


@pytest.mark.thorough
def test_both_signs_on_both_presets_on_scenarios_of_the_key():
    config = jaxftc.Config(two_hinges(), engine="chain", scheme="computed_torque", duration=0.02)
    gains = jaxftc.default_gains(config)
    objective = {"end": Term(1.0, lambda r: r.trace.q[-1].sum(0))}
    with jax.debug_key_reuse(True):
        one, other = (compare(config, gains, gains, jax.random.key(k), n=4, objective=objective, batch=4) for k in (0, 1))
    assert [(c.preset, c.sign) for c in one] == [
        ("standard", "smooth"),
        ("hard", "smooth"),
        ("standard", "hard"),
        ("hard", "hard"),
    ]
    for c in one:
        np.testing.assert_array_equal(c.before, c.after)
    assert not np.isin(one[0].before, other[0].before).any()
    with pytest.raises(ValueError, match="preset must be one of"):
        compare(config, gains, gains, jax.random.key(0), presets=("standrd",), objective=objective)
