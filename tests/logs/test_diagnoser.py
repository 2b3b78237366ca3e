"""Diagnosis under somebody else's controller: readings and torques of a small arm at 100 Hz, and events made of verdicts."""

import csv
import dataclasses
import json
import shlex

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from jaxftc import logs
from jaxftc.campaigns import log_follow, log_thresholds
from jaxftc.campaigns.follow import with_shares
from jaxftc.campaigns.log_thresholds import calibrate_on_logs, reading_noise
from jaxftc.campaigns.return_level import ReturnLevel
from jaxftc.cli.main import main
from jaxftc.gains_file import save_gains
from jaxftc.io import tables
from jaxftc.logs import pieces
from jaxftc.logs.diagnose import CHUNK
from jaxftc.logs.log import Log
from jaxftc.logs.timeline import Timeline
from jaxftc.report.diagnosis import POINTS, Envelope
from jaxftc.report.figures import curve
from jaxftc.schemes import diagnoser
from jaxftc.schemes.diagnoser import Diagnosis
from tests import small_logs

DT, ON = 0.01, 800  # s; tick at which faults begin


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The small arm with its friction and motor inertia, as ``identify`` would give it."""
    robot = small_logs.robot(tmp_path_factory.mktemp("arm"))
    both = {f"{name}_{side}": value for side in ("positive", "negative")
            for name, value in (("coulomb", small_logs.COULOMB), ("damping", small_logs.VISCOUS))}  # fmt: skip
    return robot.replace(armature=small_logs.MOTOR, **both)


def healthy(arm, seed, seconds=16.0):
    table = small_logs.table(arm_file(arm), seconds, 1 / DT, seed)
    q, tau = (np.stack([table[f"{name}{j}"] for j in (1, 2, 3)], 1) for name in ("q", "tau"))
    return Log(q, tau - small_logs.OFFSET, DT * np.arange(len(q)), DT)


def arm_file(arm):
    """The arm without what the file lacks: ``small_logs.torque`` adds it."""
    return arm.replace(
        armature=np.zeros(3), **{f"{n}_{s}": np.zeros(3) for n in ("coulomb", "damping") for s in ("positive", "negative")}
    )


@pytest.fixture(scope="module")
def config(arm):
    return jaxftc.Config(arm, dt=DT, t_final=DT, engine="chain")


@pytest.fixture(scope="module")
def calibration(config, arm):
    healthy_logs = [healthy(arm, seed, 24.0) for seed in (1, 2)]
    start = jaxftc.default_gains(config)
    gains = jaxftc.default_gains(config, noise=reading_noise(config, start, healthy_logs))
    return calibrate_on_logs(config, gains, healthy_logs, false_alarms=0.1)


@pytest.fixture(scope="module")
def log(arm):
    return healthy(arm, 3)


def events(config, gains, log):
    line = Timeline(config.robot.joint_names, config.dt)
    line.add(logs.diagnose(config, gains, log), 0.0)
    line.finish()
    return line


def test_a_healthy_log_is_quiet_and_the_promise_is_small(config, calibration, log):
    line = events(config, calibration.gains, log)
    assert line.alarm_share == 0 and not line.events
    promise = calibration.promise
    assert promise.method == "tail" and promise.healthy_s == pytest.approx(48)
    assert promise.at_most_per_hour == pytest.approx(3 * 3600 / 48, rel=0.01), "three over the time, for no alarm at 95 %"
    assert calibration.noise == pytest.approx(1e-5, rel=0.5)


def actuator(q, tau):
    tau[ON:, 1] -= 8.0


def bias(q, tau):
    q[ON:, 1] += np.deg2rad(1.0)


def drift(q, tau):
    q[ON:, 2] += np.deg2rad(10.0) * DT * np.arange(len(q) - ON)


def freeze(q, tau):
    q[ON:, 0] = q[ON, 0]


def lost(q, tau):
    q[ON:, 0] = np.nan


FAULTS = [(actuator, 2, "actuator"), (bias, 2, "sensor"), (drift, 3, "sensor"), (freeze, 1, "sensor"), (lost, 1, "sensor")]


@pytest.mark.parametrize(("fault", "joint", "kind"), FAULTS, ids=[fault.__name__ for fault, *_ in FAULTS])
def test_a_fault_is_one_event_of_its_joint_and_kind(config, calibration, log, fault, joint, kind):
    q, tau = log.q.copy(), log.tau.copy()
    fault(q, tau)
    line = events(config, calibration.gains, log._replace(q=q, tau=tau))
    assert [(event.joint, event.kind) for event in line.events] == [(joint, kind)]
    event = line.events[0]
    assert (
        -0.03 < event.start_s - ON * DT < 0.4
        and event.end_s > 15.5
        and event.joint_name == config.robot.joint_names[joint - 1]
    )
    sizes = {"actuator": (8.0, "N m"), "bias": (1.0, "deg")}
    if fault.__name__ in sizes:
        assert (abs(event.size), event.unit) == (pytest.approx(sizes[fault.__name__][0], rel=0.15), sizes[fault.__name__][1])


def test_what_is_masked_is_absent(config, calibration, log):
    diagnoser = jaxftc.Diagnoser(config, calibration.gains)
    state, mask = diagnoser.init(log.q[0]), np.arange(config.n) == 1
    masked, absent = (
        diagnoser.step(state, hide(log.q[1]), hide(log.tau[1]))[1]
        for hide in (lambda x: np.ma.masked_array(np.where(mask, 9.0, x), mask), lambda x: np.where(mask, np.nan, x))
    )
    jax.tree.map(np.testing.assert_array_equal, masked, absent)
    with pytest.raises(ValueError, match="q must be finite"):
        diagnoser.init(np.ma.masked_array(log.q[0], mask))


def test_the_fast_residual_is_a_low_pass_of_what_the_slow_one_sees(config, calibration, log):
    """Its twin from the slow one alone; while a joint stands or turns round they are the same."""
    weight, rate = 0.7, np.array([5.0, 12.0, 8.0])
    alone = calibration.gains.replace({"diagnosis.rate": rate, "diagnosis.fast": 0.0, "diagnosis.stiction": 0.0})
    tau = log.tau.copy()
    tau[ON:, 1] -= 8.0
    said = logs.diagnose(config, alone, log._replace(tau=tau))
    slow, moves = said.fault_tau_hat, np.abs(said.qd_hat) >= diagnoser.SLOW
    torque = slow[:-1] + np.diff(slow, axis=0) / -np.expm1(-rate * DT)
    fast = slow.copy()
    for k in range(1, len(slow)):
        low_passed = fast[k - 1] - np.expm1(-diagnoser.FAST * DT) * (torque[k - 1] - fast[k - 1])
        fast[k] = np.where(moves[k], low_passed, slow[k])
    both = logs.diagnose(config, alone.replace({"diagnosis.fast": weight}), log._replace(tau=tau))
    want = np.where(np.abs(weight * fast) > np.abs(slow), weight * fast, slow)[ON - 300 :]
    np.testing.assert_allclose(both.statistic_tau[ON - 300 :], want, atol=2e-3)
    assert (np.abs(want) > np.abs(slow[ON - 300 :]) + 0.1).any(), "the fast one counts somewhere"
    np.testing.assert_array_equal(both.fault_tau_hat, slow, err_msg="the estimate is the slow one's")


def test_a_fast_residual_that_is_the_slow_one_changes_nothing(config, calibration, log):
    same = {"diagnosis.rate": diagnoser.FAST, "diagnosis.stiction": 0.0}
    one, two = (logs.diagnose(config, calibration.gains.replace(same | {"diagnosis.fast": w}), log) for w in (0.0, 1.0))
    np.testing.assert_allclose(one.statistic_tau, two.statistic_tau, atol=1e-5)


def test_large_faults_are_seen_sooner_and_small_ones_no_later(config, calibration, log):
    slow = calibration.gains.replace({"diagnosis.fast": 0.0})
    weight, alpha = (np.asarray(getattr(calibration.gains.diagnosis, name)) for name in ("fast", "alpha_tau"))
    assert (weight > 0.2).all() and (weight <= 1).all()

    def delays(gains, size):
        """Ticks [n] to the alarm of each joint."""
        found = []
        for joint in range(config.n):
            tau = log.tau.copy()
            tau[ON:, joint] -= size * alpha[joint]
            verdict = logs.diagnose(config, gains, log._replace(tau=tau)).verdict
            assert not verdict[:ON].any()
            found.append(int(np.argmax(verdict[ON:, joint] > 0)))
        return np.array(found)

    small, large = ([delays(gains, size) for gains in (calibration.gains, slow)] for size in (1.5, 4.0))
    assert (small[0] <= small[1]).all()
    assert (large[0] <= large[1]).all() and (large[0] < large[1]).any(), large


@pytest.mark.parametrize("columns", [("q2",), ("q2", "tau2")], ids=["angle", "angle and torque"])
@pytest.mark.parametrize("last", [1100, 1600], ids=["comes back", "for good"])
def test_an_encoder_that_falls_silent_in_a_file_is_an_event(config, calibration, log, tmp_path, columns, last):
    """Its rows are not left out, as a gap of the recorder is."""
    table = {"t": log.t} | {f"{name}{j + 1}": getattr(log, name)[:, j].copy() for name in ("q", "tau") for j in range(3)}
    for name in columns:
        table[name][ON:last] = np.nan
    path = small_logs.write(tmp_path / "log.csv", table)
    read, tick = logs.read(path, config, check=False, faulty=True), np.arange(len(log.q))[:, None]
    silent = (tick >= ON) & (tick < last) & (np.arange(3) == 1)
    np.testing.assert_array_equal(np.isnan(read.q), silent)
    np.testing.assert_array_equal(np.isnan(read.tau), silent & ("tau2" in columns))
    assert any(f"has no angle in {last - ON} rows, the first is row {ON + 1}" in note for note in read.notes)
    line = events(config, calibration.gains, read)
    assert [(event.joint, event.kind) for event in line.events] == [(2, "sensor")]
    assert abs(line.events[0].start_s - ON * DT) < 0.1 and abs(line.events[0].end_s - last * DT) < 0.3
    assert len(logs.read(path, config, check=False).q) < len(log.q), "a log that is to be healthy has no such rows"


def rubbing(log):
    """The log of an arm with more viscous friction than its model has."""
    return log._replace(tau=log.tau + 1.5 * np.gradient(log.q, DT, axis=0))


@pytest.mark.thorough
def test_thresholds_follow_a_motion_that_the_model_has_wrong(config, calibration, arm, log):
    healthy_logs = [rubbing(healthy(arm, seed, 24.0)) for seed in (1, 2)]
    plain = calibrate_on_logs(config, calibration.gains, healthy_logs, false_alarms=0.1)
    shares = log_follow.fit(config, plain.gains, healthy_logs)
    assert (shares.values >= 0).all() and (shares.loss < 0.95).any() and (shares.loss <= 1).all()
    moving = calibrate_on_logs(config, with_shares(calibration.gains, shares.values), healthy_logs, false_alarms=0.1)
    follows = shares.values.any(1)
    at_rest = [np.asarray(found.gains.diagnosis.alpha_tau)[follows] for found in (plain, moving)]
    assert (at_rest[1] < 0.9 * at_rest[0]).all()
    fresh = rubbing(log)
    assert not events(config, moving.gains, fresh).events and moving.promise.seen == 0
    tau = fresh.tau.copy()
    tau[ON:, 1] -= 8.0
    found = [events(config, gains, fresh._replace(tau=tau)).events for gains in (plain.gains, moving.gains)]
    assert [(event.joint, event.kind) for event in found[1]] == [(2, "actuator")]
    assert not found[0] or found[1][0].start_s <= found[0][0].start_s + 0.05


def test_logs_without_torques_leave_the_torque_channel_as_it_is(config, calibration, arm):
    """With runs enough to count, which once divided 0 by 0."""
    bare = [log._replace(tau=np.full_like(log.tau, np.nan)) for log in (healthy(arm, seed, 24.0) for seed in (1, 2))]
    found = calibrate_on_logs(config, calibration.gains, bare, false_alarms=0.1, run=1.0)
    assert found.promise.method == "sample"
    for name in ("alpha_tau", "rate", "fast", "lam_tau"):
        np.testing.assert_array_equal(getattr(found.gains.diagnosis, name), getattr(calibration.gains.diagnosis, name))
    assert np.isfinite(found.gains.diagnosis.alpha_q).all() and np.isfinite(found.gains.observer.jump).all()


def test_logs_too_short_for_two_halves_make_them_together(config, calibration, arm):
    whole, size = rubbing(healthy(arm, 1, 24.0)), round(4.0 / DT)
    logs = [whole._replace(q=whole.q[k : k + size], tau=whole.tau[k : k + size], t=whole.t[:size])
            for k in range(0, len(whole.q), size)]  # fmt: skip
    assert (log_follow.fit(config, calibration.gains, logs).loss < 0.95).any()


def test_a_row_that_was_stamped_wrong_is_no_fault(config, calibration, log):
    """A log whose clock slips by half a sample, for every joint at once, is no encoder's; a jump of one joint is."""
    q, late = log.q.copy(), log.q.copy()
    q[ON] = 0.5 * (q[ON] + q[ON - 1])
    late[ON:, 0] += 0.02
    assert not (logs.diagnose(config, calibration.gains, log._replace(q=q)).verdict & jaxftc.Verdict.SENSOR).any()
    verdict = logs.diagnose(config, calibration.gains, log._replace(q=late)).verdict[:, 0]
    assert verdict[ON] == jaxftc.Verdict.NORMAL and verdict[ON + 1] == jaxftc.Verdict.SENSOR


