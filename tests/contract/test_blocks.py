"""One contract for every block: same tree in and out, one trace, jit = plain, trailing axes = vmap = loop, all finite."""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc import stages
from jaxftc.control import compensation, sliding_mode
from jaxftc.diagnosis import alarm, decision, sensor_check, statistics
from jaxftc.gains import align
from jaxftc.observer import adaptation, cascade, pi, stage, super_twisting, takagi_sugeno
from jaxftc.scenarios.faults import Sensor
from jaxftc.scenarios.reference import cubic
from jaxftc.scenarios.scenario import CONDITIONS
from jaxftc.types import Verdict
from jaxftc.variants import SCHEMES
from tests.arms import two_hinges

N = two_hinges().n
ALL = tuple(range(N))


@dataclasses.dataclass(frozen=True)
class Block:
    """A module that keeps the contract, and the natural sizes of what a tick takes in."""

    name: str
    module: Any  # init(config, gains, q) -> State; step(config, gains, state, inputs) -> (State, Info)
    sizes: Any  # inputs with a size for each signal, in its unit; 0 to 1 for a flag
    change: tuple[tuple[str, Any], ...] = ()  # what differs in the config

    def config(self) -> jaxftc.Config:
        return jaxftc.Config(two_hinges(), engine="chain", **dict(self.change))

    def init(self, gains, q):
        return self.module.init(self.config(), align(gains, q.ndim - 1), q)

    def step(self, gains, state, inputs):
        axes = jax.tree.leaves(inputs)[0].ndim - 1
        if hasattr(inputs, "on"):
            inputs = inputs._replace(on=stages.of(self.config()))
        return self.module.step(self.config(), align(gains, axes), state, inputs)


class Scheme:
    """A scheme keeps the contract too; its inputs are a reference and a measurement."""

    init = staticmethod(jaxftc.init)

    @staticmethod
    def step(config, gains, state, inputs):
        return jaxftc.step(config, gains, state, *inputs)


def scheme(name: str, **change: Any) -> Block:
    sizes = (jaxftc.Reference(1.0, 2.0, 10.0), jaxftc.Measurement(1.0, 50.0))
    return Block(name, Scheme, sizes, tuple(change.items()))


def pair(observer: str, control: str, **change: Any) -> Block:
    return scheme("-".join((observer, control, *map(str, change.values()))), observer=observer, control=control, **change)


ESTIMATE = cascade.Estimate(
    1.0, 1.0, 1e-3, takagi_sugeno.Jump(1.0, 1.0, 0.01, 0.01), 0.01, 0.02, 1.0, 0.02, 5.0, False, False, 1.0
)
SMALL = [
    Block("pi", pi, stage.Inputs(1e-3, 1.0, None)),
    Block("super-twisting-smooth", super_twisting, stage.Inputs(1e-3, 1.0, None)),
    Block("super-twisting-hard", super_twisting, stage.Inputs(1e-3, 1.0, None), (("sign", "hard"),)),
    Block("takagi-sugeno", takagi_sugeno, takagi_sugeno.Inputs(1e-3, 1.0, 3.0, 2.0)),
    Block("adaptation", adaptation, adaptation.Inputs(3.0, 2.0, False, adaptation.Columns(2.0, 1.0, 1.0))),
    Block("compensation", compensation, compensation.Inputs(10.0, 10.0)),
    Block("statistics", statistics, statistics.Inputs(3.0, 0.02)),
    Block("alarm", alarm, alarm.Inputs(statistics.Statistics(3.0, 0.02), 2.0)),
    Block("sensor-check", sensor_check, sensor_check.Inputs(alarm.Alarms(False, False), 2.0, 3.0, ESTIMATE, 2.0, 1.0)),
    Block("decision", decision, decision.Inputs(statistics.Statistics(3.0, 0.02), 2.0, 3.0, ESTIMATE, 2.0, 1.0)),
    Block(
        "decision-learned",
        decision,
        decision.Inputs(statistics.Statistics(3.0, 0.02), 2.0, 3.0, ESTIMATE, 2.0, 1.0, 3.0),
        (("decision", "learned"),),
    ),
    *(
        Block(
            f"sliding-mode-{control}",
            sliding_mode,
            sliding_mode.Inputs(1.0, 10.0, 0.01, 5.0, jaxftc.Reference(1.0, 2.0, 10.0), None),
            (("control", control),),
        )
        for control in ("smc", "esmc", "afesmc")
    ),
]
OBSERVERS, CONTROLS = ("pi", "eso", "ts"), ("smc", "esmc", "afesmc")
BASELINES = [scheme(name, scheme=name) for name in SCHEMES if name != "cascade"]
PAIRS = [pair(*choice) for choice in itertools.product(OBSERVERS, CONTROLS)]
VARIANTS = [
    pair(observer, control, sign=sign, input=form)
    for observer, control, sign, form in itertools.product(OBSERVERS, CONTROLS, ("smooth", "hard"), ("rigid_body", "torque"))
    if (sign, form) != ("smooth", "rigid_body")
]
# Every stage, law, sign and input once; the other combinations are slow tests.
FEW = [
    PAIRS[0],
    PAIRS[4],
    PAIRS[8],
    pair("ts", "esmc", input="torque"),
    *BASELINES,
]
REST = [block for block in PAIRS + VARIANTS if block.name not in {few.name for few in FEW}]
REST += [pair("eso_printed", "esmc"), pair("ts", "afesmc", adaptive=True), pair("ts", "afesmc", decision="learned")]


