"""The learned decision: its twin, what it never does, its weights as gains, and an arm that it has not seen."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

import jaxftc
from jaxftc import decision_gains
from jaxftc.cli import simulate
from jaxftc.compile.scalars import scalars
from jaxftc.decision_gains import DecisionGains
from jaxftc.diagnosis import alarm, decision_memory, decision_network, learned_decision, sensor_check
from jaxftc.diagnosis.statistics import Statistics
from jaxftc.evaluation import metrics
from jaxftc.gains import align
from tests.arms import three_hinges, two_hinges
from tests.twins import learned_decision as twins

N, TICKS = 3, 240


@pytest.fixture(scope="module")
def config() -> jaxftc.Config:
    return jaxftc.Config(three_hinges(), engine="chain", decision="learned")


@pytest.fixture(scope="module")
def gains(config) -> jaxftc.Gains:
    """With weights that say something else than the rule at nearly every moment."""
    return drawn(jaxftc.default_gains(config))


def drawn(gains: jaxftc.Gains, seed: int = 5) -> jaxftc.Gains:
    rng = np.random.default_rng(seed)
    layers = {name: 0.3 * rng.normal(size=getattr(gains.decision, name).shape) for name in ("first", "second", "last")}
    return gains.replace({f"decision.{name}": value for name, value in (layers | everything_is_known()).items()})


def everything_is_known() -> dict[str, float]:
    return {"low": -1e6, "high": 1e6, "centre": 0.5, "width": 1.0, "last_bias": 0.0, "doubt": 0.1}


def signals(seed: int = 3) -> dict[str, np.ndarray]:
    """Signals of a run [T, n], alarms among them."""
    rng = np.random.default_rng(seed)
    names = ("tau", "q", "e", "residual", "peak", "jumps", "one_way", "equal", "travel", "turns", "age")
    x = {name: rng.normal(size=(TICKS, N)) for name in names}
    x |= {name: 4 * np.abs(x[name]) for name in ("peak", "jumps", "equal", "travel", "turns", "age")}
    x["peak"][rng.uniform(size=(TICKS, N)) < 0.3] = 0.0
    x |= {
        name: np.repeat(rng.uniform(size=(TICKS // 12, N)) < 0.15, 12, 0).astype(float)
        for name in ("up_tau", "up_q", "suspect")
    }
    scale = {"e": 1e-3, "q": 0.02, "travel": 5e-4}
    return x | {name: unit * x[name] for name, unit in scale.items()} | {"threshold": 0.5 + rng.uniform(size=(TICKS, N))}


def inputs_of(config: jaxftc.Config, x: dict[str, np.ndarray]) -> decision_memory.Inputs:
    """The same as the block takes them; every field [T, n]."""
    zero = jnp.zeros((TICKS, N))
    check = sensor_check.State(
        transient=sensor_check.Transient(zero, jnp.asarray(x["age"] / config.dt), jnp.asarray(x["peak"]), zero, zero),
        jumps=sensor_check.Jumps(jnp.asarray(x["jumps"]), jnp.asarray(x["one_way"])),
        freeze=sensor_check.Freeze(zero, jnp.asarray(x["equal"]), zero, zero, jnp.asarray(x["travel"])),
        counts=sensor_check.Counts(zero, zero, jnp.asarray(x["turns"]), zero),
    )
    rule = (x["up_tau"] * (1 - x["suspect"]) + 2 * np.maximum(x["up_q"], x["suspect"])).astype(np.int32)
    return decision_memory.Inputs(
        statistics=Statistics(jnp.asarray(x["tau"]), jnp.asarray(x["q"])),
        threshold_tau=jnp.asarray(x["threshold"]),
        residual_tau=jnp.asarray(x["residual"]),
        e=jnp.asarray(x["e"]),
        absent=zero > 1,
        alarm=alarm.State(jnp.asarray(x["up_tau"]), zero, jnp.asarray(x["up_q"]), zero),
        check=check,
        suspect=jnp.asarray(x["suspect"]),
        verdict=jnp.asarray(rule),
    )


def ran(config: jaxftc.Config, gains: jaxftc.Gains, inputs: decision_memory.Inputs) -> learned_decision.Info:
    """What is said in every tick [T, n]."""
    start = learned_decision.init(config, gains, jnp.zeros(N))
    run = jax.jit(lambda g, s, i: jax.lax.scan(lambda s, i: learned_decision.step(config, g, s, i), s, i))
    return jax.tree.map(np.asarray, run(gains, start, inputs)[1])


def said(config: jaxftc.Config, gains: jaxftc.Gains, inputs: decision_memory.Inputs) -> np.ndarray:
    """Verdicts [T, n]."""
    return ran(config, gains, inputs).verdict


def test_it_says_what_its_twin_says(config, gains):
    """Asked every eighth tick, of an old fault every 16th: in between, and in the gaps of an alarm that came back, the last
    answer stands.
    """
    x, gains = signals(), gains.replace({"decision.last": 2 * gains.decision.last})
    every = decision_memory.period(config)
    assert every == 4
    weights = {f.name: np.asarray(getattr(gains.decision, f.name)) for f in dataclasses.fields(DecisionGains)}
    twin = twins.Twin(N, every * config.dt, np.asarray(gains.observer.jump), np.asarray(gains.diagnosis.alpha_q))
    speaker = twins.Speaker(N, config.dt, 0.1, config.release_ticks, learned_decision.SURE)
    inputs, odds = inputs_of(config, x), np.zeros((2, N))
    rule, expected, guesses = np.asarray(inputs.verdict), [], []
    for k in range(TICKS):
        if k % every == 0:
            shown = twin.look({name: values[k] for name, values in x.items()})
            assert shown.shape[0] == len(decision_network.NAMES)
            odds = twins.answer(weights, shown)
        verdict, guess = speaker.say(rule[k], every * config.dt if k % every == 0 else 0.0, odds)
        expected.append(verdict)
        guesses.append(guess)
    got, unsure = ran(config, gains, inputs)
    np.testing.assert_array_equal(got, expected)
    np.testing.assert_array_equal(unsure, guesses)
    assert 0.1 < unsure[got > 0].mean() < 0.9
    alarmed = (rule > 0).any(1)
    assert (got != rule)[alarmed].any(1).mean() > 0.4, "weights that say what the rule says would prove nothing"
    assert (got > 0)[~alarmed].any(), "nor would alarms that never come back"


def test_many_scenarios_are_answered_as_each_alone(config, gains):
    """Those that hear an answer are asked in groups: here one, several, or none."""
    count, k = 2 * learned_decision.GROUP + 9, jnp.arange(TICKS)[:, None, None]
    each = [inputs_of(config, signals(seed)) for seed in range(count)]
    inputs = jax.tree.map(lambda *leaves: jnp.stack(leaves, -1), *each)
    quiet = (k < 40) | (k >= 80) & (k < 160) & (jnp.arange(count) > 40)
    inputs = inputs._replace(verdict=jnp.where(quiet, 0, jnp.where(k < 200, inputs.verdict, 1)))
    hear = np.asarray((inputs.verdict > 0).any(1).sum(-1))[::8]
    few = (hear > 0) & (hear <= learned_decision.GROUP)
    assert (hear == 0).any() and few.any() and (hear == count).any()

    def run(start: Any, inputs: Any, gains: Any) -> Any:
        return jax.lax.scan(lambda s, i: learned_decision.step(config, gains, s, i), start, inputs)[1]

    start = learned_decision.init(config, gains, jnp.zeros((N, count)))
    together: Any = jax.jit(run)(start, inputs, align(gains, 1))
    single: Any = jax.jit(jax.vmap(run, in_axes=(-1, -1, None), out_axes=-1))(start, inputs, gains)
    np.testing.assert_array_equal(together.verdict, single.verdict)
    np.testing.assert_array_equal(together.unsure, single.unsure)


def test_a_fault_that_comes_and_goes_stays_named_in_its_gaps_and_no_longer(config, gains):
    """Alarms of 20 ms every 60 ms: the first gap is the rule's, the name stays in later ones, after the last for 1.5."""
    inputs = inputs_of(config, signals())
    inputs = jax.tree.map(lambda leaf: jnp.repeat(leaf[7:8], 400, 0), inputs)
    alarmed = (np.arange(400) % 60 < 20) & (np.arange(400) < 200)
    inputs = inputs._replace(verdict=jnp.where(alarmed[:, None], jnp.array([1, 0, 0], jnp.int32), 0))
    up = (said(config, gains, inputs) > 0).any(1)
    last = 199
    np.testing.assert_array_equal(np.flatnonzero(~up), [*range(20, 60), *range(last + 1 + 60, 400)])