def test_rows_that_were_written_late_are_no_fault(config, calibration, tmp_path):
    """A recorder polls, at uneven times, what the robot refreshes every 8 ms; one joint moves, so no other one says so."""
    rng = np.random.default_rng(4)
    t = np.cumsum(np.r_[0.0, rng.uniform(0.006, 0.014, 1199)])
    q = np.tile([0.2, -0.6, 0.9], (1200, 1)) + 1e-5 * rng.standard_normal((1200, 3))
    q[:, 1] += 0.1 * np.floor(t / 0.008) * 0.008
    columns = {"t": t} | {f"q{j + 1}": q[:, j] for j in range(3)}
    log = logs.read(small_logs.write(tmp_path / "polled.csv", columns), config)
    assert log.jitter.min() > 0.002 and log.jitter.max() < 0.01
    verdict = logs.diagnose(config, calibration.gains, log).verdict
    assert not (verdict & jaxftc.Verdict.SENSOR).any()
    on = log.t > 6.0
    assert (logs.diagnose(config, calibration.gains, log._replace(jitter=None)).verdict[:, 1] & jaxftc.Verdict.SENSOR).any()
    faulty = log._replace(q=log.q + np.deg2rad(1.0) * np.outer(on, [0, 1, 0]))
    verdict = logs.diagnose(config, calibration.gains, faulty).verdict
    assert not verdict[~on].any() and (verdict[on][2:] & jaxftc.Verdict.SENSOR == [0, jaxftc.Verdict.SENSOR, 0]).all()


