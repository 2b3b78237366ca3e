"""The tuning loop: it finds better gains, goes on where it was stopped, undoes what runs away, and says what is wrong."""

import dataclasses
import types

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import jaxftc
from jaxftc.cli.common import numbers
from jaxftc.scenarios.scenario import take, trail
from tests.arms import two_hinges
from tuning import OBJECTIVE, Problem, Settings, Term, checkpoint, fit, loop, methods, search, terms
from tuning.settings import GRADIENT_COST, round_length

FREE = ["baseline"]
SMALL = Settings(steps=10, batch=8, validation=4, learning_rate=0.2)


@pytest.fixture(scope="module")
def arm():
    """A short run of the simplest scheme, which compiles quickly; ``test_tuning_gradients.py`` has the cascade."""
    return jaxftc.Config(two_hinges(), engine="chain", scheme="computed_torque", duration=0.1)


@pytest.fixture(scope="module")
def scenarios(arm):
    """Scenarios of ``standard`` whose faults come within the short run."""
    many = take(jaxftc.sample_scenarios(jax.random.key(0), 24, config=arm), slice(None))
    early = lambda fault: fault._replace(onset=0.1 * fault.onset)  # noqa: E731
    return many._replace(fault_tau=early(many.fault_tau), fault_q=early(many.fault_q))


@pytest.fixture(scope="module")
def tuned(arm, scenarios):
    seen = []
    result = run(arm, scenarios, on_round=lambda progress, best: seen.append((progress, best)))
    return result, seen


def run(arm, scenarios, start=None, **more):
    options = {"settings": SMALL, "key": jax.random.key(1), "only": FREE} | more
    return fit(arm, start or jaxftc.default_gains(arm), scenarios, **options)


def same(a, b):
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_array_equal(x, y)


def test_it_finds_better_gains_and_says_how(arm, scenarios, tuned):
    result, seen = tuned
    problem = Problem(arm, OBJECTIVE, jax.random.key(1), SMALL.batch)
    before, after = (problem.scores(g, take(scenarios, slice(-4, None))) for g in (jaxftc.default_gains(arm), result.gains))
    assert problem.loss(after, before) < 0.95 * problem.total(before)
    history = result.history
    assert history["step"].tolist() == [5, 10] and [p.step for p, _ in seen] == [5, 10]
    assert history["best"][-1] == pytest.approx(problem.loss(after, before), rel=1e-9)
    assert {f"term_{name}" for name in OBJECTIVE} < set(history)
    assert result.simulations == 4 + 10 * SMALL.batch * (GRADIENT_COST + 1) + 2 * 4
    assert (result.stopped, result.events) == ("all steps done", [])
    same(seen[-1][1], result.gains)
    same(result.gains.arx, jaxftc.default_gains(arm).arx)


def test_a_run_that_was_stopped_goes_on_to_the_same_gains(arm, scenarios, tuned, tmp_path):
    class Stopped(Exception):
        pass

    def stop(progress, best):
        if progress.step == 10:
            raise Stopped

    with pytest.raises(Stopped):
        run(arm, scenarios, folder=tmp_path, on_round=stop)
    steps = []
    result = run(arm, scenarios, folder=tmp_path, on_round=lambda progress, best: steps.append(progress.step))
    assert steps == [10]
    same(result.gains, tuned[0].gains)
    for name, column in tuned[0].history.items():
        if name != "seconds":
            np.testing.assert_array_equal(result.history[name], column)
    again = run(arm, scenarios, folder=tmp_path, on_round=lambda *_: pytest.fail("a finished run has nothing left to do"))
    same(again.gains, result.gains)


def test_a_checkpoint_of_another_run_is_refused(arm, scenarios, tmp_path):
    short = dataclasses.replace(SMALL, method="random", steps=1)
    tmp_path = tmp_path / "new" / "folder"
    run(arm, scenarios, folder=tmp_path, settings=short)
    with pytest.raises(ValueError, match=r"settings differ.*0.2, here 0.1"):
        run(arm, scenarios, folder=tmp_path, settings=dataclasses.replace(short, learning_rate=0.1))
    with pytest.raises(ValueError, match="its scenarios differ"):
        run(arm, take(scenarios, slice(20)), folder=tmp_path, settings=short)
    (tmp_path / checkpoint.NAME).write_bytes(b"PK torn")
    with pytest.raises(ValueError, match="is no checkpoint of a tuning run"):
        run(arm, scenarios, folder=tmp_path, settings=short)