def naming(gains: jaxftc.Gains) -> jaxftc.Gains:
    """Weights that name the actuators whose torque alarm is up, with log odds of 1.5 and -1.5."""
    layers = ("first", "first_bias", "second", "second_bias", "last", "centre")
    weights = gains.replace({f"decision.{name}": 0.0 for name in layers}).decision
    weights = dataclasses.replace(
        weights,
        first=weights.first.at[decision_network.NAMES.index("now alarmed"), 0].set(1.0),
        second=weights.second.at[0, 0].set(1.0),
        last=weights.last.at[0, 0].set(3.0),
        last_bias=jnp.array([-1.5, -1.5]),
    )
    return dataclasses.replace(gains, decision=weights)


def with_alarms(config: jaxftc.Config, alarms: np.ndarray, rule: np.ndarray | None = None) -> decision_memory.Inputs:
    """A moment that stays, with torque alarms [T, N] bool; the rule's verdict is the same unless given."""
    inputs = jax.tree.map(lambda leaf: jnp.repeat(leaf[7:8], len(alarms), 0), inputs_of(config, signals()))
    up = jnp.asarray(alarms, float)
    verdict = jnp.asarray(alarms if rule is None else rule, jnp.int32)
    return inputs._replace(alarm=inputs.alarm._replace(tau=up), verdict=verdict)