def test_an_alarm_at_the_start_of_a_motion_ends(config, arm, calibration):
    """The joint stood, held by friction, which turned round before it broke away; then the model is right again."""
    t, q, qd, qdd = small_logs.motion(16.0, 1 / DT, 3)
    start = 800
    after = np.clip(t - t[start], 0, None)
    q[:, 1] = -0.6 + 0.25 * (1 - np.cos(1.2 * after))
    qd[:, 1], qdd[:, 1] = 0.3 * np.sin(1.2 * after), 0.36 * np.cos(1.2 * after) * (after > 0)
    tau = small_logs.torque(arm_file(arm), q, qd, qdd) - small_logs.OFFSET
    tau[: start - 40, 1] += 1.9
    tau[start - 40 : start, 1] -= 1.9
    said = logs.diagnose(config, calibration.gains, Log(q, tau, t, DT))
    up = np.asarray(said.verdict)[:, 1] > 0
    assert up[start - 40 : start + 20].any() and not up[: start - 40].any()
    assert not up[start + 100 :].any()


@pytest.mark.parametrize("back", [1, 2])
def test_a_reading_that_comes_late_is_no_fault(config, calibration, log, back):
    """It is off for a tick, or to one side and then to the other, and right again."""
    q = log.q.copy()
    q[ON, 1] += 0.03
    q[ON + 1, 1] -= 0.03 * (back - 1)
    said = logs.diagnose(config, calibration.gains, log._replace(q=q))
    assert np.abs(said.jump[ON, 1]) > 0.02 and not said.verdict.any()
    healthy = logs.diagnose(config, calibration.gains, log)
    np.testing.assert_allclose(said.q_hat[ON + 30 :], healthy.q_hat[ON + 30 :], atol=1e-3)