# What has to be compiled: the filter takes a minute, and the pair of everything has the stages of the others.
QUICK = [few for few in FEW if few.name in (PAIRS[8].name, "momentum", "computed_torque")]
LONGER = [few for few in FEW if few not in QUICK]


def each(*blocks: Block, thorough: Sequence[Block] = (), slow: Sequence[Block] = ()):
    marked = ((blocks, ()), (thorough, pytest.mark.thorough), (slow, pytest.mark.slow))
    return pytest.mark.parametrize(
        "block", [pytest.param(block, id=block.name, marks=marks) for some, marks in marked for block in some]
    )


def draw(block: Block, axes: tuple[int, ...], ticks: int) -> list[Any]:
    """Inputs of some ticks, spread over their natural sizes; for one arm or for scenarios on trailing axes."""
    random = np.random.default_rng(7)

    def signal(size):
        if isinstance(size, bool):
            return jnp.asarray(random.uniform(size=(N, *axes)) < 0.2)
        return jnp.asarray(random.uniform(-size, size, (N, *axes)))

    return [jax.tree.map(signal, block.sizes) for _ in range(ticks)]


def start_of(inputs: Any) -> jax.Array:
    """Angles [n, ...] rad to start from, of the inputs' shape."""
    return next(leaf for leaf in jax.tree.leaves(inputs) if jnp.issubdtype(leaf.dtype, jnp.floating))


def default_gains(block: Block) -> jaxftc.Gains:
    return jaxftc.default_gains(block.config())


def assert_close(one: Any, other: Any, tolerance: float = 1e-10) -> None:
    chex.assert_trees_all_equal_structs(one, other)
    for mine, theirs in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        theirs = np.asarray(theirs, float)
        scale = max(1.0, float(np.abs(theirs[np.isfinite(theirs)]).max(initial=0.0)))
        np.testing.assert_allclose(np.asarray(mine, float), np.asarray(theirs, float), rtol=0, atol=tolerance * scale)


def without_thresholds(info: Any) -> Any:
    """The info but for thresholds: a scheme that does not watch a channel has an infinite one there."""
    return (
        {k: v for k, v in info._asdict().items() if "threshold" not in k} if isinstance(info, jaxftc.types.Output) else info
    )


@each(*SMALL, *FEW, slow=REST)
@pytest.mark.parametrize("axes", [(), (2, 5)], ids=["one", "scenarios"])
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64], ids=["single", "double"])
def test_state_comes_out_as_it_went_in(block, axes, dtype):
    """Same tree, shapes and precision; every number of the info in the same precision too, scenarios on its last axes."""
    gains = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, dtype), default_gains(block))
    inputs = jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype if leaf.dtype == bool else dtype), draw(block, axes, 1)[0]
    )
    state = jax.eval_shape(block.init, gains, start_of(inputs))
    after, info = jax.eval_shape(block.step, gains, state, inputs)
    chex.assert_trees_all_equal_shapes_and_dtypes(after, state)
    for leaf in jax.tree.leaves((state, info)):
        assert leaf.dtype == dtype or not jnp.issubdtype(leaf.dtype, jnp.floating)
    assert {leaf.shape for leaf in jax.tree.leaves(info)} <= {(N, *axes), axes}


