"""Gradients of a closed-loop run in every gain, against finite differences and at every kink."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_jvp, check_vjp

import jaxftc
from jaxftc.diagnosis import threshold
from jaxftc.gains import specs
from jaxftc.scenarios.faults import Actuator, Sensor
from tests.arms import three_hinges

N, TICKS = 3, 30
ACTUATOR_AT, SENSOR_AT = 8, 20  # ticks: the jump comes while the torque residual is about its threshold
JUMP = 4.5e-4  # rad: graded about 1/2, so that the edges of the grade matter too
NAMES = [f"{block}.{name}" for block, name, _ in specs()]

# A relative change of 1e-4 in the poles and the read-out of the angle's bank does what one of 1 does in other gains.
STIFF = {"arx.xi_a": 1e-4, "arx.kappa_a": 1e-4, "arx.xi_b": 0.1, "arx.kappa_b": 0.1}
# Gains that are zero by default have no relative change.
ABSOLUTE = {"arx.offset": 1e-5, "control.k_b": 1.0, "observer.tau_centres": 0.1, "observer.jump_centres": 0.1}
ABSOLUTE |= {"control.q_centres": 0.1, "control.s_centres": 0.1}

FUZZY_STAGE = {f"observer.{name}" for name in ("alpha_f1", "alpha_f2", "alpha_f3", "leak", "jump")}
FUZZY_STAGE |= {f"observer.{channel}_{part}" for channel in ("tau", "jump") for part in ("centres", "widths")}
FUZZY_GAIN = {f"control.{name}" for name in ("q_centres", "q_widths", "s_centres", "s_widths", "outputs", "floor")}
SUPER_TWISTING = {"observer.alpha_sm", "observer.alpha_sm0", "observer.eps"}
ADAPTATION = {name for name in NAMES if name.startswith("adaptation.")}
BASELINE = {name for name in NAMES if name.startswith("baseline.")}
BASELINE |= {f"diagnosis.{name}" for name in ("rate", "fast", "stiction")}


class Case(NamedTuple):
    """A structure and the gains that it does not have."""

    engine: str
    observer: str
    control: str
    idle: frozenset[str]
    sign: str = "smooth"
    adaptive: bool = False

    def config(self) -> jaxftc.Config:
        structure = self._asdict()
        del structure["idle"]
        return jaxftc.Config(three_hinges(), duration=TICKS * 1e-3, **structure)


UNUSED = BASELINE | ADAPTATION
COMPENSATION = {"control.rate"}  # where encoder faults are estimated
PLAIN = UNUSED | FUZZY_STAGE | FUZZY_GAIN | SUPER_TWISTING | COMPENSATION
FULL = Case("chain", "ts", "afesmc", frozenset(UNUSED | {"control.alpha_sm"}))
SMC = Case("chain", "pi", "smc", frozenset(PLAIN | {"control.alpha_sm2"}))
CASES = {
    "chain-ts-afesmc": FULL,
    "mjx-ts-afesmc": FULL._replace(engine="mjx"),
    "adaptive": FULL._replace(idle=FULL.idle - ADAPTATION, adaptive=True),
    "chain-pi-smc": SMC,
    "chain-eso-esmc": Case(
        "chain", "eso", "esmc", frozenset(UNUSED | FUZZY_STAGE | FUZZY_GAIN | COMPENSATION | {"control.alpha_sm"})
    ),
    "mjx-pi-smc": SMC._replace(engine="mjx"),
}


def base_gains(config: jaxftc.Config) -> jaxftc.Gains:
    """Default gains, but for those that do nothing at their default."""
    gains = jaxftc.default_gains(config)
    n = config.n
    floor = jnp.where(jnp.arange(n) < n / 2, 0.1, 2.9)  # the first joints below it, the last above
    control = {"control.k_b": 1.0, "control.rate": 100.0, "control.floor": floor}
    follow = dict(zip(threshold.GAINS, (0.3, 0.02, 0.5, 0.01, 0.02), strict=True))
    return gains.replace(control | follow | {"diagnosis.lam_q": 0.7, "diagnosis.alpha_q": JUMP, "diagnosis.lead": 1e3})


def faulty(config: jaxftc.Config) -> jaxftc.Scenario:
    """Both faults on all joints, with encoder noise; each stays."""
    both = jaxftc.paper_scenario("both", config, angle=JUMP)

    def at(fault, tick):
        return fault._replace(onset=jnp.full(config.n, tick * config.dt - 1e-6), clear=jnp.full(config.n, jnp.inf))

    faults = {"fault_tau": at(both.fault_tau, ACTUATOR_AT), "fault_q": at(both.fault_q, SENSOR_AT)}
    return strong(both._replace(**faults))


def strong(scenario: jaxftc.Scenario) -> jaxftc.Scenario:
    """Without JAX's weak types, so that one program serves every scenario."""
    return jax.tree.map(np.asarray, scenario)