def stopping(arm, hit):
    """The first joint goes at 0.1 rad/s and stops within 50 ms: by its motor, or because it runs into something."""
    t = DT * np.arange(1200)
    shape = np.clip((t - 2.0) / 0.5, 0, 1) - np.clip((t - 8.0) / 0.05, 0, 1)
    qd = np.outer(0.1 * shape, [1, 0, 0])
    q = np.cumsum(qd, axis=0) * DT + [0.2, -0.6, 0.9]
    qdd = np.gradient(qd, DT, axis=0)
    qdd[700:, 0] *= not hit
    tau = small_logs.torque(arm_file(arm), q, qd, qdd) - small_logs.OFFSET
    tau[800:804, 0] += 15.0 * hit  # the controller pushes back
    tau[820:, 0] += 0.5 * small_logs.COULOMB[0]  # it pushes on, by less than friction holds
    return Log(q, tau, t, DT)


def test_what_stops_a_joint_is_seen_although_friction_holds_what_follows(config, calibration, arm):
    for level in (1.0, 40.0):  # times the threshold; the second is reached when the joint is slow already
        gains = calibration.gains.replace({"diagnosis.alpha_tau": level * calibration.gains.diagnosis.alpha_tau})
        assert not events(config, gains, stopping(arm, hit=False)).events
        found = events(config, gains, stopping(arm, hit=True)).events
        assert [(event.joint, event.kind) for event in found] == [(1, "actuator")] and -0.01 < found[0].start_s - 8.0 < 0.1


def test_without_torques_the_readings_are_judged(config, calibration, log):
    q = log.q.copy()
    bias(q, None)
    line = events(config, calibration.gains, log._replace(q=q, tau=np.full_like(q, np.nan)))
    assert [(event.joint, event.kind) for event in line.events] == [(2, "sensor")]


def overflowing(log):
    tau = log.tau.copy()
    tau[ON:] = 1e308
    return log._replace(tau=tau)