def test_later_answers_are_averaged_and_first_ones_stand(config, gains):
    """Answers that change from one question to the next, mostly no, change the verdict of the first 0.1 s only."""
    one_way = np.arange(400)[:, None] // 4 % 5 == np.array([[0, 5, 5]])
    one_way[:, 1] = True
    got = said(config, naming(gains), with_alarms(config, one_way, np.ones((400, N))))
    changes = np.flatnonzero((np.diff(got, axis=0) != 0).any(1))
    assert len(changes) > 4 and changes.max() < 100, changes


def test_a_second_fault_is_named_soon_however_old_the_first_is(config, gains):
    alarms = np.zeros((10_400, N), bool)
    alarms[:, 0], alarms[10_000:, 1] = True, True
    got = said(config, naming(gains), with_alarms(config, alarms))
    assert got[9_999].tolist() == [1, 0, 0]
    assert np.flatnonzero(got[:, 1])[0] <= 10_100


def test_an_alarm_of_another_joint_is_another_fault(config, gains):
    """After a short one on joint 1 and a gap: named from the first question on, and joint 1 no more."""
    alarms = np.zeros((400, N), bool)
    alarms[20:40, 0], alarms[240:, 1] = True, True
    got = said(config, naming(gains), with_alarms(config, alarms))
    np.testing.assert_array_equal(got, alarms)


def test_false_alarms_that_come_back_stay_named_for_a_bounded_time(config, gains):
    """20 ms every 280 ms on one joint: the first gap is the rule's, later ones end after 0.15 s."""
    k = np.arange(2800)
    alarms = (k[:, None] % 280 < 20) & (np.arange(N) == 0)
    got = said(config, naming(gains), with_alarms(config, alarms))
    expected = alarms.copy()
    expected[:, 0] |= (k % 280 < 170) & (k >= 280)
    np.testing.assert_array_equal(got > 0, expected)