class Programs(NamedTuple):
    """One cost of a run and its derivatives, compiled; theta [all gains] is each gain's change in its natural size."""

    value: object  # (theta, scenario) -> cost
    slope: object  # (theta, scenario) -> d cost / d theta
    push: object  # (theta, direction, scenario) -> (cost, its change along direction)
    slices: dict[str, slice]


@functools.cache
def programs(case: Case) -> Programs:
    config = case.config()
    leaves, tree = jax.tree.flatten(base_gains(config))
    ends = np.cumsum([leaf.size for leaf in leaves])
    slices = {name: slice(end - leaf.size, end) for name, leaf, end in zip(NAMES, leaves, ends, strict=True)}
    sizes = [ABSOLUTE.get(n, STIFF.get(n, 1.0) * np.abs(np.asarray(leaf))) for n, leaf in zip(NAMES, leaves, strict=True)]

    def cost(theta, scenario):
        parts = [theta[slices[name]].reshape(leaf.shape) for name, leaf in zip(NAMES, leaves, strict=True)]
        gains = jax.tree.unflatten(tree, [leaf + s * part for leaf, s, part in zip(leaves, sizes, parts, strict=True)])
        trace = jaxftc.simulate(config, gains, scenario, jax.random.key(0))
        out = trace.out
        terms = (
            (trace.q - trace.q_ref) / 1e-3,
            (out.fault_tau_hat - trace.fault_tau) / 5.0,
            (out.fault_q_hat - JUMP) / JUMP,
            out.statistic_tau / out.threshold_tau,
            out.statistic_q / out.threshold_q,
        )
        return sum((term**2).mean() for term in terms)

    def push(theta, direction, scenario):
        return jax.jvp(lambda t: cost(t, scenario), (theta,), (direction,))

    return Programs(jax.jit(cost), jax.jit(jax.grad(cost)), jax.jit(push), slices)


def length(run: Programs) -> int:
    return max(part.stop for part in run.slices.values())


def put(run: Programs, name: str, leaf: np.ndarray) -> np.ndarray:
    """A vector of all gains that is zero but for one of them."""
    vector = np.zeros(length(run))
    vector[run.slices[name]] = leaf
    return vector


def each_gain(*, slow: tuple[str, ...]):
    """Every gain that a case has; what takes longest to compile is a slow test."""

    def decorate(test):
        cases = [pytest.param(case, id=name, marks=[pytest.mark.slow] * (name in slow)) for name, case in CASES.items()]
        return pytest.mark.parametrize("case", cases)(pytest.mark.parametrize("name", NAMES)(test))

    return decorate


def tolerance(slope: np.ndarray) -> dict[str, float]:
    """One gain at a time, in a random direction: a small slope cannot hide behind a large one.

    A direction can be nearly level: the error counts against the slope's length too, up to the 1e-7 that differences over
    1e-4 do not know, since values of a run scatter by up to 1e-11 in rounding.
    """
    return {"rtol": 1e-4, "atol": 1e-9 + min(1e-4 * float(np.linalg.norm(slope)), 1e-7), "eps": 1e-4}


@each_gain(slow=("chain-pi-smc", "chain-eso-esmc", "mjx-pi-smc", "mjx-ts-afesmc", "adaptive"))
def test_reverse_slope_in_each_gain_is_that_of_finite_differences(case, name):
    run, scenario = programs(case), faulty(case.config())
    part = run.slices[name]

    def value(leaf):
        return run.value(put(run, name, leaf), scenario)

    def backward(leaf):
        slope = np.asarray(run.slope(put(run, name, leaf), scenario))[part]
        return value(leaf), lambda weight: (weight * slope,)

    slope = np.asarray(run.slope(np.zeros(length(run)), scenario))[part]
    if name in case.idle:
        assert not np.any(slope)
        return
    assert np.abs(slope).max() > 1e-4, "a gain that does next to nothing is not tested here"
    check_vjp(value, backward, (np.zeros(slope.size),), **tolerance(slope))


@pytest.mark.thorough
@each_gain(slow=("chain-pi-smc", "chain-eso-esmc", "mjx-pi-smc", "mjx-ts-afesmc", "adaptive"))
def test_forward_slope_in_each_gain_is_that_of_finite_differences(case, name):
    run, scenario = programs(case), faulty(case.config())
    part = run.slices[name]

    def value(leaf):
        return run.value(put(run, name, leaf), scenario)

    def along(primals, tangents):
        return run.push(put(run, name, *primals), put(run, name, *tangents), scenario)

    zero = np.zeros(part.stop - part.start)
    if name in case.idle:
        assert float(along((zero,), (zero + 1.0,))[1]) == 0.0
        return
    slope = np.asarray(run.slope(np.zeros(length(run)), scenario))[part]
    check_jvp(value, along, (zero,), **tolerance(slope))


