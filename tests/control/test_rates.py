"""Default gains at other sample times and with other encoders."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc.gains import shape_of, specs
from jaxftc.observer import frequency, stability
from jaxftc.observer.readout import exact
from jaxftc.robot import dynamics
from jaxftc.schemes import registry
from tests.arms import three_hinges

RATES = (0.25e-3, 0.5e-3, 1e-3, 2e-3, 4e-3, 5e-3, 8e-3, 10e-3, 20e-3)  # s
COUNTS = [2 * np.pi / 2**bits for bits in (10, 12, 14, 16, 20)]  # rad
NOISES = [1e-4, 3e-4, 1e-3]  # rad


def config(dt, **more):
    return jaxftc.Config(three_hinges(), dt=dt, t_final=1.0, engine="chain", **more)


def test_at_1_ms_the_numbers_are_those_of_the_gains():
    made = jaxftc.default_gains(config(1e-3))
    for block, name, spec in specs():
        if spec.default is not None:
            wanted = np.broadcast_to(spec.default, shape_of(config(1e-3), spec))
            np.testing.assert_array_equal(getattr(getattr(made, block), name), wanted, err_msg=name)


def test_a_light_arm_with_strong_motors_has_no_jump_for_its_torques():
    """A quarter of the torque limit is a motor's fault, though it throws the joint by half of what is a jump elsewhere."""
    arm = three_hinges()
    strong = arm.replace(torque_limit=np.maximum(1.0, 2500 / arm.acceleration_limit) * arm.torque_limit)
    own = jaxftc.Config(strong, t_final=0.3, duration=0.3, engine="chain")
    gains, scenario = jaxftc.default_gains(own), jaxftc.paper_scenario("healthy", own)
    trace = jaxftc.simulate(
        own, gains, scenario.with_actuator_bias(3, 0.25 * strong.torque_limit[2], 0.1), jax.random.key(0)
    )
    seen = slice(int(np.argmax(trace.out.detected)), None)
    assert (np.asarray(trace.out.verdict[seen, 2]) & 2 == 0).all() and (trace.out.fault_tau_hat[seen, 2] > 0).all()
    assert trace.out.fault_tau_hat[250, 2] == pytest.approx(0.25 * strong.torque_limit[2], rel=0.1)
    heavy = jaxftc.Config(arm.replace(torque_limit=arm.torque_limit * np.inf), engine="chain")
    np.testing.assert_array_equal(jaxftc.default_gains(heavy).observer.jump, 1e-3)
    lighter = jaxftc.Config(arm.replace(torque_limit=1e6 * arm.torque_limit), engine="chain")
    np.testing.assert_array_equal(jaxftc.default_gains(lighter).observer.jump, 5e-3)


@pytest.mark.parametrize("dt", RATES)
def test_the_observer_is_stable_at_every_rate_with_every_encoder(dt):
    for given in [{}, *({"resolution": c} for c in COUNTS), *({"noise": s} for s in NOISES)]:
        gains = jaxftc.default_gains(config(dt), **given)
        assert (stability.spectral_radius(config(dt), gains) < 1).all(), given
    for fuzzy in (False, True):
        modulus = frequency.margins(config(dt), jaxftc.default_gains(config(dt)), fuzzy=fuzzy).modulus
        assert (modulus > 0.25).all()


def test_its_bandwidth_is_that_of_1_ms_less_what_fewer_readings_cost():
    bandwidth = [frequency.margins(config(dt), jaxftc.default_gains(config(dt))).crossover[0] for dt in (0.5e-3, 1e-3, 5e-3)]
    assert 0.95 < bandwidth[0] / bandwidth[1] < 1.1
    assert 0.5 < bandwidth[2] / bandwidth[1] < 1


def test_one_joint_may_have_a_worse_encoder():
    gains = jaxftc.default_gains(config(1e-3), noise=[3e-5, 3e-4, 3e-5])
    assert gains.observer.alpha_i[1] < gains.observer.alpha_i[0] == gains.observer.alpha_i[2]
    assert gains.observer.jump[1] == pytest.approx(10 * gains.observer.jump[0])


@pytest.mark.parametrize("given", [{"noise": -1.0}, {"noise": np.nan}, {"resolution": [1e-3, 1e-3]}])
def test_no_such_encoder(given):
    with pytest.raises(ValueError, match="must be a number of rad, at least 0, or 3 of them"):
        jaxftc.default_gains(config(1e-3), **given)


@pytest.mark.parametrize("use", ["init", "simulate", "Diagnoser"])
def test_an_unstable_observer_is_refused_with_its_radius(use):
    """The gains of 1 ms at 10 ms: they ran to NaN, and NaN was normal."""
    slow, of_1_ms = config(0.01), jaxftc.default_gains(config(1e-3))
    gains = exact(
        slow, dataclasses.replace(of_1_ms, arx=jaxftc.default_gains(slow).arx).replace({"arx.xi_a": 0.8, "arx.xi_b": 0.8})
    )
    with pytest.raises(ValueError, match=r"joint 1.*unstable.*0.01 s.*radius.*1\.\d+"):
        if use == "init":
            jaxftc.init(slow, gains, jnp.zeros(3))
        elif use == "simulate":
            jaxftc.simulate(slow, gains, jaxftc.healthy_scenario(slow), jax.random.key(0))
        else:
            jaxftc.Diagnoser(slow, gains)


