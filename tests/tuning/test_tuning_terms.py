"""The terms against their twin, and what must be true of them whatever the run."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc.evaluation import metrics
from jaxftc.observer import stability
from jaxftc.scenarios.scenario import take, trail
from jaxftc.simulation.closed_loop import lead, rollout
from tests.arms import two_hinges
from tests.twins import terms as twin
from tuning import OBJECTIVE, Problem, Run, Term, transform
from tuning.problem import LOST

pytestmark = pytest.mark.thorough

N = 24


@pytest.fixture(scope="module")
def arm():
    """Coulomb friction, and runs long enough for what is scored after an onset."""
    return jaxftc.Config(two_hinges(), engine="chain", duration=0.4)


@pytest.fixture(scope="module")
def run(arm):
    """Scenarios of ``standard`` whose faults come early enough, and how they went."""
    many = jaxftc.sample_scenarios(jax.random.key(0), 8 * N, config=arm)
    onset = np.asarray(many.fault_tau.onset)[:, 0]
    scenarios = trail(take(many, np.flatnonzero(onset < 0.2)[:N]))
    gains = jaxftc.default_gains(arm)
    return Run(arm, gains, scenarios, rollout(arm, gains, scenarios, jax.random.key(1)))


@pytest.fixture(scope="module")
def values(run):
    return {name: np.asarray(term.value(run)) for name, term in OBJECTIVE.items()}


def test_terms_are_those_of_the_twin(run, values):
    kinds = {"healthy": 0, "faulty": 0}
    for k in range(N):
        scenario = jax.tree.map(lambda leaf: np.asarray(leaf)[..., k], run.scenario)  # noqa: B023
        expected = twin.terms(run.config, scenario, metrics.columns(lead(run.trace), k))
        for name, value in expected.items():
            np.testing.assert_allclose(values[name][k], value, rtol=1e-6, atol=2e-6, err_msg=f"{name} of scenario {k}")
        kinds["faulty" if (scenario.fault_tau.kind + scenario.fault_q.kind).any() else "healthy"] += 1
    assert kinds["healthy"] >= 2 and kinds["faulty"] >= 10


def test_bounded_terms_are_bounded(values):
    for name in ("fault_tau", "fault_q", "tracking", "chattering", "delay"):
        assert (values[name] >= 0).all() and (values[name] <= 1).all(), name


def scaled(run, factor):
    out = run.trace.out
    out = out._replace(threshold_tau=factor * out.threshold_tau, threshold_q=factor * out.threshold_q)
    return run._replace(trace=run.trace._replace(out=out))


@pytest.mark.parametrize("factor", [1.2, 2.0, 5.0])
def test_higher_thresholds_alarm_less_and_later(run, values, factor):
    higher = scaled(run, factor)
    assert (np.asarray(OBJECTIVE["false_alarm"].value(higher)) <= values["false_alarm"]).all()
    early = np.asarray(OBJECTIVE["false_alarm"].value(run)) < 1e-3  # next to nothing was up before: it can only be later
    assert early.sum() >= 3
    assert (np.asarray(OBJECTIVE["delay"].value(higher))[early] >= values["delay"][early] - 1e-4).all()


def test_a_run_without_fault_or_error_costs_next_to_nothing(run):
    still = jax.tree.map(jnp.zeros_like, run.trace)
    still = still._replace(t=run.trace.t)
    still = still._replace(
        out=still.out._replace(threshold_tau=run.trace.out.threshold_tau, threshold_q=run.trace.out.threshold_q)
    )
    healthy = run.scenario._replace(
        fault_tau=run.scenario.fault_tau._replace(kind=0 * run.scenario.fault_tau.kind),
        fault_q=run.scenario.fault_q._replace(kind=0 * run.scenario.fault_q.kind),
    )
    for name, term in OBJECTIVE.items():
        assert np.asarray(term.value(run._replace(trace=still, scenario=healthy))).max() < 1e-4, name


def test_an_alarm_before_onset_is_no_detection(run):
    faulty = (run.scenario.fault_tau.kind + run.scenario.fault_q.kind > 0).any(0)
    always = scaled(run, 1e-6)
    np.testing.assert_allclose(np.asarray(OBJECTIVE["delay"].value(always))[np.asarray(faulty)], 1.0, atol=1e-6)


def test_stability_is_free_inside_and_counts_outside(run):
    assert (np.asarray(OBJECTIVE["stability"].value(run)) == 0).all()
    gains = run.gains.replace({"observer.alpha_i": 20 * run.gains.observer.alpha_i})
    radius = stability.spectral_radius(run.config, gains)
    assert (radius > 1).all()
    value = np.asarray(OBJECTIVE["stability"].value(run._replace(gains=gains)))
    np.testing.assert_allclose(value, (radius - 0.9999).mean() / 1e-3, rtol=0.02)
    torque = dataclasses.replace(run.config, input="torque")
    assert (np.asarray(OBJECTIVE["stability"].value(run._replace(config=torque))) == 0).all()


def test_the_smooth_radius_is_the_spectral_radius(arm):
    random, gains = np.random.default_rng(0), jaxftc.default_gains(arm)
    for observer in ("pi", "ts"):
        config = dataclasses.replace(arm, observer=observer)
        for _ in range(5):
            factor = lambda: jnp.asarray(np.exp(random.uniform(-2, 2, arm.n)))  # noqa: E731
            names = ("alpha_i", "alpha_f1", "leak")
            changed = gains.replace({f"observer.{name}": factor() * getattr(gains.observer, name) for name in names})
            exact = stability.spectral_radius(config, changed)
            np.testing.assert_allclose(stability.smooth_radius(config, changed), exact, atol=2e-4)


def test_a_term_of_the_user_counts(arm, run):
    """Any function of a run is a term; a plain number stands for every scenario; one that is not finite loses the run."""
    objective = {
        "peak": Term(2.0, lambda r: jnp.abs(r.trace.out.tau).max((0, 1))),
        "one": Term(1.0, lambda r: jnp.ones(())),
        "odd": Term(0.0, lambda r: jnp.where(r.scenario.id % 2 == 0, jnp.nan, 3.0)),
    }
    problem = Problem(arm, objective, jax.random.key(1), 8)
    scenarios = take(jax.tree.map(lambda leaf: np.moveaxis(np.asarray(leaf), -1, 0), run.scenario), slice(0, 11))
    scores = problem.scores(run.gains, scenarios)  # 11 in pieces of 8
    odd = np.asarray(scenarios.id) % 2 == 1
    assert odd.any() and not odd.all()
    peak = np.abs(np.asarray(run.trace.out.tau)).max((0, 1))[:11]
    np.testing.assert_allclose(scores, np.where(odd, [peak, np.ones(11), np.full(11, 3.0)], LOST), rtol=1e-9)
    assert problem.total(scores) == pytest.approx(2 * scores[0].mean() + scores[1].mean())


@pytest.mark.slow
def test_a_term_of_gains_alone_counts_as_it_would_in_every_scenario(arm, run):
    """Values and slopes are the same whether it is found once or scenario by scenario."""

    def away(r):
        return (jnp.log(r.gains.control.lam / 20.0) - 0.3).mean(0) ** 2

    arm = dataclasses.replace(arm, observer="pi", control="smc", duration=0.05)
    space = transform.space(arm, jaxftc.default_gains(arm), ["control.lam"])
    scenarios = take(jax.tree.map(lambda leaf: np.moveaxis(np.asarray(leaf), -1, 0), run.scenario), slice(0, 4))
    start, found = jnp.full((2, 4), np.inf), []
    for gains_only in (False, True):
        objective = {"away": Term(3.0, away, gains_only), "tracking": OBJECTIVE["tracking"]}
        problem = Problem(arm, objective, jax.random.key(1), 4)
        slope = jax.jit(problem.slope(space, "reverse"))
        terms, slopes = slope(problem.key, jnp.full(space.size, 0.1), jnp.ones(()), trail(scenarios), start)
        found.append([*terms, slopes, problem.scores(run.gains, scenarios)])
        np.testing.assert_allclose(terms[0], 0.04, rtol=1e-9)
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-15)