def test_it_asks_every_tick_of_a_slow_loop(config):
    assert decision_memory.period(dataclasses.replace(config, dt=0.01)) == 1
    assert learned_decision.between(dataclasses.replace(config, dt=0.01)) == 1
    assert decision_memory.period(dataclasses.replace(config, dt=0.0005)) == 8
    assert learned_decision.between(dataclasses.replace(config, dt=0.0005)) == 2


def test_it_names_and_never_decides_whether_there_is_an_alarm(config, gains):
    """A first alarm: where it is up something is said, before and after it nothing."""
    inputs = inputs_of(config, signals())
    first = jnp.arange(TICKS)[:, None] // 20 == 1
    inputs = inputs._replace(verdict=jnp.where(first, jnp.maximum(inputs.verdict, jnp.array([0, 1, 0], jnp.int32)), 0))
    for seed in range(4):
        got = said(config, drawn(gains, seed), inputs)
        np.testing.assert_array_equal((got > 0).any(1), first[:, 0])


@pytest.mark.parametrize("why", ["silent", "unsure", "unfamiliar", "no reading", "not asked since the alarm"])
def test_the_rule_s_verdict_stays(config, gains, why):
    inputs = inputs_of(config, signals())
    if why == "silent":
        gains = gains.replace({"decision.last": 0.0, "decision.last_bias": -3.0})
    elif why == "unsure":
        gains = gains.replace({"decision.doubt": 50.0})
        inputs = inputs._replace(verdict=jnp.where(jnp.arange(TICKS)[:, None] // 20 == 1, 1, 0) + 0 * inputs.verdict)
    elif why == "unfamiliar":
        gains = gains.replace({"decision.high": np.where(np.arange(len(decision_network.NAMES)) == 5, -1.0, 1e6)})
    elif why == "no reading":
        inputs = inputs._replace(absent=inputs.absent.at[:, 1].set(True))
    else:  # alarms that rise and end between two questions
        between = jnp.arange(TICKS)[:, None] % 4 > 0
        inputs = inputs._replace(verdict=jnp.where(between, inputs.verdict, 0))
    verdict, unsure = ran(config, gains, inputs)
    np.testing.assert_array_equal(verdict, inputs.verdict)
    assert (verdict > 0).any()
    asked = why in ("silent", "unsure", "unfamiliar")  # then the name is a guess, which is said once it has been asked
    assert unsure[verdict > 0].any() == asked and not unsure[~(verdict > 0).any(1)].any()
    if asked:
        lasting = (verdict > 0) & (np.roll(verdict, 4, 0) > 0).any(1, keepdims=True)
        assert unsure[lasting].all()


def test_a_pattern_like_none_of_the_training_is_an_unknown_fault_and_not_normal(config, gains):
    """Beyond the range of the training: the alarm stays, whatever the network would say of it."""
    high = np.where(np.arange(len(decision_network.NAMES)) == 0, -1.0, 1e6)
    alarms = np.zeros((60, N), bool)
    alarms[20:50, 1] = True
    inputs = with_alarms(config, alarms)
    for change, guess in ({}, False), ({"decision.high": high}, True):
        verdict, unsure = ran(
            config, naming(gains).replace({"decision.last_bias": -4.0, "decision.last": 8.0} | change), inputs
        )
        np.testing.assert_array_equal((verdict > 0).any(1), alarms.any(1))
        np.testing.assert_array_equal(unsure[24:50, 1], float(guess))


def test_an_answer_below_four_to_one_is_a_guess(config, gains):
    """Of a joint that is named and of one that is called normal beside it."""
    alarms = np.zeros((40, N), bool)
    alarms[:, 1] = True
    for odds, guess in (0.99 * learned_decision.SURE, True), (1.01 * learned_decision.SURE, False):
        weights = naming(gains).replace({"decision.last_bias": -odds, "decision.last": 0.0})
        weights = dataclasses.replace(weights.decision, last=weights.decision.last.at[0, 0].set(2 * odds))
        verdict, unsure = ran(config, dataclasses.replace(gains, decision=weights), with_alarms(config, alarms))
        np.testing.assert_array_equal(verdict[8:], np.tile([0, 1, 0], (32, 1)))
        np.testing.assert_array_equal(unsure[8:], float(guess))


def test_a_memory_in_seconds_is_the_same_at_any_sample_time(config, gains):
    """What is remembered of a step after 0.2 s, asked every 4 ms and every 5 ms."""
    found = []
    for dt in (0.001, 0.005):
        own = dataclasses.replace(config, dt=dt)
        inputs = jax.tree.map(lambda leaf: leaf[7], inputs_of(own, signals()))
        memory = decision_memory.blank(jnp.zeros(N))
        for _ in range(round(0.2 / (dt * decision_memory.period(own)))):
            memory, now = decision_memory.remember(own, gains, memory, inputs)
        found.append(decision_network.shown(own, gains, memory, now, inputs))
    np.testing.assert_allclose(*found, atol=2e-3)


def test_slopes_in_the_weights_are_those_of_finite_differences(config, gains):
    shown = jnp.asarray(np.random.default_rng(2).normal(size=(len(decision_network.NAMES), N)))
    layers = {name: getattr(gains.decision, name) for name in ("first", "first_bias", "second", "last", "last_bias")}

    def cost(layers, shown):
        return (decision_network.logits(dataclasses.replace(gains.decision, **layers), shown) ** 2).sum()

    check_grads(cost, (layers, shown), order=1, atol=1e-5, rtol=1e-5, eps=1e-6)


def test_equal_readings_of_an_arm_at_rest_say_nothing():
    """Without noise, or in whole counts, they stand still with the arm; the network was trained on noisy ones."""
    config = jaxftc.Config(two_hinges(), engine="chain", decision="learned")
    gains, still, onset = jaxftc.default_gains(config), jnp.zeros(config.n), 300
    readings = jnp.zeros((600, config.n)).at[onset:, 0].set(0.1)

    def tick(carry: Any, y: Any) -> Any:
        state, tau = carry
        state, out = jaxftc.step(config, gains, state, jaxftc.Reference(still, still, still), jaxftc.Measurement(y, tau))
        return (state, out.tau), out.verdict

    start = jaxftc.init(config, gains, still), still
    verdict = np.asarray(jax.jit(lambda s, y: jax.lax.scan(tick, s, y)[1])(start, readings))
    assert not verdict[:onset].any()
    np.testing.assert_array_equal(verdict[onset : onset + 250], np.tile([2, 0], (250, 1)))


@pytest.mark.thorough
def test_the_loop_has_finite_slopes_and_hears_nothing_of_it():
    """Torques are those of the rule to the last bit; the gradient of a run is finite, and 0 in the weights."""
    config = jaxftc.Config(two_hinges(), engine="chain", decision="learned", duration=0.16)
    gains = drawn(jaxftc.default_gains(config))
    rule = dataclasses.replace(config, decision="rule")
    scenario, key = jaxftc.paper_scenario("both", config), jax.random.key(1)
    runs = [jaxftc.simulate(c, gains.replace({"diagnosis.alpha_tau": 0.3}), scenario, key) for c in (rule, config)]
    np.testing.assert_array_equal(*(run.out.tau for run in runs))
    np.testing.assert_array_equal(*(run.out.detected for run in runs))
    assert (np.asarray(runs[0].out.verdict) != np.asarray(runs[1].out.verdict)).any()
    trace = metrics.columns(runs[1])
    trace["unsure"] = np.where(trace["verdict"] > 0, [0.0, 1.0], 0.0)
    said = simulate.summary(config, trace, metrics.evaluate(config, trace))
    assert [joint["unsure"] for joint in said["joints"]] == [False, True]
    assert f"kind unknown: what is said of {config.robot.joint_names[1]} is a guess" in simulate.table("run", said)
    slopes = jax.grad(lambda g: (jaxftc.simulate(config, g, scenario, key).out.residual_tau ** 2).sum())(gains)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))
    assert not any(np.any(leaf) for leaf in jax.tree.leaves(slopes.decision))