def test_every_scenario_of_swept_gains_is_looked_at():
    made = config(1e-3)
    one = jaxftc.default_gains(made)
    factors = np.array([[1.0, 0.5, 1.0], [2.0, 30.0, 0.5]])
    swept = one.replace({"observer.alpha_i": np.asarray(one.observer.alpha_i)[:, None, None] * factors})
    found = stability.spectral_radius(made, swept)
    for place, factor in np.ndenumerate(factors):
        alone = one.replace({"observer.alpha_i": one.observer.alpha_i * factor})
        np.testing.assert_array_equal(found[:, *place], stability.spectral_radius(made, alone))
    with pytest.raises(ValueError, match=r"joint 1.*scenario 1, 1.*unstable.*1\.\d+"):
        jaxftc.Diagnoser(made, swept)


def test_alarms_last_as_long_at_every_rate():
    for dt in RATES:
        made = config(dt)
        assert abs(made.transient_ticks * dt - 0.06) < 0.061 and made.transient_ticks >= 6
        assert made.alarm_ticks >= 2 and made.release_ticks >= 3
    assert (config(1e-3).alarm_ticks, config(1e-3).release_ticks, config(1e-3).transient_ticks) == (3, 10, 60)
    assert config(0.01, alarm_ticks=7).alarm_ticks == 7


def test_ticks_that_were_not_given_follow_a_replaced_sample_time():
    made = dataclasses.replace(config(1e-3, alarm_ticks=7), dt=0.01)
    assert (made.alarm_ticks, made.release_ticks, made.transient_ticks) == (7, 3, 6)
    assert made == config(0.01, alarm_ticks=7) and json.dumps(made.record["release_ticks"]) == "3"
    assert dataclasses.replace(made, dt=1e-3).record == config(1e-3, alarm_ticks=7).record


RUN_RATES = [pytest.param(dt, marks=() if dt in (2e-3, 10e-3) else pytest.mark.slow) for dt in RATES]


@pytest.mark.thorough
@pytest.mark.parametrize("dt", RUN_RATES)
def test_a_healthy_arm_is_quiet_with_every_encoder(dt):
    """The arm moves and stands, encoders of 10 to 20 bit and with white noise side by side."""
    made = config(dt, duration=1.6)
    given = [{}, *({"resolution": c} for c in COUNTS), *({"noise": s} for s in NOISES)]
    gains = jax.tree.map(lambda *x: jnp.stack(x, -1), *(jaxftc.default_gains(made, **g) for g in given))
    count = jnp.asarray([g.get("resolution", 0.0) for g in given])
    noise = jnp.asarray([g.get("noise", 0.0 if g else 3e-5) for g in given])
    verdict, error = closed_loop(made, gains, count, noise)
    assert not verdict.any(), [(g, int(v)) for g, v in zip(given, (verdict > 0).sum((0, 1)), strict=True) if v]
    assert error < 0.1  # rad: the loop holds, too


def closed_loop(config, gains, count, noise):
    """Verdicts [T, n, encoders] and largest tracking error of the nominal arm, with encoders of counts or white noise."""
    robot, plant, n = config.robot, dynamics.nominal_plant(config.robot), config.n
    start = jnp.zeros((n, len(noise)))

    def body(carry, k):
        state, q, qd, tau = carry
        s = jnp.clip(k * config.dt, 0.0, 1.0)
        shape = (10 * s**3 - 15 * s**4 + 6 * s**5, 30 * s**2 - 60 * s**3 + 30 * s**4, 60 * s - 180 * s**2 + 120 * s**3)
        reference = jaxftc.Reference(*(x * jnp.ones_like(q) for x in shape))
        y = q + noise * jax.random.normal(jax.random.fold_in(jax.random.key(1), k), q.shape)
        y = jnp.where(count > 0, jnp.round(y / jnp.maximum(count, 1e-9)) * count, y)
        state, out = jaxftc.step(config, gains, state, reference, jaxftc.Measurement(y, tau))
        qdd = dynamics.acceleration(robot, "chain", plant, q, qd, out.tau, config.dt)
        qd = qd + config.dt * qdd
        return (state, q + config.dt * qd, qd, out.tau), (out.verdict, jnp.abs(q - reference.q).max())

    @jax.jit
    def run(gains):
        state = registry.init(config, gains, start)
        begin = (state, start, jnp.zeros_like(start), registry.holding_torque(config, start))
        return jax.lax.scan(body, begin, jnp.arange(config.ticks))[1]

    verdict, error = run(gains)
    return np.asarray(verdict), float(error.max())