@each(*SMALL, *QUICK, thorough=LONGER, slow=REST)
def test_one_trace_and_the_same_numbers_as_without_jit(block):
    gains = default_gains(block)
    chex.clear_trace_counter()  # it takes functions with one source for the same
    compiled = jax.jit(chex.assert_max_traces(block.step, n=1))
    ticks = draw(block, (), 4)
    state = plain = block.init(gains, start_of(ticks[0]))
    # Ranks agree in all arithmetic of one arm, but where every joint reads the inputs of all.
    with jax.numpy_rank_promotion("allow" if block.config().input == "torque" else "raise"):
        for inputs in ticks:
            state, info = compiled(gains, state, inputs)
            plain, plain_info = block.step(gains, plain, inputs)
            assert_close((state, info), (plain, plain_info))
    chex.assert_tree_all_finite((state, without_thresholds(info)))


@each(*SMALL, *QUICK, slow=[*LONGER, *REST])
def test_trailing_axes_are_vmap_are_a_loop(block):
    gains, step = default_gains(block), jax.jit(block.step)
    mapped = jax.jit(jax.vmap(block.step, in_axes=(None, -1, -1), out_axes=-1))
    ticks = draw(block, (5,), 3)
    start = block.init(gains, start_of(ticks[0]))
    together, by_map = start, start
    alone = [jax.tree.map(lambda leaf, k=k: leaf[..., k], start) for k in range(5)]
    for inputs in ticks:
        together, info = step(gains, together, inputs)
        by_map, info_by_map = mapped(gains, by_map, inputs)
        assert_close((by_map, info_by_map), (together, info))
        for k in range(5):
            alone[k], own = step(gains, alone[k], jax.tree.map(lambda leaf, k=k: leaf[..., k], inputs))
            assert_close((alone[k], own), jax.tree.map(lambda leaf, k=k: leaf[..., k], (together, info)))


@each(*SMALL, QUICK[-1], thorough=QUICK[:-1], slow=[*LONGER, *REST])  # test_gradients.py has the pair of everything
def test_gradients_are_finite(block):
    """With respect to gains, state and every signal, after ticks that leave the state where it usually is."""
    gains = default_gains(block)
    *before, last = draw(block, (), 3)
    state = block.init(gains, start_of(before[0]))
    for inputs in before:
        state, _ = block.step(gains, state, inputs)
    flags = jax.tree.map(lambda leaf: leaf if leaf.dtype == bool else None, last)
    signals = jax.tree.map(lambda leaf: None if leaf.dtype == bool else leaf, last)

    def cost(gains, state, signals):
        inputs = jax.tree.map(
            lambda flag, signal: signal if flag is None else flag, flags, signals, is_leaf=lambda leaf: leaf is None
        )
        leaves = jax.tree.leaves(block.step(gains, state, inputs))
        return sum((leaf**2).sum() for leaf in leaves if jnp.issubdtype(leaf.dtype, jnp.floating))

    slopes = jax.jit(jax.grad(cost, argnums=(0, 1, 2)))(gains, state, signals)
    chex.assert_tree_all_finite(slopes)
    moved = [bool(jnp.any(slope != 0)) for slope in jax.tree.leaves(slopes)]
    decides = block.module in (alarm, sensor_check, decision)  # comparisons: no gradient passes
    assert any(moved) != decides, "a cost that depends on nothing tests nothing"


def test_one_program_serves_every_condition(config):
    """A weak type (a number that was a Python float) counts as another signature, and would compile the loop again."""
    four = [jaxftc.paper_scenario(condition, config) for condition in CONDITIONS]
    signatures = {str(jax.tree.map(lambda leaf: leaf.aval, scenario)) for scenario in four}
    assert len(signatures) == 1, signatures


# Missing readings.

GAP = {"one tick": (0.020, 0.020), "ten ticks": (0.020, 0.029), "thirty ticks": (0.020, 0.049)}  # s, both ends included