def test_nothing_leaves_as_normal_that_cannot_be_judged(config, calibration, log):
    """Torques that overflow: what comes of them is no number, and no joint of it is normal."""
    said = logs.diagnose(config, calibration.gains, overflowing(log))
    assert (said.verdict[ON + 10 :] > 0).all() and said.detected[ON + 10 :].all()


def test_a_step_is_pure_and_may_be_jitted_and_mapped(config, calibration, log):
    diagnoser = jaxftc.Diagnoser(config, calibration.gains)
    step = jax.jit(diagnoser.step)
    state = diagnoser.init(log.q[0])
    for k in range(30):
        state, said = step(state, log.q[k], log.tau[k])
    step_both = jax.jit(jax.vmap(diagnoser.step, in_axes=(0, 0, None)))
    states = jax.tree.map(lambda x: jnp.stack([x, x]), state)
    for k in (30, 31):
        states, two = step_both(states, jnp.stack([log.q[k], log.q[k] + 0.1]), log.tau[k])
        state, one = step(state, log.q[k], log.tau[k])
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a[0], b, atol=1e-9), two, one)
    assert one.verdict.tolist() == [0, 0, 0] and (two.verdict[1] == 2).all()
    assert isinstance(said, Diagnosis)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda d, s: d.init(np.zeros(2)), "q must have the 3 joints on its first axis"),
        (lambda d, s: d.init([0.0, np.nan, 0.0]), "q must be finite"),
        (lambda d, s: d.step(s, np.zeros(3), np.zeros(2)), "torque must have the shape of state.q"),
    ],
)
def test_what_the_diagnoser_refuses(config, calibration, call, message):
    diagnoser = jaxftc.Diagnoser(config, calibration.gains)
    with pytest.raises(ValueError, match=message):
        call(diagnoser, diagnoser.init(np.zeros(3)))


def test_seconds_of_healthy_motion_give_thresholds(config, calibration, log):
    """Not far from those of a minute, and marked as a guess that the time does not bear out."""
    short = Log(log.q[:600], log.tau[:600], dt=DT)
    found = calibrate_on_logs(config, calibration.gains, [short], false_alarms=0.1)
    ratio = np.asarray(found.gains.diagnosis.alpha_tau) / np.asarray(calibration.gains.diagnosis.alpha_tau)
    assert (ratio > 0.3).all() and (ratio < 3).all()
    assert found.promise.method == "tail" and found.promise.at_most_per_hour > 1000
    assert events(config, found.gains, short).alarm_share == 0


def test_where_the_diagnosis_of_a_log_is_cut_does_not_matter(config, calibration, arm):
    """Blocks of a second and alarms go on from one call of the compiled program to the next."""
    long = healthy(arm, 4, 90.0)
    assert len(long.q) > 2 * CHUNK  # three calls, none of a whole number of seconds
    opened = log_thresholds._open(config, calibration.gains)
    found = log_thresholds._peaks(config, opened, [long, long], 1.0)
    assert len(found.tau) == len(found.w) == 2 * 90
    said = logs.diagnose(config, opened, long)
    w = np.abs(said.jump[..., 0]).reshape(90, 100, 3).max(1)
    np.testing.assert_array_equal(found.w, np.concatenate([w, w]))
    always = calibration.gains.replace({"diagnosis.alpha_tau": 1e-9})
    assert log_thresholds._alarms(config, always, [long, long]) == 2


def test_calibration_refuses_what_it_cannot_use(config, calibration, log):
    short = Log(log.q[:300], log.tau[:300], dt=DT)
    with pytest.raises(ValueError, match=r"the logs hold 3 s; at least 4 s of healthy motion are needed"):
        calibrate_on_logs(config, calibration.gains, [short])
    with pytest.raises(ValueError, match="logs must be at least one, got none"):
        calibrate_on_logs(config, calibration.gains, [])
    with pytest.raises(ValueError, match=r"false_alarms must lie in \(0, 1\)"):
        calibrate_on_logs(config, calibration.gains, [log], false_alarms=0)
    with pytest.raises(ValueError, match=r"log 2: statistic_tau is not finite at 8.* s"):
        calibrate_on_logs(config, calibration.gains, [log, overflowing(log)])


# Levels.


def test_enough_runs_are_counted_and_too_few_extrapolated():
    peaks = np.random.default_rng(5).gumbel(1.0, 0.05, (400, 3))
    counted = ReturnLevel(0.02, 0.95, 400, 1)
    fitted = ReturnLevel(0.02, 0.95, 400, 40)
    assert (counted.method, fitted.method) == ("sample", "tail")
    fresh = np.random.default_rng(6).gumbel(1.0, 0.05, (20000, 3))
    rates = [(fresh / (peaks.max(0) * level.factor(peaks)) > 1).any(1).mean() for level in (counted, fitted)]
    assert rates[0] <= 0.02 and rates[1] < 0.02 / 40


# Events.


