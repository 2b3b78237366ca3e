"""The benchmark suites' arithmetic on cases with a known answer; the suites themselves run as commands."""

import dataclasses

import numpy as np
import pytest

import jaxftc
from benchmarks import curves, ranking
from benchmarks import report as bench_report
from benchmarks.cli import ranking_text, tuning_text
from benchmarks.curves import Curve
from tuning import Progress, Settings
from tuning.settings import GRADIENT_COST, METHODS


def curve(method, seed, objective):
    points = len(objective)
    return Curve(method, seed, np.arange(points) * 100.0, np.arange(points) * 2.0, np.array(objective), 1.0)


@pytest.fixture
def found():
    slow = {"cmaes": [3.0, 2.5, 2.0], "random": [3.0, 2.9, 2.8], "finite": [3.0, 3.0, 3.0]}
    return [curve(m, s, slow.get(m, [3.0, 2.0 + s, 1.0])) for s in (0, 1) for m in METHODS]


def test_how_much_sooner_the_gradient_is_there(found):
    verdicts = curves.verdicts(found)
    assert verdicts["cmaes"]["gradient_needs_times_fewer"] == [2.0, 1.0]  # at 100 of 200, at 200 of 200
    assert verdicts["random"]["gradient_needs_times_fewer"] == [2.0, 1.0]
    assert verdicts["finite"]["gradient_needs_times_fewer"] == [None, None]  # no better than the start
    assert verdicts["finite"]["gradient_needs_times_fewer_median"] is None
    assert verdicts["gradient"]["final_median"] == 1.0 and verdicts["gradient"]["simulations"] == 200.0
    assert curves.reached(found[0], 0.5) == np.inf and curves.reached(found[0], 2.0, "seconds") == 2.0
    text, page = tuning_text(5.0, verdicts), bench_report.curves_page(found, 5.0)
    assert (
        "a gradient counts as 5.0 simulations" in text
        and "2.0, 1.0" in text
        and "not better than the start" in text
        and "held-out objective" in page
    )


def test_a_curve_counts_gradients_at_their_measured_cost_and_leaves_out_compilation():
    settings = Settings(steps=20, batch=10)
    path = []
    for k in range(1, 5):
        step = 5 * k
        spent = step * 10 * (GRADIENT_COST + 1) + 100 * k
        path.append((Progress(step, 20, spent, 30.0 + 2.0 * (k - 1), 0.0, 0.0, 0.0, 0.0), step))
    made = curves._curve("gradient", 3, path, GRADIENT_COST + 2.0, settings, lambda step: 1.0 / step, 9.0)
    assert made.simulations[-1] == 20 * 10 * (GRADIENT_COST + 3) + 400
    assert made.objective[0] == 9.0 and made.objective[-1] == 0.05
    assert made.compile_s == 28.0 and made.seconds.tolist()[-1] == 8.0
    other = curves._curve("random", 3, path, GRADIENT_COST + 2.0, settings, lambda step: 1.0, 9.0)
    assert other.simulations[-1] == path[-1][0].simulations
    assert curves._curve("finite", 3, path[:1], 5.0, settings, lambda step: 1.0, 9.0).compile_s is None


def test_ratios_are_paired_and_named():
    random = np.random.default_rng(0)
    was = np.exp(random.normal(size=200))
    assert ranking._pair("tracking", 1, "smc", "esmc", was, 0.9 * was, 0.0).word == "falls"
    assert ranking._pair("tracking", 1, "smc", "esmc", was, 1.1 * was, 0.0).word == "rises"
    noisy = ranking._pair("tracking", 1, "smc", "esmc", was, was * np.exp(random.normal(size=200)), 0.0)
    assert noisy.word == "tie" and noisy.ratio.low < 1 < noisy.ratio.high


def test_controllers_are_read_off_where_they_chatter_alike():
    """Tracking is 1 over chattering for each; at the level of ESMC the second is twice as good as the first."""
    level = ranking.SWEEP[:, None] * np.linspace(1.0, 2.0, 40)
    chattering = {"smc": 3 * level, "esmc": level, "afesmc": 0.7 * level}
    tracking = {"smc": 2 / (3 * level), "esmc": 1 / level, "afesmc": 1 / (0.7 * level)}
    made = {name: np.stack([chattering[name], tracking[name]]) for name in chattering}
    pairs = list(ranking._tracking(made, np.arange(40) % 4))
    assert len(pairs) == 8 and all(pair.louder == 0 and pair.n == 10 for pair in pairs)
    for pair in pairs:
        assert pair.ratio.value == pytest.approx(0.5 if pair.before == "smc" else 1.0, rel=1e-9)
    made["smc"][0] += 100.0  # cannot be made as calm
    assert all(pair.louder == 1.0 for pair in ranking._tracking(made, np.arange(40) % 4) if pair.before == "smc")
    notes = {"surface": {"lowest": 0.5}}
    assert "falls" in ranking_text(pairs, notes) and "lowest 0.500" in bench_report.ranking_page(pairs, notes)


def test_a_run_that_diverged_has_a_huge_error_not_none():
    assert (ranking._error(np.array([0.5, 1.0, 10.0])) == np.array([1.0, 1e6 - 1, 1e6 - 1])).tolist()[0]
    assert np.isfinite(ranking._error(np.array([1.0, 10.0]))).all()


def test_surfaces_of_known_shape(config):
    gains = jaxftc.default_gains(config)
    flat = dataclasses.replace(gains, control=dataclasses.replace(gains.control, outputs=np.full(3, 1.5)))
    assert ranking.surface(config, flat).lowest == pytest.approx(1.5) == ranking.surface(config, flat).highest
    by_s = ranking.surface(dataclasses.replace(config, rules="s_only"), gains)
    assert by_s.by_s == pytest.approx(1.0) and by_s.by_q == pytest.approx(0.0, abs=1e-12)
    printed = ranking.surface(config, gains)
    assert 0.5 <= printed.lowest < 0.7 and 2.3 < printed.highest <= 2.5 and printed.by_s < 0.2
