"""What no arm can do is not believed, a state that is lost starts anew, and what is over leaves no trace."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc.compile.jit import jit
from jaxftc.robot import dynamics
from jaxftc.schemes import registry
from tests.arms import three_hinges, two_hinges

SECOND = 1000  # ticks


class Told(NamedTuple):
    """What is done to the signals of a tick, [..., n, scenarios] each; NaN leaves a signal alone."""

    reading: jax.Array  # rad, in place of the encoder's
    missing: jax.Array  # bool, no reading
    tau: jax.Array  # N m, in place of the last command
    reference: jax.Array  # rad and rad/s, in place of the one to be held
    broken: jax.Array  # bool, the state comes with a number that is not one


class Seen(NamedTuple):
    q: jax.Array
    b: jax.Array
    tau: jax.Array
    verdict: jax.Array
    finite: jax.Array


def closed_loop(config, gains, q, tell, ticks, noise, state_of=lambda state, broken: state):
    """Seen [ticks, n, ...] of an arm that is to stay in q [n, ...]; ``tell(k)`` is ``Told`` of tick k, ``noise`` in rad."""
    plant, still = dynamics.nominal_plant(config.robot), jnp.zeros_like(q)

    def tick(carry, k):
        at, speed, tau, state = carry
        told = tell(k)
        own = at + noise * jax.random.normal(jax.random.fold_in(jax.random.key(5), k), q.shape, q.dtype)
        reading = jnp.where(told.missing, jnp.nan, jnp.where(jnp.isnan(told.reading), own, told.reading))
        wanted = [jnp.where(jnp.isnan(told.reference), own, told.reference) for own in (q, still)]
        measured = jaxftc.Measurement(reading, jnp.where(jnp.isnan(told.tau), tau, told.tau))
        state, out = jaxftc.step(config, gains, state_of(state, told.broken), jaxftc.Reference(*wanted, still), measured)
        numbers = [leaf for leaf in out if jnp.issubdtype(leaf.dtype, jnp.floating)]
        judged = [leaf for leaf in numbers if leaf is not out.threshold_tau and leaf is not out.threshold_q]
        finite = jnp.stack([jnp.isfinite(leaf) for leaf in judged]).all(0)
        moved = dynamics.advance(config.robot, "chain", plant, at, speed, out.tau, config.dt)
        return (*moved, out.tau, state), Seen(at, out.fault_q_hat, out.tau, out.verdict, finite)

    start = (q, still, registry.holding_torque(config, q), registry.init(config, gains, q))
    return jax.lax.scan(tick, start, jnp.arange(ticks))[1]


# ------------------------------------------------------------------ one fault at a time, the PUMA 560 held still

REST = np.deg2rad([30.0, 90.0, 30.0, 120.0, 50.0, 138.0])
FROM, TICKS = 200, 3500
_draw = np.random.default_rng(22)
# Reading of a joint, from 0, in some ticks; last, the largest error of the arm on the way, deg.
READINGS = {
    "far": (2, 5, np.full(5, 1e8), 0.1),
    "three turns off": (2, 5, np.full(5, 1e6), 0.1),
    "dead for half a second": (2, 500, np.zeros(500), 0.1),
    "dead": (2, 700, np.zeros(700), 0.1),
    "dead wrist": (5, 700, np.zeros(700), 0.1),
    "dead for long": (2, 1800, np.zeros(1800), 0.5),
    "dead wrist for long": (5, 1800, np.zeros(1800), 0.5),
    "nothing": (2, 700, np.full(700, np.inf), 0.1),
    "stuck elsewhere": (2, 700, np.full(700, 300.0), 0.1),
    "stuck nearby": (2, 700, np.full(700, 0.53), 0.1),
    "anything within a turn": (2, 700, _draw.uniform(-6, 6, 700), 1.0),
    "noise of a radian": (2, 700, _draw.normal(size=700), 1.0),
    "steps": (2, 700, np.repeat(_draw.uniform(-2, 2, 70), 10), 1.0),
    "slow steps": (2, 700, np.repeat(_draw.uniform(-2, 2, 7), 100), 0.1),
    "now and then": (2, 700, np.resize([1e30, -1e30, np.inf, 0.3], 700), 0.1),
    "drags the arm along": (2, 700, REST[2] + np.linspace(0, 1, 700), 30.0),
}
TORQUES = {"one of 1e8 N m": (2, 1e8), "one of 1e3 N m": (2, 1e3), "one of -1e3 N m": (1, -1e3)}
SPEEDS = {"1e15 rad/s": (2, 1e15), "infinite": (1, np.inf)}
CASES = [*READINGS, *TORQUES, *SPEEDS]


@pytest.fixture(scope="module")
def held(puma):
    """Seen [T, 6, cases]: cascade, default gains."""
    shape = (TICKS, 6, len(CASES))
    reading, tau, reference = (np.full(shape, np.nan, np.float32) for _ in range(3))
    for case, (joint, ticks, values, _) in enumerate(READINGS.values()):
        reading[FROM : FROM + ticks, joint, case] = values
    for signal, told, first in ((tau, TORQUES, len(READINGS)), (reference, SPEEDS, len(READINGS) + len(TORQUES))):
        for case, (joint, value) in enumerate(told.values(), first):
            signal[FROM, joint, case] = value
    with jax.enable_x64(False):
        config = jaxftc.Config(puma, engine="chain")
        q = jnp.asarray(np.tile(REST[:, None], len(CASES)), jnp.float32)
        never = np.zeros(shape, bool)

        def run(config, gains, q, *told):
            return closed_loop(config, gains, q, lambda k: Told(*(signal[k] for signal in told)), TICKS, 3e-5)

        seen = jit(run, static_argnums=0)(config, jaxftc.default_gains(config), q, reading, never, tau, reference, never)
        return jax.tree.map(np.asarray, seen)


@pytest.mark.parametrize("case", CASES)
def test_the_arm_ends_where_it_should_and_nothing_is_said_of_it(puma, held, case):
    seen = jax.tree.map(lambda x: x[..., CASES.index(case)], held)
    error = np.rad2deg(np.abs(seen.q - REST))
    assert seen.finite.all() and (np.abs(seen.tau) <= puma.torque_limit * (1 + 1e-6)).all()
    assert error.max() < (READINGS[case][3] if case in READINGS else 1.0)
    end = FROM + (READINGS[case][1] if case in READINGS else 1)
    if case != "drags the arm along":  # comes back from 25 deg
        assert (seen.verdict[end + SECOND :] == 0).all()
    assert error[-1].max() < 0.05 and np.rad2deg(np.abs(seen.b[-1])).max() < 0.05


@pytest.mark.parametrize("case", [case for case, (_, ticks, _, _) in READINGS.items() if ticks > 5])
def test_meanwhile_it_is_called_a_sensor_fault_of_that_joint(held, case):
    joint, ticks, *_ = READINGS[case]
    if case == "stuck nearby":
        return  # 0.4 deg off: below the threshold
    verdict = held.verdict[FROM : FROM + ticks, :, CASES.index(case)]
    assert (verdict[20:, joint] == jaxftc.Verdict.SENSOR).mean() > 0.9


# ------------------------------------------------------------------ everything at once

KINDS = (
    "readings out of reach",
    "no readings",
    "torques",
    "references",
    "states",
    "readings within a turn",
    "several",
    "none",
)


def everything(config, scenarios, until, k):
    """Told of a tick: one kind for each eighth of the scenarios, in one tick of a hundred for each joint, until a tick."""
    shape, key = (config.n, scenarios), jax.random.fold_in(jax.random.key(7), k)
    kind = jnp.arange(scenarios) * len(KINDS) // scenarios
    keys = jax.random.split(key, 8)
    hit = [(jax.random.uniform(one, shape) < 0.01) & (k < until) for one in keys[:5]]
    size = 10.0 ** jax.random.uniform(keys[5], shape, minval=0.0, maxval=38.0)
    wild = jnp.where(jax.random.bernoulli(keys[6], 0.5, shape), size, -size)
    near = jax.random.uniform(keys[7], shape, minval=-6.0, maxval=6.0)
    far = jnp.where(jnp.abs(wild) < 100, jnp.inf, wild)
    many, tolerant = kind == 6, config.scheme == "cascade"  # the others take a reading at its word
    reading = jnp.where(hit[0] & ((kind == 0) | many), far, jnp.nan)
    reading = jnp.where(hit[1] & (kind == 5) & tolerant, near, reading)
    return Told(
        reading=reading,
        missing=hit[1] & ((kind == 1) | many),
        tau=jnp.where(hit[2] & ((kind == 2) | many), wild, jnp.nan),
        reference=jnp.where(hit[3] & ((kind == 3) | many), far, jnp.nan),
        broken=hit[4] & (kind == 4),
    )


def spoil(state, broken):
    """A state in which one number in many is NaN, infinite or 1e30."""
    leaves, tree = jax.tree.flatten(state)
    bad = jnp.asarray([jnp.nan, jnp.inf, -1e30])
    for k in range(0, len(leaves), 3):
        own = broken.any(0) & (jnp.arange(broken.shape[1]) % len(leaves) == k)
        leaves[k] = jnp.where(own, bad[k % 3], leaves[k])
    return jax.tree.unflatten(tree, leaves)


def survives(scheme, robot, scenarios, ticks):
    with jax.enable_x64(False):
        config = jaxftc.Config(robot, engine="chain", scheme=scheme)
        gains, until = jaxftc.default_gains(config), ticks - SECOND - SECOND // 2
        q = jnp.tile(jnp.asarray([[0.3], [0.5], [-0.4]], jnp.float32)[: config.n], scenarios)
        limit = config.robot.torque_limit[:, None] * (1 + 1e-6)

        def run(config, gains, q):
            seen = closed_loop(config, gains, q, lambda k: everything(config, scenarios, until, k), ticks, 1e-5, spoil)
            return (
                seen.finite.all(),
                (jnp.abs(seen.tau) <= limit).all(),
                seen.verdict[-SECOND // 2 :].max(),
                seen.q[-1],
                ((seen.verdict == jaxftc.Verdict.UNKNOWN).any((0, 1))),
            )

        finite, within, verdict, end, unknown = map(np.asarray, jit(run, static_argnums=0)(config, gains, q))
    kind = np.arange(scenarios) * len(KINDS) // scenarios
    assert finite and within and verdict == 0
    assert unknown[kind == 4].any() and not unknown[kind != 4].any()
    assert np.rad2deg(np.abs(end - np.asarray(q))).max() < 0.5


@pytest.mark.parametrize(
    "scheme", ["cascade", "momentum", pytest.param("ekf", marks=pytest.mark.thorough), "computed_torque"]
)
def test_every_scheme_lives_through_everything_at_once(scheme):
    survives(scheme, two_hinges(), 64, 2500)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scheme", "scenarios"), [("cascade", 1000), ("momentum", 200), ("ekf", 200), ("computed_torque", 200)]
)
def test_ten_million_ticks_of_everything_at_once(scheme, scenarios):
    survives(scheme, three_hinges(), scenarios, 10_000)