def said_of(verdict, torque=0.0, angle=0.0):
    verdict = np.asarray(verdict, np.int32)
    zero = np.zeros(verdict.shape)
    values = {name: zero for name in Diagnosis._fields}
    return Diagnosis(**values | {"verdict": verdict, "fault_tau_hat": zero + torque, "fault_q_hat": zero + angle})


def line_of(*stretches):
    line, time = Timeline(("a", "b"), DT), 0.0
    for verdict in stretches:
        line.add(said_of(verdict, 5.0, 0.1), time)
        time += DT * len(verdict)
    return line, line.finish()


def ticks(*spans, joint=0, kind=1, length=600):
    verdict = np.zeros((length, 2), int)
    for start, stop in spans:
        verdict[start:stop, joint] = kind
    return verdict


def test_short_gaps_are_joined_and_glitches_counted_apart():
    line, found = line_of(ticks((100, 120), (150, 200), (300, 305), (400, 430)))
    assert [(e.start_s, e.end_s, e.joint, e.kind, e.size, e.unit) for e in found] == [
        (1.0, 2.0, 1, "actuator", 5.0, "N m"),
        (4.0, 4.3, 1, "actuator", 5.0, "N m"),
    ]
    assert line.glitches == 1 and line.alarm_share == pytest.approx(105 / 600)


def test_an_event_goes_on_from_stretch_to_stretch():
    whole = ticks((100, 120), (250, 350))
    found = line_of(*np.split(whole, [110, 300, 320]))[1]
    assert found == line_of(whole)[1] and len(found) == 2


def touched(*spans, length=600, force=20.0):
    """Contacts of both joints, the first of which alarms alone for ten ticks before."""
    verdict = np.zeros((length, 2), int)
    for start, stop in spans:
        verdict[start - 10 : start, 0] = 1
        verdict[start:stop] = 8
    return said_of(verdict)._replace(force=np.where(verdict == 8, [0.0, force], 0.0), fault_tau_hat=0.0 * verdict + 5.0)


def test_a_contact_is_one_event_of_its_link():
    said = touched((100, 150), (180, 220), (400, 405))
    line = Timeline(("a", "b"), DT)
    for start, stop in ((0, 130), (130, 600)):
        line.add(jax.tree.map(lambda leaf, k=slice(start, stop): leaf[k], said), DT * start)
    found = line.finish()
    assert [(e.start_s, e.end_s, e.joint, e.joint_name, e.kind, e.size, e.unit) for e in found] == [
        (0.9, 2.2, 2, "b", "contact", 20.0, "N"),
        (3.9, 4.05, 1, "a", "actuator", 5.0, "N m"),
    ]
    assert line.glitches == 2  # of joint 2, and the contact that was too short


def test_a_fault_in_which_a_contact_was_said_for_a_moment_is_a_fault():
    verdict = ticks((100, 300))
    verdict[150:180] = 8
    verdict[180:, 1] = 0
    line = Timeline(("a", "b"), DT)
    line.add(said_of(verdict, 5.0)._replace(force=1.0 * (verdict == 8)), 0.0)
    assert [(e.joint, e.kind) for e in line.finish()] == [(1, "actuator"), (2, "contact")]


def test_a_torque_that_changes_its_sign_is_not_small():
    torque = np.where(np.arange(600) % 2, 5.0, -4.0)[:, None]
    line = Timeline(("a", "b"), DT)
    line.add(said_of(ticks((100, 200)), torque), 0.0)
    assert line.finish()[0].size == pytest.approx(4.5)


def test_the_kind_is_what_was_said_most_of_the_time():
    verdict = ticks((100, 200), kind=2)
    verdict[100:110, 0] = 1
    assert [(e.kind, e.unit, round(e.size, 2)) for e in line_of(verdict)[1]] == [("sensor", "deg", 5.73)]
    assert line_of(ticks((100, 200), kind=3))[1][0].kind == "both"


def test_joints_have_their_own_events():
    found = line_of(ticks((100, 200)) + ticks((150, 250), joint=1, kind=2))[1]
    assert [(e.joint, e.joint_name, e.kind) for e in found] == [(1, "a", "actuator"), (2, "b", "sensor")]


# The commands.


@pytest.fixture(scope="module")
def files(tmp_path_factory, arm, config, calibration, log):
    folder = tmp_path_factory.mktemp("files")
    q, tau = log.q.copy(), log.tau.copy()
    bias(q, tau)
    table = np.column_stack([log.t, q, tau])
    head = ",".join(["t", *(f"q{j}" for j in (1, 2, 3)), *(f"tau{j}" for j in (1, 2, 3))])
    np.savetxt(folder / "log.csv", table, delimiter=",", header=head, comments="", fmt="%.12g")
    jaxftc.save_arm(folder / "arm.toml", jaxftc.Arm(arm))
    save_gains(folder / "gains.toml", calibration.gains, config)
    return folder


