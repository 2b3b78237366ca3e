"""Figures with intervals against resampling and against SciPy's distributions."""

import math

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st
from scipy import stats

from jaxftc.evaluation.intervals import LEVEL, bootstrap, median, share, tolerated


@pytest.mark.parametrize("n", [5, 50, 501])
def test_the_median_interval_is_the_bootstrap_without_its_chance(n):
    x = np.random.default_rng(3).exponential(size=n)
    exact, drawn = median(x), bootstrap(x[None], lambda y: np.median(y[0], -1))
    assert exact.value == np.median(x)
    ranks = [np.searchsorted(np.sort(x), v) for pair in zip(exact[1:], drawn[1:], strict=True) for v in pair]
    assert abs(ranks[0] - ranks[1]) <= 0.02 * n + 1 and abs(ranks[2] - ranks[3]) <= 0.02 * n + 1


def test_the_median_interval_covers_as_often_as_it_says():
    draws = np.random.default_rng(5).normal(size=(2000, 101))
    found = [median(x) for x in draws]
    assert 0.92 < np.mean([m.low <= 0.0 <= m.high for m in found]) < 0.98


def test_a_missed_fault_is_infinitely_late_and_not_left_out():
    assert median(np.array([1.0, 2.0, np.inf])).value == 2.0
    assert median(np.array([1.0, np.inf, np.inf]))[0] == np.inf
    assert median(np.array([1.0, np.inf])).value == np.inf
    assert median(np.array([np.inf, np.inf])) == (np.inf, np.inf, np.inf)
    assert all(math.isnan(v) for v in median(np.array([])))


@hypothesis.given(st.integers(1, 400), st.data())
def test_shares_have_the_interval_of_clopper_and_pearson(n, data):
    k = data.draw(st.integers(0, n))
    expected = stats.binomtest(k, n).proportion_ci(LEVEL, method="exact")
    np.testing.assert_allclose(share(k, n), (k / n, expected.low, expected.high), atol=1e-9)


def test_a_share_of_nothing_is_not_a_number():
    assert all(math.isnan(v) for v in share(0, 0))


@hypothesis.given(st.integers(1, 5000), st.floats(0.001, 0.2), st.floats(0.5, 0.99))
def test_what_is_tolerated_is_the_most_that_the_confidence_allows(n, p, confidence):
    k = tolerated(n, p, confidence)
    assert k == -1 or stats.binom.cdf(k, n, p) <= 1 - confidence + 1e-9
    assert stats.binom.cdf(k + 1, n, p) > 1 - confidence - 1e-9


def test_bootstrap_intervals_cover_as_often_as_they_say():
    random = np.random.default_rng(0)
    mean = lambda x: x[0].mean(-1)  # noqa: E731
    intervals = [bootstrap(random.exponential(size=(1, 60)), mean, seed) for seed in range(200)]
    assert 0.89 < np.mean([low <= 1.0 <= high for _, low, high in intervals]) < 0.98