@pytest.fixture(scope="module")
def dropped(config) -> Callable[..., jaxftc.Trace]:
    """A run with the readings of some joints missing for a while, on the nominal arm or with a payload, kg."""

    def run(gap: tuple[float, float], joints: tuple[int, ...], payload: float = 0.0) -> jaxftc.Trace:
        scenario = jaxftc.paper_scenario("healthy", config)
        scenario = scenario._replace(plant=scenario.plant._replace(payload=jnp.asarray(payload)))
        hit = jnp.isin(jnp.arange(config.n), jnp.asarray(joints))
        fault = scenario.fault_q._replace(
            kind=jnp.where(hit, Sensor.DROPOUT, Sensor.NONE).astype(jnp.int32),
            onset=jnp.full(config.n, gap[0] - 1e-4),
            clear=jnp.full(config.n, gap[1] + 1e-4),
        )
        return jaxftc.simulate(config, jaxftc.default_gains(config), scenario._replace(fault_q=fault), jax.random.key(3))

    return run


@pytest.mark.parametrize("gap", GAP)
@pytest.mark.parametrize("joints", [(1,), ALL], ids=["one", "all"])
def test_missing_readings_are_held_on_prediction(config, dropped, gap, joints):
    trace, whole = dropped(GAP[gap], joints), dropped(GAP[gap], ())
    missing = ~np.isfinite(np.asarray(trace.y))
    assert missing.any(0).tolist() == [j in joints for j in ALL]
    assert missing.sum() == len(joints) * round((GAP[gap][1] - GAP[gap][0]) / config.dt + 1)
    for name, leaf in trace.out._asdict().items():
        assert np.isfinite(leaf).all(), name
    # The prediction takes the reading's place: what is left of the residual is the fault that was already known.
    np.testing.assert_allclose((trace.out.residual_q - trace.out.fault_q_hat)[missing], 0, atol=1e-12)
    assert np.abs(trace.out.q_hat - trace.q).max() < 5e-4
    # An encoder that says nothing for some ticks is at fault as long as it says nothing, and a tick more where the pause was
    # long: the second reading confirms the first. Nobody else is, by any amount.
    assert np.abs(trace.out.fault_q_hat).max() < 1e-6
    blamed = np.asarray(trace.out.verdict) & 2 > 0
    confirmed = np.roll(missing, gap == "thirty ticks", axis=0)
    assert not (blamed & ~missing & ~confirmed).any()
    last = np.flatnonzero(missing.any(1))[-1]
    assert blamed[last].tolist() == [gap != "one tick" and j in joints for j in ALL]
    assert np.abs(trace.q - whole.q).max() < 5e-4


@pytest.mark.parametrize("gap", GAP)
def test_no_jump_is_attributed_when_readings_come_back(config, dropped, gap):
    """The arm is not its model, so that the prediction has drifted: that is not the encoder's fault."""
    trace = dropped(GAP[gap], ALL, payload=2.0)
    back = round(GAP[gap][1] / config.dt) + 1
    drifted = np.abs(trace.out.q_hat - trace.q)[back - 1].max()
    assert drifted > (1e-4 if gap == "one tick" else 4e-4), "there is something to book"
    assert np.abs(trace.out.fault_q_hat).max() < 1e-5


class Log(NamedTuple):
    """A recorded run [T, n]: what the tick was told, and what it commanded one tick before."""

    reference: jaxftc.Reference
    measurement: jaxftc.Measurement


@pytest.fixture(scope="module")
def log(config) -> Log:
    """A healthy run, as a data logger would have it."""
    gains, scenario = jaxftc.default_gains(config), jaxftc.paper_scenario("healthy", config)
    trace = jaxftc.simulate(config, gains, scenario, jax.random.key(5))
    desired = jax.vmap(lambda t: cubic(scenario.q_start, scenario.q_goal, config.t_final, t))(trace.t)
    first = jaxftc.init(config, gains, scenario.q_start).command.tau
    return Log(desired, jaxftc.Measurement(trace.y, jnp.vstack([first[None], trace.out.tau[:-1]])))