def test_diagnose_writes_the_timeline(files, capsys):
    out = files / "out"
    main(
        [
            "diagnose",
            str(files / "log.csv"),
            "--robot",
            str(files),
            "--gains",
            str(files / "gains.toml"),
            "--out",
            str(out),
            "--json",
        ]
    )
    said = json.loads(capsys.readouterr().out)
    assert {"sample_time_s", "duration_s", "alarm_share", "events"} <= said.keys() and said["sample_time_s"] == DT
    assert [(e["joint"], e["kind"]) for e in said["events"]] == [(2, "sensor")]
    assert shlex.split(said["provenance"]["command"])[:3] == ["jaxftc", "diagnose", str(files / "log.csv")]
    assert said["provenance"]["gains"]["file"] == str(files / "gains.toml") and said["provenance"]["robot"]["name"]
    assert set(said["events"][0]) == {"start_s", "end_s", "joint", "joint_name", "kind", "size", "unit"}
    with (out / "events.csv").open() as text:
        assert [row["joint_name"] for row in csv.DictReader(text)] == ["shoulder_joint"]
    import duckdb

    rows = duckdb.sql(f"select count(*), max(t), max(verdict_shoulder_joint) from '{out}/samples.parquet'").fetchall()[0]
    assert rows == (1600, pytest.approx(15.99), 2)
    page = (out / "report.html").read_text()
    assert "shoulder_joint" in page and "Residuals and events" in page and "What ran" in page


@pytest.mark.parametrize("change", [{"decision": "learned"}, {"adaptive": True}])
def test_what_only_a_controller_of_ours_does_is_refused(config, log, change):
    asked = dataclasses.replace(config, **change)
    gains = jaxftc.default_gains(asked)
    for use in (lambda: jaxftc.Diagnoser(asked, gains), lambda: logs.diagnose(asked, gains, log)):
        with pytest.raises(ValueError, match="the diagnoser names by the rule and learns nothing of the arm; give Config"):
            use()


def test_a_log_is_brought_to_the_sample_time_of_the_gains(files, arm, capsys):
    columns = small_logs.table(arm_file(arm), 8.0, 0.8 / DT, 4)
    columns |= {f"tau{j + 1}": columns[f"tau{j + 1}"] - offset for j, offset in enumerate(small_logs.OFFSET)}
    log = str(small_logs.write(files / "slower.csv", columns))
    given = ["diagnose", log, "--robot", str(files), "--gains", str(files / "gains.toml"), "--json", "--out"]
    main([*given, str(files / "brought")])
    said = json.loads(capsys.readouterr().out)
    assert said["sample_time_s"] == DT and not said["events"]
    with pytest.raises(SystemExit):  # a sample time that was asked for is not replaced
        main([*given, str(files / "refused"), "--dt=0.0125"])
    assert "holds gains for another dt" in capsys.readouterr().err


def test_columns_that_do_not_fit_are_said_and_not_refused(files, arm, log):
    """A fault may look like a wrong column: a frozen angle like a swapped one."""
    columns = {"t": log.t} | {f"q{j + 1}": log.q[:, j] for j in range(3)}
    columns |= {f"tau{j + 1}": sign * log.tau[:, j] for j, sign in enumerate((1, -1, 1))}
    path = small_logs.write(files / "odd.csv", columns)
    with pytest.raises(ValueError, match="takes the columns as they are"):
        logs.read(path, arm)
    assert any("unless that is the fault" in note for note in logs.read(path, arm, faulty=True).notes)


def as_logger(path, folder):
    """The same table as another logger writes it: a title, semicolons, decimal commas, a row of units, degrees."""
    head, *rows = (line.split(",") for line in path.read_text().splitlines())
    units = ["s"] + ["deg" if name.startswith("q") else "Nm" for name in head[1:]]
    turned = [
        [f"{np.rad2deg(float(x)):.9g}" if n.startswith("q") else x for n, x in zip(head, row, strict=True)] for row in rows
    ]
    lines = ["Prüfstand 3", *(";".join(cells).replace(".", ",") for cells in (head, units, *turned))]
    (folder / "logger.txt").write_text("\n".join(lines), encoding="latin-1")
    return folder / "logger.txt"


def as_parquet(path, folder):
    names, *rows = (line.split(",") for line in path.read_text().splitlines())
    tables.write_parquet(folder / "log.parquet", dict(zip(names, np.array(rows, float).T, strict=True)))
    return folder / "log.parquet"