# Its weights are gains.


def test_weights_are_there_where_they_are_used(config, gains, tmp_path):
    rule = dataclasses.replace(config, decision="rule")
    assert jaxftc.default_gains(rule).decision is None
    with pytest.raises(ValueError, match=r"gains.decision lacks the weights"):
        jaxftc.init(config, jaxftc.default_gains(rule), jnp.zeros(N))
    own, without = tmp_path / "own.toml", tmp_path / "without.toml"
    jaxftc.save_gains(own, gains, config)
    jaxftc.save_gains(without, jaxftc.default_gains(rule), rule)
    jax.tree.map(np.testing.assert_array_equal, jaxftc.load_gains(own, config), gains)
    shipped = jaxftc.load_gains(without, config).decision
    jax.tree.map(np.testing.assert_array_equal, shipped, jaxftc.default_gains(config).decision)
    assert jaxftc.load_gains(own, rule).decision is None
    own.write_text(own.read_text().replace("[decision.last_bias]", "[decision.lost_bias]"))
    with pytest.raises(ValueError, match=r"unknown gain 'decision.lost_bias'"):
        jaxftc.load_gains(own, config)


@pytest.mark.parametrize("dt", [1e-3, 1e-2])
def test_the_shipped_weights_fit_what_is_shown(dt):
    shipped = decision_gains.shipped(dt)
    assert shipped.keys() == {field.name for field in dataclasses.fields(DecisionGains)}
    for field in dataclasses.fields(DecisionGains):
        assert shipped[field.name].shape == tuple(map(int, field.metadata["spec"].axes))
    assert len(shipped["centre"]) == len(decision_network.NAMES) and (shipped["low"] < shipped["high"]).all()
    gains = jaxftc.default_gains(jaxftc.Config(two_hinges(), dt=dt, engine="chain", decision="learned"))
    np.testing.assert_array_equal(gains.decision.first, shipped["first"].astype(gains.decision.first.dtype))