@pytest.mark.slow
def test_both_engines_have_the_same_gradient():
    """Twins: the same slopes through MuJoCo MJX and through the unrolled recursions."""
    mine, theirs = (programs(CASES[name]) for name in ("chain-ts-afesmc", "mjx-ts-afesmc"))
    scenario, zero = faulty(FULL.config()), np.zeros(length(mine))
    expected = np.asarray(theirs.slope(zero, scenario))
    np.testing.assert_allclose(mine.slope(zero, scenario), expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("channel_kind", [*Actuator, *Sensor], ids=lambda kind: f"{type(kind).__name__}-{kind.name}")
def test_slopes_are_finite_for_every_kind_of_fault(channel_kind):
    """Degenerate cases among them: without faults and noise every innovation is zero, or rounding."""
    config, run = FULL.config(), programs(FULL)
    scenario = jaxftc.paper_scenario("healthy", config)
    name = "fault_tau" if isinstance(channel_kind, Actuator) else "fault_q"
    fault = getattr(scenario, name)._replace(
        kind=jnp.full(N, channel_kind, jnp.int32), magnitude=jnp.full(N, 0.3), onset=jnp.full(N, 5e-3)
    )
    scenario = scenario._replace(**{name: fault})
    for noise in (scenario.noise, jnp.zeros(())):
        slope = run.slope(np.zeros(length(run)), strong(scenario._replace(noise=noise)))
        assert np.isfinite(slope).all() and np.any(slope != 0)


@pytest.mark.slow
@pytest.mark.parametrize("observer", ["pi", "eso", "ts"])
def test_slopes_of_a_run_with_the_hard_sign_are_finite(observer):
    hard = FULL._replace(observer=observer, sign="hard")
    run = programs(hard)
    slope = run.slope(np.zeros(length(run)), faulty(hard.config()))
    assert np.isfinite(slope).all() and np.any(slope != 0)


# One tick at its kinks.

REST = "at rest, no innovation"
KINKS = (
    REST,
    "q at the upper end of the fuzzy range",
    "q at the lower end",
    "q beyond the range",
    "s at the end of its range",
    "torques at and beyond the limits",
    "a jump of exactly the threshold",
    "a missing reading",
)


@functools.cache
def tick_slopes(sign: str):
    """Gradient of everything a tick returns, in gains, state, reference and measurement."""
    config = jaxftc.Config(three_hinges(), engine="chain", sign=sign)

    def cost(gains, state, reference, measurement):
        leaves = jax.tree.leaves(jaxftc.step(config, gains, state, reference, measurement))
        return sum((leaf**2).sum() for leaf in leaves if jnp.issubdtype(leaf.dtype, jnp.floating))

    return jax.jit(jax.grad(cost, argnums=(0, 1, 2, 3)))


@pytest.mark.thorough
@pytest.mark.parametrize("sign", ["smooth", pytest.param("hard", marks=pytest.mark.slow)])
@pytest.mark.parametrize("kink", KINKS)
def test_slopes_of_a_tick_are_finite_at_its_kinks(sign, kink):
    config = jaxftc.Config(three_hinges(), engine="chain", sign=sign)
    gains = jaxftc.default_gains(config)
    zero, top = jnp.zeros(config.n), gains.control.q_centres[-1]
    start = {"q at the upper end of the fuzzy range": top, "q at the lower end": -top, "q beyond the range": 2 * top}
    q = zero + start.get(kink, 0.0)
    state = jaxftc.init(config, gains, q)
    reference = jaxftc.Reference(q, zero, zero)
    measurement = jaxftc.Measurement(q, state.command.tau)
    if kink == "s at the end of its range":
        reference = reference._replace(q=q - gains.control.s_centres[-1] / gains.control.lam)
    elif kink == "torques at and beyond the limits":
        limit = jnp.asarray(config.robot.torque_limit)
        reference = reference._replace(qdd=zero + 1000.0)
        measurement = measurement._replace(tau=limit * jnp.asarray([1, -1, 2]))
    elif kink == "a jump of exactly the threshold":
        measurement = measurement._replace(q=q + gains.observer.jump)
    elif kink == "a missing reading":
        measurement = measurement._replace(q=measurement.q.at[2].set(jnp.nan), tau=measurement.tau.at[1].set(jnp.nan))
    out = jaxftc.step(config, gains, state, reference, measurement)[1]
    if kink == REST:
        assert np.abs(out.residual_q).max() < 1e-15 and np.abs(out.s).max() < 1e-12
    if kink == "torques at and beyond the limits":
        np.testing.assert_array_equal(np.abs(out.tau), config.robot.torque_limit)
    slopes = tick_slopes(sign)(gains, state, reference, measurement)
    for leaf in jax.tree.leaves(slopes):
        assert np.isfinite(leaf).all()
    assert any(bool(jnp.any(leaf != 0)) for leaf in jax.tree.leaves(slopes))