@pytest.mark.parametrize("method", ["cmaes", "random"])
def test_searches_stay_within_their_budget_and_resume(arm, scenarios, method, tmp_path):
    settings = dataclasses.replace(SMALL, method=method, steps=20, patience=1.0)
    whole = run(arm, scenarios, settings=settings)
    assert whole.history["validation"].min() <= whole.history["validation"][0]
    assert np.isnan(whole.history["gradient_norm"]).all()
    size = methods.transform.space(arm, jaxftc.default_gains(arm), FREE).size
    per_step = {"cmaes": search.Evolution(size, 0).population, "random": 2}[method] * settings.batch
    assert settings.budget - per_step * (whole.history["step"][0] + 1) < whole.steps * per_step <= settings.budget
    assert len(whole.history["step"]) >= 3

    class Stopped(Exception):
        pass

    def stop(progress, best):
        if progress.step == whole.history["step"][1]:
            raise Stopped

    with pytest.raises(Stopped):
        run(arm, scenarios, settings=settings, folder=tmp_path, on_round=stop)
    same(run(arm, scenarios, settings=settings, folder=tmp_path).gains, whole.gains)


@pytest.mark.thorough
def test_finite_differences_descend(arm, scenarios):
    settings = dataclasses.replace(SMALL, method="finite", steps=8, patience=1.0)
    result = run(arm, scenarios, settings=settings, only=["baseline.kp", "baseline.kd"], shared=["baseline"])
    assert result.steps == settings.budget // (SMALL.batch * 3)  # two numbers and the point itself
    assert result.best_step > 0


def test_what_runs_away_is_undone_and_told(arm, scenarios):
    """Steps that are far too long are taken back and shortened until they are not, or given up after some tries."""
    objective = {"away": Term(1.0, lambda r: 1e-3 + jnp.abs(jnp.log(r.gains.baseline.kp / 625.0) - 0.01).mean(0), True)}
    settings = dataclasses.replace(SMALL, steps=30, learning_rate=3.0, patience=1.0)
    options = {"settings": settings, "objective": objective, "only": ["baseline.kp"]}
    result = run(arm, scenarios, **options)
    assert result.events and all("away rose from 0.011 to" in event for event in result.events)
    assert "back to the gains of step 0" in result.events[0] and result.stopped == "all steps done"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "RECOVERIES", 1)
        result = run(arm, scenarios, **options)
    assert len(result.events) == 2
    assert "the loss ran away 2 times" in result.stopped and "lower learning_rate" in result.stopped
    same(result.gains, jaxftc.default_gains(arm))  # the start, to the bit


class Plain:
    size, free, layout = 1, (), types.SimpleNamespace(leaves=())

    def padded(self, theta):
        return theta


class Constant:
    """A problem whose slope is 1 everywhere."""

    key, kind, cached_as, program_kind, sharding = jax.random.key(0), ("constant",), None, "batch", None

    def slope_of(self, layout, mode, size):
        return lambda key, free, theta, widen, scenarios, start: (jnp.zeros((1, 2)), jnp.ones((1, 2)))


def test_after_a_restart_the_rate_goes_on_from_where_it_was():
    descent = methods.Descent(Constant(), Plain(), mode="reverse", optimizer="sgd", rate=0.1, steps=20)

    def length(step, rate):
        state = descent.init(np.zeros(1), step, rate)
        return abs(float(descent.round(state, np.ones(1), jnp.zeros((1, 1)), np.zeros((1, 1)))[0].theta[0]))

    done, _ = descent.round(descent.init(np.zeros(1)), np.ones(15), jnp.zeros((15, 1)), np.zeros((15, 1)))
    assert done.step == 15
    assert length(15, 0.3) == pytest.approx(0.3 * length(15, 1.0), rel=1e-5)
    assert length(15, 1.0) < 0.3 * length(1, 1.0)  # it has decayed, and a restart does not warm it up again


