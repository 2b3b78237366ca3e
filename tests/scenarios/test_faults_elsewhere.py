"""The fault library at another simulator's commands and readings."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc import faults
from jaxftc.robot.model_file import compile_robot

DT = 0.01
TIMES = DT * np.arange(100)
COMMAND = np.stack([np.sin(3 * TIMES), 2 + np.cos(TIMES), TIMES], axis=1)
READING = np.stack([np.cos(5 * TIMES), 1 + TIMES], axis=1)


def every_kind():
    """Two commands and a reading of every kind of fault, one kind a run."""
    one = faults.healthy(3, 2)
    return {
        "actuator bias": (one.with_actuator_bias(2, 0.5, 0.3), lambda k, u, y: (u + np.array([0, 0.5, 0]), y)),
        "loss": (one.with_actuator_loss(1, 0.25, 0.3), lambda k, u, y: (u * [0.75, 1, 1], y)),
        "stuck": (one.with_stuck_actuator(3, 0.3), lambda k, u, y: (np.r_[u[:2], COMMAND[29, 2]], y)),
        "saturation": (one.with_actuator_saturation(2, 0.25, 0.3), lambda k, u, y: (np.clip(u, [-9, -1, -9], [9, 1, 9]), y)),
        "gain": (one.with_actuator_gain(2, -0.25, 0.3), lambda k, u, y: (u * [1, 0.75, 1], y)),
        "late command": (one.with_actuator_delay(1, 3, 0.3), lambda k, u, y: (np.r_[COMMAND[k - 3, 0], u[1:]], y)),
        "late reading": (one.with_encoder_delay(2, 5, 0.3), lambda k, u, y: (u, np.r_[y[0], READING[k - 5, 1]])),
        "rounding": (one.with_encoder_rounding(2, 0.1, 0.3), lambda k, u, y: (u, np.r_[y[0], 0.1 * round(10 * y[1])])),
        "wrap": (one.with_encoder_wrap(2, 1.25, 0.3), lambda k, u, y: (u, np.r_[y[0], y[1] - 2.5 * (y[1] > 1.25)])),
        "bias": (one.with_encoder_bias(1, 0.2, 0.3), lambda k, u, y: (u, y + np.array([0.2, 0]))),
        "drift": (one.with_encoder_drift(2, 0.2, 0.3), lambda k, u, y: (u, y + np.array([0, 0.2 * (TIMES[k] - 0.3)]))),
        "scale": (one.with_encoder_scale(2, 0.1, 0.3), lambda k, u, y: (u, y * [1, 1.1])),
        "freeze": (one.with_frozen_encoder(1, 0.3), lambda k, u, y: (u, np.r_[READING[29, 0], y[1]])),
        "dropout": (one.with_encoder_dropout(2, 0.3), lambda k, u, y: (u, np.r_[y[0], np.nan])),
    }


@pytest.mark.parametrize("kind", every_kind())
def test_every_kind_acts_on_numpy_arrays(kind):
    some, expected = every_kind()[kind]
    injector = faults.Injector(some, limit=[4.0, 4.0, 4.0])
    for k, t in enumerate(TIMES):
        command, reading = expected(k, COMMAND[k], READING[k]) if t >= 0.3 else (COMMAND[k], READING[k])
        np.testing.assert_allclose(injector.command(t, COMMAND[k]), command, rtol=1e-12)
        np.testing.assert_allclose(injector.reading(t, READING[k]), reading, rtol=1e-12)
        np.testing.assert_allclose(injector.command_error, command - COMMAND[k], atol=1e-12)
        np.testing.assert_allclose(injector.reading_error, np.nan_to_num(reading - READING[k]), atol=1e-12)


def test_a_fault_of_single_precision_begins_at_the_time_that_was_given():
    with jax.enable_x64(False):
        some = faults.healthy(1).with_actuator_bias(1, 0.7, 0.1)
    injector = faults.Injector(some)
    assert [float(injector.command(t, [0.0])[0]) for t in 0.1 * np.arange(3)] == [0.0, 0.7, 0.7]


def test_noise_is_made_larger():
    injector = faults.Injector(faults.healthy(1).with_encoder_noise(1, 10.0, 0.5))
    assert injector.reading(0.4, [1.0], [0.01]) == pytest.approx(1.01)
    assert injector.reading(0.6, [1.0], [0.01]) == pytest.approx(1.1)


def test_runs_side_by_side_are_runs_alone_and_jax_is_numpy():
    sizes = np.array([0.1, 0.2, 0.3])
    many = faults.healthy(2, runs=3).with_actuator_bias(1, sizes, sizes).with_frozen_encoder(2, onset=sizes)
    pairs = np.random.default_rng(0).normal(size=(60, 2, 3, 2))

    def tick(state, given):
        t, (command, reading) = given
        state, command = faults.deliver(many, state, t, command)
        state, reading, _ = faults.read(many, state, t, reading)
        return state, (command, reading)

    _, (commands, readings) = jax.jit(lambda p: jax.lax.scan(tick, faults.init(*p[0]), (DT * jnp.arange(60), p)))(pairs)
    for run in range(3):
        alone = faults.Injector(jax.tree.map(lambda leaf, run=run: leaf[run], many))
        beside = faults.Injector(many)
        for k in range(60):
            ours = alone.command(k * DT, pairs[k, 0, run]), alone.reading(k * DT, pairs[k, 1, run])
            np.testing.assert_allclose(ours[0], commands[k, run], rtol=1e-12)
            np.testing.assert_allclose(ours[1], readings[k, run], rtol=1e-12)
            np.testing.assert_array_equal(ours[0], beside.command(np.full(3, k * DT), pairs[k, 0])[run])


def test_it_does_what_our_own_loop_does():
    from benchmarks.arms import serial

    config = jaxftc.Config(compile_robot("two", serial(2)), engine="chain", duration=0.3)
    scenario = jaxftc.healthy_scenario(config).with_actuator_loss(1, 0.5, 0.1).with_encoder_drift(2, 0.5, 0.1, rise=0.1)
    trace = jaxftc.simulate(config, jaxftc.default_gains(config), scenario, jax.random.key(0))
    some = faults.healthy(2).with_actuator_loss(1, 0.5, 0.1).with_encoder_drift(2, 0.5, 0.1, rise=0.1)
    injector = faults.Injector(some, limit=config.robot.torque_limit)
    for k in range(config.ticks):
        np.testing.assert_allclose(injector.command(trace.t[k], trace.out.tau[k]), trace.tau_applied[k], atol=1e-9)
        clean = trace.y[k] - trace.fault_q[k]
        np.testing.assert_allclose(injector.reading(trace.t[k], clean), trace.y[k], atol=1e-9)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match=r"command.*\[2\].*\[3\]"):
        faults.Injector(faults.healthy(2)).command(0.0, np.zeros(3))
    with pytest.raises(ValueError, match="joint must be 1 to 2, got 3"):
        faults.healthy(3, 2).with_encoder_bias(3, 0.1, 0.1)
    with pytest.raises(ValueError, match="runs must be an integer of at least 1"):
        faults.healthy(3, runs=0)
    with pytest.raises(ValueError, match="faults must be a Faults"):
        faults.Injector("bias")


def test_gymnasium_sees_faults_and_info_has_the_truth():
    gymnasium = pytest.importorskip("gymnasium", reason="pip install 'jaxftc[gym]'")
    from jaxftc.faults.gym import FaultWrapper

    class Cart(gymnasium.Env):
        """x' = v, v' = u, both seen."""

        dt = DT
        action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
        observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            self.x = np.zeros(2)
            return self.x.copy(), {}

        def step(self, action):
            self.x = self.x + self.dt * np.array([self.x[1], action[0]])
            return self.x.copy(), -abs(self.x[0]), False, False, {"own": 1}

    plan = faults.healthy(1).with_actuator_loss(1, 0.5, 0.0).with_encoder_bias(1, 0.3, 0.095)
    env = FaultWrapper(Cart(), plan, sensors=[0])
    seen, info = env.reset(seed=0)
    assert not seen.any()
    for _ in range(20):
        seen, _, _, _, info = env.step(np.array([3.0], np.float32))  # clipped to 1, of which half is lost
    np.testing.assert_allclose(env.unwrapped.x[1], 20 * DT * 0.5)
    np.testing.assert_allclose(info["faults"]["action"], [-0.5])
    np.testing.assert_allclose(info["faults"]["observation"], [0.3, 0.0])
    np.testing.assert_allclose(seen - info["faults"]["truth"], [0.3, 0.0])
    np.testing.assert_array_equal(info["faults"]["truth"], env.unwrapped.x)
    assert info["own"] == 1

    def draw(random):
        return faults.healthy(1, 2).with_encoder_bias(int(random.integers(1, 3)), random.uniform(1, 2), 0.0)

    drawn = FaultWrapper(Cart(), draw)
    first = [drawn.reset(seed=seed)[0].tolist() for seed in (1, 1, 2)]
    assert first[0] == first[1] != first[2] and max(first[0]) >= 1
    with pytest.raises(ValueError, match=r"1 commands and 1 readings"):
        FaultWrapper(Cart(), draw, sensors=[0]).reset()
    with pytest.raises(ValueError, match="sensors must be entries of the observation, 0 to 1"):
        FaultWrapper(Cart(), plan, sensors=[2])


def test_without_gymnasium_it_says_what_to_install(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, "jaxftc.faults.gym", raising=False)
    with pytest.raises(ImportError, match=r"pip install 'jaxftc\[gym\]'"):
        import jaxftc.faults.gym  # noqa: F401