@functools.partial(jax.jit, static_argnums=0)
def diagnose(config, gains, log) -> jaxftc.Output:
    """Outputs [T, ...] of the tick alone."""

    def body(state, told):
        return jaxftc.step(config, gains, state, *told)

    return jax.lax.scan(body, jaxftc.init(config, gains, log.reference.q[0]), log)[1]


def altered(log: Log, ticks: slice, joints: tuple[int, ...] = ALL, *, q=None, tau=None) -> Log:
    """The log with other readings or torques in some ticks and joints."""
    measurement = log.measurement
    at = (ticks, jnp.asarray(joints))
    if q is not None:
        measurement = measurement._replace(q=measurement.q.at[at].set(q))
    if tau is not None:
        measurement = measurement._replace(tau=measurement.tau.at[at].set(tau))
    return log._replace(measurement=measurement)


@pytest.mark.parametrize("missing", [np.inf, -np.inf])
def test_what_is_not_finite_is_missing(config, log, missing):
    gains = jaxftc.default_gains(config)
    expected = diagnose(config, gains, altered(log, slice(20, 25), (1,), q=np.nan))
    got = diagnose(config, gains, altered(log, slice(20, 25), (1,), q=missing))
    chex.assert_trees_all_equal(got, expected)


def test_a_known_encoder_fault_outlives_missing_readings(config, log):
    """A bias attributed before a gap is neither attributed again nor lost when readings come back."""
    biased = altered(log, slice(10, None), q=log.measurement.q[10:] + 0.02)
    b = diagnose(config, jaxftc.default_gains(config), altered(biased, slice(30, 40), q=np.nan)).fault_q_hat
    np.testing.assert_allclose(b[9], 0, atol=1e-6)
    np.testing.assert_allclose(b[10:], 0.02, atol=5e-4)
    np.testing.assert_allclose(b[29:], jnp.broadcast_to(b[29], b[29:].shape), atol=1e-6)


def test_readings_that_never_come_leave_everything_finite(config, log):
    """Degenerate case: the controller is on its own from the second tick; a perfect model then predicts the motion."""
    out = diagnose(config, jaxftc.default_gains(config), altered(log, slice(1, None), q=np.nan))
    chex.assert_tree_all_finite(out)
    assert np.abs(out.residual_q[1:]).max() < 1e-9
    assert (out.verdict[-1] == Verdict.SENSOR).all()
    assert np.abs(out.q_hat - log.measurement.q).max() < 5e-3


def test_an_unknown_torque_counts_as_the_command(config, log):
    gains = jaxftc.default_gains(config)
    assert np.abs(log.measurement.tau).max() < config.robot.torque_limit.max()
    got, expected = (diagnose(config, gains, each) for each in (altered(log, slice(None), tau=np.nan), log))
    jax.tree.map(lambda mine, theirs: np.testing.assert_allclose(mine, theirs, atol=1e-9), got, expected)


def test_an_unknown_torque_counts_as_the_command_within_the_limits(config):
    """An impossible reference saturates every motor; the observer must not believe in more torque than was commanded."""
    gains, zero = jaxftc.default_gains(config), jnp.zeros(config.n)
    state = jaxftc.init(config, gains, zero)
    wild = jaxftc.Reference(zero, zero, zero + 1000.0)
    state, out = jaxftc.step(config, gains, state, wild, jaxftc.Measurement(zero, state.command.tau))
    np.testing.assert_array_equal(np.abs(out.tau), config.robot.torque_limit)
    known, unknown = (
        jaxftc.step(config, gains, state, wild, jaxftc.Measurement(zero, tau)) for tau in (out.tau, zero + jnp.nan)
    )
    assert_close(unknown, known)


@pytest.mark.slow
@pytest.mark.parametrize("observer", OBSERVERS)
def test_gradients_pass_missing_values(config, log, observer):
    config = dataclasses.replace(config, observer=observer)
    gap = jax.tree.map(lambda leaf: leaf[:15], altered(log, slice(5, 9), (0,), q=np.nan, tau=np.nan))

    def cost(gains):
        out = diagnose(config, gains, gap)
        return ((out.q_hat - gap.reference.q) ** 2).sum() + (out.fault_tau_hat**2).sum()

    chex.assert_tree_all_finite(jax.jit(jax.grad(cost))(jaxftc.default_gains(config)))