def test_searches_have_nothing_to_undo(arm, scenarios):
    objective = {"away": Term(1.0, lambda r: 1e-3 + jnp.abs(jnp.log(r.gains.baseline.kp / 625.0)).mean(0), True)}

    class Wild(search.Random):
        def generation(self, judge):
            losses = super().generation(judge)
            self.theta = self.theta + 1.0
            return losses

    settings = dataclasses.replace(SMALL, method="random", steps=40, patience=1.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(methods.search, "Random", Wild)
        result = run(arm, scenarios, settings=settings, objective=objective, only=["baseline.kp"])
    assert (result.events, result.stopped) == ([], "all steps done")


@pytest.mark.thorough
def test_one_run_with_a_gradient_without_end_does_not_turn_the_step(arm, scenarios):
    """A term whose slope is not a number on one scenario, and a million on another."""

    def spiked(r):
        factor = jnp.where(r.scenario.id % 4 == 1, 1e6, 1.0)
        kp = r.gains.baseline.kp.mean(0) / 625.0
        root = jnp.sqrt(jnp.where(r.scenario.id % 4 == 2, 0.0 * kp, kp))
        return factor * root + 0 * r.trace.q[0, 0]

    problem = Problem(arm, {"spiked": Term(1.0, spiked)}, jax.random.key(1), 4)
    space = methods.transform.space(arm, jaxftc.default_gains(arm), ["baseline.kp"], ["baseline"])
    slope = jax.jit(problem.slope(space, "reverse"))
    batch = trail(take(scenarios, slice(4)))
    _, slopes = slope(problem.key, jnp.zeros(1), jnp.ones(()), batch, jnp.full((1, 4), np.inf))
    np.testing.assert_allclose(slopes[0], [0.5, 1.0, 0.0, 0.5], rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scenarios": slice(0)}, "a set of at least one with a leading axis"),
        ({"scenarios": slice(3)}, "3 scenarios are too few to keep some back for validation; give at least 4"),
        ({"validation": slice(0)}, "validation must be a set of at least one"),
        ({"scenarios": 0}, r"scenarios must be a set .* got ids of shape \[\]; draw them"),
        ({"objective": {}}, "the objective has no terms"),
        ({"limits": {"dely": 0.1}}, "the term of a limit must be one of .* did you mean 'delay'"),
        ({"limits": {"delay": np.nan}}, "the limit of delay must be finite and not negative, got nan"),
        ({"freeze": ["baseline"]}, "every gain is frozen"),
        ({"only": ["baseline.kpp"]}, "did you mean 'baseline.kp'"),
        ({"only": ["kp"]}, "did you mean 'baseline.kp'"),
        ({"freeze": ["kd"]}, "did you mean 'baseline.kd'"),
        ({"shared": ["speed_weight"]}, "did you mean 'baseline.speed_weight'"),
        ({"start": jnp.nan}, "baseline.kp must be finite"),
    ],
)
def test_bad_input_is_refused(arm, scenarios, change, message):
    start = None
    if "start" in change:
        gains = jaxftc.default_gains(arm)
        start = gains.replace({"baseline.kp": change.pop("start")})
    some = take(scenarios, change.pop("scenarios", slice(None)))
    if "validation" in change:
        change["validation"] = take(scenarios, change["validation"])
    with pytest.raises(ValueError, match=message):
        run(arm, some, start, **change)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("method", "gradent", "did you mean 'gradient'"),
        ("steps", 0, "steps must be an integer of at least 1"),
        ("batch", 0, "batch must be an integer of at least 1"),
        ("learning_rate", -1.0, "learning_rate must be a positive"),
        ("anneal", (1.0, 0.0), "anneal must be two positive factors"),
        ("patience", 2.0, "patience must be a share of the steps, at most 1, got 2.0"),
        ("optimizer", "adm", "did you mean 'adam'"),
        ("optimizer", 3, "optimizer must be one of 'adam', 'lion', 'sgd', got 3"),
    ],
)
def test_settings_are_checked(field, value, message):
    with pytest.raises(ValueError, match=message):
        Settings(**{field: value}).check()


def test_an_optimiser_of_ones_own_makes_the_steps_of_the_built_in_one(arm, scenarios, tuned, tmp_path):
    own = lambda **more: dataclasses.replace(SMALL, optimizer=optax.adam(1.0, b2=0.99, **more))  # noqa: E731
    result = run(arm, scenarios, settings=own(), folder=tmp_path)
    same(result.gains, tuned[0].gains)
    same(run(arm, scenarios, settings=own(), folder=tmp_path).gains, result.gains)  # made anew it does the same
    with pytest.raises(ValueError, match=r"another run: its settings differ .*optimizer 'own"):
        run(arm, scenarios, settings=own(eps=1e-3), folder=tmp_path)


def away(r):
    return 1e-3 + jnp.abs(jnp.log(r.gains.baseline.kp / 625.0) - 0.5).mean(0)


def stiffness(r):
    return r.gains.baseline.kp.mean(0)