def test_slower_loops_have_weights_of_their_own():
    found = [decision_gains.shipped(dt)["first"] for dt in (2.5e-4, 1e-3, 2e-3, 1e-2)]
    assert (found[0] == found[1]).all() and (found[2] == found[3]).all() and (found[1] != found[2]).any()


@pytest.mark.parametrize(
    "change", [{"observer": "eso"}, {"input": "torque"}, {"scheme": "momentum"}, {"contact": 1}], ids=lambda c: next(iter(c))
)
def test_what_it_was_not_trained_on_is_refused(config, change):
    with pytest.raises(ValueError, match=r"decision='learned' was trained on the complete cascade"):
        dataclasses.replace(config, **change)


def test_products_of_matrices_become_products_of_numbers():
    """As exported code has them; the operations of the list are done here one by one."""
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(3, 4)), rng.normal(size=(4, 2))
    program = scalars(lambda a, b: jnp.einsum("kh,nk->hn", b, a), a, b)
    values, leaves = [], (a.ravel(), b.ravel())
    for operation in program.operations:
        if operation.name == "input":
            leaf, number = operation.args
            values.append(leaves[leaf][number])
        else:
            one, other = (values[place] for place in operation.args)
            values.append({"mul": one * other, "add": one + other}[operation.name])
    got = np.array([values[place] for place in program.results[0].ravel()]).reshape(2, 3)
    np.testing.assert_allclose(got, (a @ b).T, rtol=1e-12)


# An arm that the shipped weights have not seen.