@pytest.mark.parametrize("written", [lambda path, _: path, as_logger, as_parquet], ids=["csv", "logger", "parquet"])
def test_a_long_recording_is_read_piece_by_piece(files, arm, config, monkeypatch, tmp_path, written):
    """Pieces of one size, each with all repairs, are the whole."""
    path = written(files / "log.csv", tmp_path)
    whole = logs.read(path, arm)
    monkeypatch.setattr(pieces, "PIECE", 1500)  # the log has 1,600 rows; a rest of 100 would be no log
    found = list(pieces.pieces(path, arm, lambda dt: config))
    assert [len(log.q) for log, *_ in found] == pytest.approx([800, 800], abs=2)
    np.testing.assert_allclose(np.concatenate([log.q for log, *_ in found]), whole.q, atol=1e-7)
    np.testing.assert_allclose(np.concatenate([log.tau for log, *_ in found]), whole.tau, atol=1e-7)
    assert [begins for _, begins, _ in found] == pytest.approx([0.0, len(found[0][0].q) * DT])
    assert [goes_on for *_, goes_on in found] == [False, True]


@pytest.mark.parametrize("rate", [96.0, 100.0, 104.0], ids=lambda rate: f"{rate:g} Hz")
def test_pieces_of_a_log_at_another_rate_meet_at_even_times(arm, config, monkeypatch, tmp_path, rate):
    """Rows that come when they like give ticks ``dt`` apart, from one piece to the next as well."""
    table = small_logs.table(arm_file(arm), 16.0, rate, 5)
    stamps = table["t"] + np.random.default_rng(5).uniform(-0.2, 0.2, len(table["t"])) / rate
    path = small_logs.write(tmp_path / "log.csv", table | {"t": stamps - stamps[0]})
    whole = logs.read(path, config, check=False)
    monkeypatch.setattr(pieces, "PIECE", 500)
    found = list(pieces.pieces(path, config, lambda dt: config, check=False))
    assert len(found) > 2 and all(goes_on for *_, goes_on in found[1:])
    t = np.concatenate([begins + log.t - log.t[0] for log, begins, _ in found])
    np.testing.assert_allclose(np.diff(t), DT, rtol=0.02)
    np.testing.assert_allclose(np.concatenate([log.q for log, *_ in found]), whole.q[: len(t)], atol=5e-4)


def test_pieces_that_do_not_agree_are_refused_by_row(files, arm, config, monkeypatch, tmp_path):
    monkeypatch.setattr(pieces, "PIECE", 800)
    head, *rows = (files / "log.csv").read_text().splitlines()
    angles = [k for k, name in enumerate(head.split(",")) if name.startswith("q")]
    table = np.array([row.split(",") for row in rows], float)
    table[536:, angles] = np.rad2deg(table[536:, angles])  # a logger that was set to degrees in the second piece
    for name, change, said in (("degrees", table, "degrees and those before are not"), ("cut", table[:, :-1], "tau3")):
        np.savetxt(tmp_path / f"{name}.csv", change, delimiter=",", header=head if name != "cut" else head[:-5], comments="")
        with pytest.raises(ValueError, match=said) as told:
            list(pieces.pieces(tmp_path / f"{name}.csv", arm, lambda dt: config))
        assert str(told.value).startswith(str(tmp_path / f"{name}.csv"))


def test_calibrate_on_logs_writes_gains(files, tmp_path, capsys):
    options = ["--robot", str(files), "--false-alarms", "0.2", "--out", str(tmp_path / "out"), "--json"]
    main(["calibrate", "--logs", str(files / "log.csv"), *options])
    said = json.loads(capsys.readouterr().out)
    assert said["method"] == "tail" and said["sample_time_s"] == DT and (tmp_path / "out" / "gains.toml").exists()


def test_curves_stand_at_their_times_also_after_a_gap():
    even = np.arange(50) * 0.1
    assert (drawn := curve(even, even, "", {}, joint=0)).x is None and (drawn.x0, drawn.dx) == (0.0, pytest.approx(0.1))
    for rows in (50, 10000):
        gap = np.r_[0.1 * np.arange(rows), 0.1 * np.arange(rows) + 5000.0]
        drawn = curve(gap, gap, "", {}, joint=0)
        off = np.abs(np.asarray(drawn.x) - np.asarray(drawn.y))
        assert (off > 0.2 * rows / 1000).sum() <= 2, "thinned, all but those beside the gap within a stretch"


def test_a_curve_of_a_long_log_keeps_its_extremes_whatever_the_pieces():
    """The last piece is shorter than a block by then."""
    signal = np.random.default_rng(0).normal(size=(20 * POINTS + 3, 2))
    envelope = Envelope()
    for piece in (signal[: 9 * POINTS], signal[9 * POINTS : 20 * POINTS], signal[20 * POINTS :]):
        envelope.add(piece)
    assert len(envelope.low) <= POINTS and envelope.size > 3
    whole = signal[: len(envelope.low) * envelope.size]
    np.testing.assert_array_equal(np.min(envelope.low, axis=0), whole.min(0))
    np.testing.assert_array_equal(np.max(envelope.high, axis=0), whole.max(0))