@pytest.mark.parametrize("method", ["gradient", "random"])
def test_gains_beyond_a_limit_are_never_chosen(arm, scenarios, method, tmp_path):
    """The objective wants kp = 1,030, the limit says 800."""
    objective = {"away": Term(1.0, away, True), "stiffness": Term(0.0, stiffness, True)}
    settings = dataclasses.replace(SMALL, method=method, steps=40, learning_rate=0.05, patience=1.0)
    options = {"settings": settings, "objective": objective, "only": ["baseline.kp"], "shared": ["baseline"]}
    free = run(arm, scenarios, **options)
    assert free.gains.baseline.kp[0] > 800.0 and free.within_limits and free.limits == {}
    held = run(arm, scenarios, limits={"stiffness": 800.0}, folder=tmp_path, **options)
    assert held.gains.baseline.kp[0] <= 800.0 and held.within_limits
    assert held.best_step > 0 or method == "random"  # the search follows the loss alone, and may step over the limit
    assert held.validation["stiffness"] == pytest.approx((625.0, float(held.gains.baseline.kp[0])))
    again = run(arm, scenarios, limits={"stiffness": 800.0}, folder=tmp_path, **options)
    same((again.gains, again.validation), (held.gains, held.validation))
    with pytest.raises(ValueError, match="another run: its limits differ"):
        run(arm, scenarios, limits={"stiffness": 790.0}, folder=tmp_path, **options)


def test_a_start_beyond_a_limit_gives_way_to_the_first_gains_within(arm, scenarios):
    """They are chosen although their loss is higher; where there are none, the start is the answer, and says so."""
    objective = {"away": Term(1.0, away, True), "stiffness": Term(0.0, stiffness, True)}
    settings = dataclasses.replace(SMALL, steps=20, learning_rate=0.05, patience=1.0)
    options = {"settings": settings, "objective": objective, "only": ["baseline.kp"], "shared": ["baseline"]}
    start = jaxftc.default_gains(arm).replace({"baseline.kp": 1200.0})
    within = run(arm, scenarios, start, limits={"stiffness": 1150.0}, **options)
    assert within.gains.baseline.kp[0] <= 1150.0 and within.within_limits
    none = run(arm, scenarios, start, limits={"stiffness": 30.0}, **options)
    same(none.gains, start)
    assert not none.within_limits and none.best_step == 0 and np.isinf(none.history["best"]).all()


def test_weights_of_terms(arm):
    changed = terms.weighted(OBJECTIVE, {"delay": 3.0, "effort": 0})
    assert {n for n in OBJECTIVE if changed[n] != OBJECTIVE[n]} == {"delay", "effort"}
    assert (changed["delay"].weight, changed["effort"].weight) == (3.0, 0.0)
    assert changed["delay"].value is OBJECTIVE["delay"].value
    with pytest.raises(ValueError, match=r"got 'dely'.*'delay'"):
        terms.weighted(OBJECTIVE, {"dely": 3.0})
    with pytest.raises(ValueError, match=r"weight of delay.*-1.0"):
        terms.weighted(OBJECTIVE, {"delay": -1.0})


def test_words_of_the_command_line_name_a_term_and_a_number():
    assert numbers("--weight", ("delay=3", "tracking=0.5"), "delay=3") == {"delay": 3.0, "tracking": 0.5}
    for words, text in ((("delay",), "with a number each, such as delay=3, got 'delay'"), (("a=1", "a=2"), "'a' twice")):
        with pytest.raises(ValueError, match=text):
            numbers("--limit", words, "delay=3")


def test_rounds_divide_the_steps():
    assert [round_length(steps) for steps in (1, 7, 8, 10, 100)] == [1, 1, 4, 5, 5]


def test_validation_has_a_noise_of_its_own(arm, scenarios):
    training, validation = loop._split(arm, jaxftc.default_gains(arm), scenarios, take(scenarios, slice(5)), SMALL)
    assert not set(training.id) & set(validation.id)
    np.testing.assert_array_equal(np.diff(validation.id), np.diff(scenarios.id[:5]))


def test_what_the_checkpoint_belongs_to(arm, scenarios):
    """Gains that move alike are another theta of the same length."""
    start, problem = jaxftc.default_gains(arm), Problem(arm, OBJECTIVE, jax.random.key(0), 4)
    some = take(scenarios, slice(4))
    identities = []
    for shared in ("baseline.kp", "baseline.kd"):
        space = methods.transform.space(arm, start, ["baseline.kp", "baseline.kd"], [shared])
        identities.append(checkpoint.identity(problem, space, some, some, SMALL))
    assert space.size == arm.n + 1 and identities[0] != identities[1]


def test_every_scenario_is_used_before_any_is_used_again(arm, scenarios):
    batches = methods.Batches(
        Problem(arm, OBJECTIVE, jax.random.key(0), 5), jaxftc.default_gains(arm), take(scenarios, slice(12))
    )
    dealt = np.concatenate([batches.rows(step) for step in range(12)])
    for epoch in range(5):
        assert sorted(dealt[12 * epoch : 12 * (epoch + 1)]) == list(range(12))
    assert not np.array_equal(dealt[12:24], dealt[24:36])