RUNS = 1024
PRESETS = pytest.mark.parametrize("preset", ["standard", "hard", "uncommon"])


@functools.cache
def rule_and_learned(preset: str, dt: float = 1e-3) -> list[dict[str, np.ndarray]]:
    """Rows of the rule and of the learned decision. Weights that name nothing are the rule, so one program runs both."""
    with jax.enable_x64(False):
        config = jaxftc.Config(two_hinges(), dt=dt, engine="chain", decision="learned")
        runs, healthy = (jaxftc.sample_scenarios(jax.random.key(key), RUNS, preset, config=config) for key in (3, 1))
        learned = jaxftc.calibrate(config, jaxftc.default_gains(config), healthy, jax.random.key(2)).gains
        rule = learned.replace({"decision.last": 0.0, "decision.last_bias": -3.0})
        return [jaxftc.campaign(config, gains, runs, jax.random.key(4)) for gains in (rule, learned)]


@pytest.mark.thorough
def test_a_row_does_not_depend_on_the_runs_beside_it():
    """A block is asked while any of its runs hears an answer, and each hears its own."""
    with jax.enable_x64(False):
        config = jaxftc.Config(two_hinges(), engine="chain", decision="learned")
        runs = jaxftc.sample_scenarios(jax.random.key(3), RUNS, "hard", config=config)
        gains = jaxftc.default_gains(config)
        everything = jaxftc.campaign(config, gains, runs, jax.random.key(4))
        picked = np.array([700, 3, 512, 90])
        some = jaxftc.campaign(config, gains, jax.tree.map(lambda leaf: np.asarray(leaf)[picked], runs), jax.random.key(4))
    assert everything["unsure"].any() and not everything["unsure"].all()
    for name, column in everything.items():
        np.testing.assert_array_equal(some[name], column[picked], err_msg=name)


def right(rows, column: str) -> float:
    return float(rows[column][rows["detected"]].mean())


@pytest.mark.thorough
@PRESETS
def test_motion_and_false_alarms_are_the_rule_s(preset):
    rule, learned = rule_and_learned(preset)
    for name in ("tracking_max_deg", "effort", "fault_tau_rmse_nm", "false_alarm", "healthy_ratio"):
        np.testing.assert_array_equal(rule[name], learned[name], err_msg=name)
    assert (rule["delay_s"] == learned["delay_s"])[rule["detected"]].mean() > 0.99, "but for alarms up before onset"


@pytest.mark.thorough
@pytest.mark.parametrize("when", ["", "_settled"])
def test_on_an_arm_that_it_has_not_seen_it_names_better_than_the_rule(when):
    """Two hinges, not those of the training: more than chance allows."""
    rule, learned = (right(rows, f"verdict_right{when}") for rows in rule_and_learned("hard"))
    assert learned > rule + 0.03, (rule, learned)


@pytest.mark.parametrize("when", ["", "_settled"])
@pytest.mark.thorough
@pytest.mark.parametrize("preset", ["standard", "uncommon"])
def test_where_the_rule_is_good_it_is_no_worse(preset, when):
    for part in ("kind_right", "joint_right"):
        rule, learned = (right(rows, f"{part}{when}") for rows in rule_and_learned(preset))
        assert learned > rule - 0.015, (part, rule, learned)


@pytest.mark.thorough
@pytest.mark.parametrize("preset", ["standard", "hard"])
def test_a_slower_loop_has_it_too(preset):
    for part in ("kind_right_settled", "joint_right_settled"):
        rule, learned = (right(rows, part) for rows in rule_and_learned(preset, dt=0.01))
        assert learned > rule - 0.015, (part, rule, learned)


@pytest.mark.thorough
@PRESETS
def test_a_kind_of_fault_is_never_called_normal_where_the_rule_sees_it(preset):
    rule, learned = rule_and_learned(preset)
    for column in ("kind_hat", "kind_hat_settled"):
        assert not ((learned[column] == "normal") & (rule[column] != "normal")).any()
