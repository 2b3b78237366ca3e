"""The loop on a clock that stands still between ticks: deadlines, trips, the stop, the log; and the reaction beside it."""

import dataclasses
import json
import math
import time

import mujoco
import numpy as np
import pytest

import jaxftc
from benchmarks.arms import serial
from jaxftc import Verdict, realtime
from jaxftc.compile import native
from jaxftc.realtime.reaction import Phase, Reaction
from jaxftc.robot.model_file import compile_robot
from tests.backends import needs_c

START = np.array([0.3, -0.2])
STILL = np.zeros(2)
HOLD, RAMP = 0.2, 0.1  # s, of the stop


class Arm:
    """MuJoCo C as the robot: time goes by as the clock says, under the torque that was written last."""

    def __init__(self, robot, clock, q=START, dt=1e-3):
        self.model, self.data = robot.mj_model, mujoco.MjData(robot.mj_model)
        self.model.opt.timestep = self.dt = dt
        self.data.qpos[:] = q
        mujoco.mj_forward(self.model, self.data)
        self.clock, self.began, self.steps = clock, None, 0
        self.tau = self.data.qfrc_bias.copy()  # held by its brakes until the first command
        self.written, self.reads, self.noise = [], 0, np.random.default_rng(0)
        self.reading = lambda k, q: q
        self.taking = lambda k, tau: tau

    def _go_on(self):
        if self.began is None:
            return
        while self.steps < math.floor((self.clock.now() - self.began) / self.dt + 1e-6):
            self.data.qfrc_applied[:] = self.tau
            mujoco.mj_step(self.model, self.data)
            self.steps += 1

    def read(self):
        self._go_on()
        self.reads += 1
        noise = 3e-5 * self.noise.standard_normal(len(self.data.qpos))
        return self.reading(self.reads - 2, self.data.qpos + noise)  # the first is read before the loop starts

    def write(self, tau):
        if self.began is None:
            self.began = self.clock.now()
        self._go_on()
        self.tau = self.taking(len(self.written), tau)
        self.written.append((self.clock.now(), tau))


@pytest.fixture(scope="module")
def compiled():
    robot = compile_robot("two", serial(2))
    config = jaxftc.Config(robot, engine="chain")
    hold = jaxftc.Reference(START, STILL, STILL)
    stop = realtime.SafeStop(config, hold=HOLD, ramp=RAMP)
    return realtime.Loop(config, jaxftc.default_gains(config), None, lambda t: hold, stop=stop)


@pytest.fixture
def loop(compiled, monkeypatch):
    """The compiled loop with a robot and a clock of its own; what other tests have left is not searched for garbage."""
    monkeypatch.setattr("gc.collect", lambda: 0)
    stop = compiled.stop
    hold = jaxftc.Reference(START, STILL, STILL)
    compiled.clock = realtime.SimulatedClock()
    compiled.robot = Arm(compiled.config.robot, compiled.clock)
    compiled.reference, compiled.trips, compiled.reaction = lambda t: hold, realtime.Trips(), Reaction()
    compiled.on_tick, compiled.event_file = None, None
    yield compiled
    compiled.stop = stop


def events(loop, kind):
    return [event for event in loop.events if event["event"] == kind]


def slow(loop, at, seconds):
    """A driver that takes its time in reading ``at``."""

    def reading(k, q):
        if k in at:
            loop.clock.advance(seconds)
        return q

    loop.robot.reading = reading


def test_it_runs_on_time_and_ends_with_the_arm_held_and_then_let_go(loop):
    summary = loop.run(0.2)
    assert summary.ended.cause == "end" and summary.missed == 0 and summary.unread == 0
    assert summary.ticks == 200 + 300 + 1, "the run, holding, the ramp, and the zero"
    times, taus = map(np.array, zip(*loop.robot.written, strict=True))
    np.testing.assert_allclose(np.diff(times), 1e-3, atol=1e-9)
    gravity = jaxftc.inverse_dynamics(loop.config.robot, START, STILL, STILL)
    assert np.abs(gravity).max() > 1.0, "an arm that has to be held"
    np.testing.assert_allclose(taus[380], gravity, atol=0.05)
    np.testing.assert_allclose(taus[405], gravity, rtol=0.1, atol=0.1)  # the ramp has just begun
    np.testing.assert_array_equal(taus[-1], 0.0)
    text = str(summary)
    assert "ended by end: 0.2 s are over" in text and "deadlines missed: 0 (0 %)" in text


def test_it_commands_what_the_tick_does(loop):
    """The loop adds nothing to the tick's own numbers while all is well."""
    said = []
    loop.on_tick = lambda t, out: said.append((t, out))
    read, taken = [], []
    loop.robot.reading = lambda k, q: read.append(q) or q
    loop.robot.taking = lambda k, tau: taken.append(tau) or tau
    loop.run(0.05)
    state, tau = loop.tick.init(read[0]), np.full(2, np.nan)
    for k in range(50):
        state, out = loop.tick.step(state, loop.reference(0.0), jaxftc.Measurement(read[k + 1], tau))
        tau = out.tau
        np.testing.assert_array_equal(taken[k], out.tau)
        assert said[k][0] == pytest.approx(k * 1e-3)


def test_a_missed_deadline_is_caught_up_with_the_torque_that_was_held(loop):
    """Seven milliseconds away in the middle of a motion: no alarm, and back on the grid."""
    move = lambda t: jaxftc.Reference(START + 0.2 * t**2, np.full(2, 0.4 * t), np.full(2, 0.4))  # noqa: E731
    loop.reference, loop.trips = move, realtime.Trips(missed=8)
    slow(loop, {100}, 7.2e-3)
    verdicts, error = [], []
    loop.on_tick = lambda t, out: (verdicts.append(out.verdict), error.append(np.abs(out.q_hat - move(t).q).max()))
    summary = loop.run(0.3)
    assert (summary.ended.cause, summary.late, summary.skipped) == ("end", 1, 6)
    (streak,) = events(loop, "deadlines")
    assert streak["missed"] == 7 and streak["latest_s"] == pytest.approx(6.2e-3)
    assert summary.work.largest == pytest.approx(7.2e-3)
    assert not np.any(verdicts[: 300 - 6]), "what the loop knows of the gap is no fault of the arm"
    assert np.max(error[: 300 - 6]) < 0.02
    times = np.array([t for t, _ in loop.robot.written])
    assert times[101] == times[100] and times[102] - times[101] == pytest.approx(0.8e-3), "at once, then on the grid again"


def test_a_missed_reading_is_predicted(loop):
    gone = {50, 51, 80}
    loop.robot.reading = lambda k, q: np.array([np.nan, q[1]]) if k in gone else q
    summary = loop.run(0.2)
    assert summary.ended.cause == "end" and summary.unread == 3
    assert [e["without"] for e in events(loop, "reading")] == [[1], [], [1], []]
    assert not events(loop, "reaction")


def test_what_read_raises_is_a_missed_reading_and_its_reason_is_kept(loop):
    def reading(k, q):
        if k == 20:
            raise TimeoutError("bus")
        return None if k == 30 else q

    loop.robot.reading = reading
    assert loop.run(0.1).ended.cause == "end"
    first, _, second, _ = events(loop, "reading")
    assert first["without"] == [1, 2] and "TimeoutError" in first["why"] and second["without"] == [1, 2]


def test_the_torque_that_the_drives_made_is_told_to_the_tick(loop):
    """A motor that gives less than it was asked for, and says so, is no fault of the arm's model."""
    loop.robot.taking = lambda k, tau: tau - 3.0 * (k > 50)
    alarms = []
    loop.on_tick = lambda t, out: alarms.append(bool(out.detected))
    loop.run(0.15)
    assert any(alarms[:150])
    loop.robot = Arm(loop.config.robot, loop.clock)
    loop.robot.taking = lambda k, tau: tau - 3.0 * (k > 50)
    loop.robot.reading = lambda k, q: jaxftc.Measurement(q, loop.robot.tau)
    alarms.clear()
    loop.run(0.15)
    assert not any(alarms[:150])


def trips_at(loop, duration=1.0):
    """(summary, the trip's event); the arm comes to rest, is let go, and nothing that is written is not finite."""
    summary = loop.run(duration)
    (trip,) = events(loop, "trip")
    assert trip["cause"] == summary.ended.cause and trip["text"] == summary.ended.text
    taus = np.array([tau for _, tau in loop.robot.written])
    assert np.isfinite(taus).all()
    np.testing.assert_array_equal(taus[-1], 0.0)
    assert events(loop, "end")[0]["cause"] == summary.ended.cause
    return summary, trip


def test_deadlines_trip(loop):
    loop.trips = realtime.Trips(missed=5, window=0.1)
    slow(loop, range(100, 400), 1.3e-3)
    summary, trip = trips_at(loop)
    assert trip["cause"] == "deadlines" and trip["t"] == pytest.approx(0.105, abs=2e-3)
    assert summary.ended.text == "5 deadlines missed within 0.1 s"


def test_deadlines_that_are_missed_now_and_then_do_not(loop):
    loop.trips = realtime.Trips(missed=5, window=0.05)
    slow(loop, range(0, 400, 40), 1.3e-3)
    assert loop.run(0.4).ended.cause == "end"


def test_commands_that_the_robot_refuses_trip(loop):
    def taking(k, tau):
        if 50 <= k < 90:
            raise OSError("cable")
        return tau

    loop.robot.written, taken = [], []

    def write(tau, real=loop.robot.write):
        taken.append(tau)
        if 50 <= len(taken) < 90:
            raise OSError("cable")
        real(tau)

    loop.robot.write = write
    summary, trip = trips_at(loop)
    assert trip["cause"] == "deadlines" and summary.late == 40
    assert "cable" in events(loop, "write")[0]["why"]


def test_no_reading_trips(loop):
    loop.robot.reading = lambda k, q: np.array([q[0], np.inf]) if k >= 100 else q
    _, trip = trips_at(loop)
    assert trip["cause"] == "data" and "joint2 for 0.05 s" in trip["text"] and trip["t"] == pytest.approx(0.149, abs=2e-3)


def test_a_command_that_is_not_finite_is_never_written(loop, monkeypatch):
    good, count = loop.tick.step, iter(range(10**6))

    def step(*args):
        state, out = good(*args)
        return state, out._replace(tau=out.tau * np.nan, q_hat=out.q_hat * np.nan) if next(count) >= 100 else out

    monkeypatch.setattr(loop.tick, "step", step)
    _, trip = trips_at(loop)
    assert trip["cause"] == "data" and "torque is not finite" in trip["text"]
    assert np.abs(loop.robot.data.qvel).max() < 5.0


def test_torque_at_its_limit_trips(loop):
    """A joint that is blocked: the controller pushes."""
    loop.reference = lambda t: jaxftc.Reference(START + 3.0 * (t > 0.1), STILL, STILL)
    loop.robot.reading = lambda k, q: START
    loop.robot.taking = lambda k, tau: np.zeros(2)
    loop.trips = realtime.Trips(saturated=0.05)
    _, trip = trips_at(loop)
    assert trip["cause"] == "torque" and "for 0.05 s" in trip["text"]


def test_a_confirmed_verdict_trips_if_the_user_chose_it(loop):
    biased = lambda k, q: q + np.array([0.0, 0.05 * (100 <= k < 300)])  # noqa: E731
    loop.robot.reading = biased
    loop.trips = realtime.Trips(verdicts=(Verdict.SENSOR, Verdict.BOTH))
    _, trip = trips_at(loop)
    assert trip["cause"] == "verdict" and trip["text"] == "sensor fault of joint2"
    assert trip["t"] == pytest.approx(0.1 + loop.reaction.confirm, abs=3e-3)
    loop.robot, loop.trips = Arm(loop.config.robot, loop.clock), realtime.Trips(verdicts=(Verdict.ACTUATOR,))
    loop.robot.reading = biased
    loop.reaction = Reaction(confirm=0.02, latch=0.1, clear=0.05, heal=0.1)
    assert loop.run(1.0).ended.cause == "end"
    phases = [(e["joint"], e["phase"], e["verdict"]) for e in events(loop, "reaction") if e["t"] < 1.0]
    assert phases == [
        (2, "suspected", "sensor"),
        (2, "confirmed", "sensor"),
        (2, "healing", "sensor"),
        (2, "healthy", "normal"),
    ]


def test_what_the_user_gave_trips_when_it_raises(loop):
    def reference(t):
        if t > 0.1:
            raise KeyError("plan")
        return jaxftc.Reference(START, STILL, STILL)

    loop.reference = reference
    _, trip = trips_at(loop)
    assert trip["cause"] == "error" and "plan" in trip["text"]
    loop.robot, loop.reference = Arm(loop.config.robot, loop.clock), lambda t: jaxftc.Reference(STILL[:1], STILL, STILL)
    _, trip = trips_at(loop)
    assert "must give arrays [2], got [[1], [2], [2]]" in trip["text"]


def test_it_stops_when_it_is_asked_to(loop):
    loop.on_tick = lambda t, out: loop.request_stop("enough") if t > 0.1 else None
    _, trip = trips_at(loop)
    assert (trip["cause"], trip["text"]) == ("asked", "enough") and trip["t"] == pytest.approx(0.102, abs=2e-3)

    def interrupted(k, q):
        if k == 50:
            raise KeyboardInterrupt
        return q

    loop.robot, loop.on_tick = Arm(loop.config.robot, loop.clock), None
    loop.robot.reading = interrupted
    _, trip = trips_at(loop)
    assert "keyboard" in trip["text"]


def test_the_stop_brakes_a_moving_arm(loop):
    speed = np.array([1.0, -1.0])
    loop.reference = lambda t: jaxftc.Reference(START + speed * (t - 0.1 * (1 - np.exp(-t / 0.1))), speed * (1 - np.exp(-t / 0.1)), speed * np.exp(-t / 0.1) / 0.1)  # noqa: E501  # fmt: skip
    speeds = []
    loop.on_tick = lambda t, out: speeds.append(loop.robot.data.qvel.copy())
    loop.run(0.5)
    assert np.abs(speeds[499]).min() > 0.9
    np.testing.assert_array_less(np.abs(speeds[500 + 195]), 0.2)


def test_a_stop_of_ones_own(loop):
    loop.stop = lambda since, out: (np.array([7.0, 1e6]), since > 0.0495)
    loop.run(0.1)
    limit = loop.config.robot.torque_limit[1]
    assert [tau.tolist() for _, tau in loop.robot.written[-51:]] == [[7.0, limit]] * 51
    for bad in (lambda since, out: 1 / 0, lambda since, out: (np.full(2, np.nan), False)):
        loop.robot, loop.stop = Arm(loop.config.robot, loop.clock), bad
        loop.run(0.1)
        assert len(events(loop, "stop failed")) == 1
        np.testing.assert_array_equal(loop.robot.written[-1][1], 0.0)  # the built-in one took over


def test_every_change_is_a_line_of_the_event_log(loop, tmp_path):
    loop.event_file = tmp_path / "events.jsonl"
    loop.robot.reading = lambda k, q: q * np.nan if k == 20 else q
    loop.run(0.05)
    loop.robot = Arm(loop.config.robot, loop.clock)
    loop.run(0.05)
    lines = [json.loads(line) for line in loop.event_file.read_text().splitlines()]
    assert [line["event"] for line in lines] == ["start", "reading", "reading", "trip", "end", "start", "trip", "end"]
    assert lines[0]["robot"] == "two" and lines[1]["t"] == pytest.approx(0.02)
    assert lines[5:] == loop.events


def test_a_full_disk_does_not_stop_the_loop(loop):
    loop.event_file = "/dev/full"
    summary = loop.run(0.05)
    assert summary.ended.cause == "end" and summary.lost == 3 and "could not be written: 3" in str(summary)


def test_what_cannot_be_run_is_refused_before_it_starts(loop, tmp_path):
    with pytest.raises(ValueError, match=r"duration.*positive.*math\.inf"):
        loop.run(0.0)
    loop.robot.reading = lambda k, q: q * np.nan
    with pytest.raises(ValueError, match="q must be finite"):
        loop.run(0.1)
    loop.robot.reading = lambda k, q: q[:1]
    with pytest.raises(ValueError, match=r"read must give angles \[2\], got shape \[1\]"):
        loop.run(0.1)
    loop.robot.reading, loop.event_file = lambda k, q: q, tmp_path / "none" / "events.jsonl"
    with pytest.raises(ValueError, match="cannot write events"):
        loop.run(0.1)
    for wrong in ({"missed": 0}, {"window": 0.0}, {"no_reading": -1.0}, {"verdicts": (Verdict.NORMAL,)}):
        with pytest.raises(ValueError, match=f"trips.{next(iter(wrong))}"):
            realtime.Trips(**wrong)
    with pytest.raises(ValueError, match=r"reaction\.clear must be a number of seconds"):
        Reaction(clear=math.nan)
    with pytest.raises(ValueError, match=r"brake must be at least 5 ticks of 0\.001 s"):
        realtime.SafeStop(loop.config, brake=0.001)


@needs_c
def test_the_tick_may_be_c_code(loop):
    """The same commands, but for rounding; another backend is refused."""
    written = []
    config, hold = loop.config, loop.reference
    gains = jaxftc.default_gains(config)
    for backend in ("xla", "c"):
        clock = realtime.SimulatedClock()
        own = realtime.Loop(config, gains, Arm(config.robot, clock), hold, clock=clock, stop=loop.stop, backend=backend)
        own.run(0.05)
        written.append(np.array([tau for _, tau in own.robot.written]))
    np.testing.assert_allclose(written[1], written[0], rtol=1e-6, atol=1e-6)
    with pytest.raises(ValueError, match="backend must be one of 'xla', 'c', got 'cuda'"):
        realtime.Loop(config, gains, None, hold, backend="cuda")


DT = 0.01
TIMES = Reaction(confirm=0.03, latch=0.1, clear=0.05, heal=0.2)


def react(machine, verdicts, dt=DT):
    """Phase and confirmed verdict of one joint after every tick."""
    state, found = machine.init(1), []
    for verdict in verdicts:
        state, _ = machine.step(state, np.array([verdict]), dt)
        found.append((Phase(state.phase[0]), int(state.verdict[0])))
    return found


def first(found, phase):
    return next(k for k, (where, _) in enumerate(found) if where == phase)


def test_a_verdict_has_to_last():
    assert react(TIMES, [1, 1, 1, 0])[-1] == (Phase.HEALTHY, 0)
    assert react(TIMES, [1, 1, 1, 1]) == [(Phase.SUSPECTED, 0)] * 3 + [(Phase.CONFIRMED, 1)]
    assert react(TIMES, [1, 1, 2, 2, 2])[-1] == (Phase.SUSPECTED, 0), "another verdict begins anew"


def test_a_confirmed_fault_is_kept_cleared_and_healed():
    found = react(TIMES, [1] * 4 + [0] * 40)
    confirmed, healing, healthy = (first(found[3:], phase) + 3 for phase in (2, 3, 0))
    assert (confirmed, healing, healthy) == (3, 13, 33)  # latch 10 ticks, longer than clear; heal 20
    assert found[20] == (Phase.HEALING, 1)
    long = react(TIMES, [1] * 30 + [0] * 40)
    assert first(long, Phase.HEALING) == 35  # the latch is over; clear counts from the first tick without


def test_a_verdict_that_flickers_is_not_cleared():
    assert react(TIMES, [1] * 4 + [0, 0, 0, 0, 1] * 20)[-1] == (Phase.CONFIRMED, 1)


def test_a_verdict_while_healing_is_confirmed_at_once():
    found = react(TIMES, [1] * 4 + [0] * 12 + [2])
    assert found[-2] == (Phase.HEALING, 1) and found[-1] == (Phase.CONFIRMED, 2)


def test_another_verdict_takes_the_place_of_the_first_when_it_has_lasted():
    found = react(TIMES, [1] * 10 + [2] * 10)
    assert found[12] == (Phase.CONFIRMED, 1) and found[13] == (Phase.CONFIRMED, 2)


def test_a_latch_without_end_needs_a_person():
    machine = dataclasses.replace(TIMES, latch=math.inf)
    assert react(machine, [1] * 4 + [0] * 1000)[-1] == (Phase.CONFIRMED, 1)
    state, _ = machine.step(machine.init(1), np.array([1]), DT)
    assert Phase(machine.reset(state).phase[0]) == Phase.HEALTHY


def test_times_are_seconds_whatever_the_tick():
    slow, quick = react(TIMES, [1] * 4 + [0] * 40), react(TIMES, [1] * 31 + [0] * 400, dt=1e-3)
    for phase in Phase:
        if phase:
            assert first(quick, phase) * 1e-3 == pytest.approx(first(slow, phase) * DT, abs=1.1e-3 + DT * (phase == 3))


def test_joints_are_apart_and_changes_are_told():
    state, changes = TIMES.step(TIMES.init(3), np.array([0, 1, 0]), DT)
    assert [tuple(c) for c in changes] == [(2, Phase.SUSPECTED, Verdict.ACTUATOR)]
    state, changes = TIMES.step(state, np.array([2, 1, 0]), DT)
    assert [tuple(c) for c in changes] == [(1, Phase.SUSPECTED, Verdict.SENSOR)]


ONSET, LENGTH = 6.0, 7.6  # s, of what trips, and of a run that nothing trips; with their stops a minute in all
POSE = np.deg2rad([30.0, 90.0, 30.0, 120.0, 50.0, 180.0])


def sweep(t):
    """A slow motion of every joint of the PUMA 560, from rest."""
    rate = 2 * np.pi * 0.2
    moves = 0.3 * (1 - np.cos(rate * t)), 0.3 * rate * np.sin(rate * t), 0.3 * rate**2 * np.cos(rate * t)
    return jaxftc.Reference(POSE + moves[0], *(np.full(6, x) for x in moves[1:]))


def provoke(cause, loop, arm):
    """Have a loop trip by a cause, in a way that a robot or a user would."""
    late = lambda: arm.began is not None and arm.clock.now() - arm.began > ONSET  # noqa: E731
    if cause == "deadlines":
        loop.trips = realtime.Trips()
        arm.reading = lambda k, q: time.sleep(3e-3 * late()) or q
    elif cause == "data":
        arm.reading = lambda k, q: np.where(np.arange(6) == 2, np.nan, q) if late() else q
    elif cause == "torque":  # joints that are blocked, and pushed
        loop.reference = lambda t: sweep(0.0)._replace(q=POSE + 2.0 * (t > ONSET))
        arm.taking = lambda k, tau: arm.data.qfrc_bias.copy()
    elif cause == "verdict":
        loop.trips = realtime.Trips(missed=math.inf, verdicts=(Verdict.SENSOR, Verdict.BOTH))
        last, settled, shifted = arm.clock.now(), 0.0, False

        def reading(k, q):
            """With a shift of the second encoder, which in a gap, or as long after one, would pass for motion."""
            nonlocal last, settled, shifted
            now = arm.clock.now()
            if now - last > 1.5e-3:
                settled = now + (now - last)
            last, shifted = now, shifted or bool(late() and now > settled)
            return q + np.deg2rad(1.5) * shifted * np.eye(6)[1]  # the threshold is 1 deg

        arm.reading = reading
    elif cause == "error":
        loop.reference = lambda t: sweep(t) if t < ONSET else None
    elif cause == "asked":
        loop.on_tick = lambda t, out: loop.request_stop() if t > ONSET else None


@pytest.fixture(scope="module")
def on_time():
    """A loop of the PUMA 560 on the computer's clock; where there is a C compiler it leaves the most time to the rest."""
    config = jaxftc.Config(jaxftc.puma560(coulomb=False), engine="chain")
    backend = "c" if native.compiler() else "xla"
    stop = realtime.SafeStop(config, hold=0.5, ramp=0.5)
    return realtime.Loop(config, jaxftc.default_gains(config), None, sweep, stop=stop, backend=backend)


@pytest.mark.slow
@pytest.mark.parametrize("cause", ["deadlines", "data", "torque", "verdict", "error", "asked", "end"])
def test_a_minute_at_1_khz_against_mujoco(cause, on_time, tmp_path, capsys):
    """Every trip once, whatever else the computer does: it may miss deadlines, but not lose count of them or of the arm."""
    loop, safe, speeds, errors = on_time, on_time.stop, [], []
    arm = loop.robot = Arm(loop.config.robot, realtime.SystemClock(), POSE, dt=0.25e-3)
    loop.clock, loop.reference, loop.trips, loop.event_file = (
        arm.clock,
        sweep,
        realtime.Trips(missed=math.inf),
        tmp_path / "log",
    )
    loop.on_tick = lambda t, out: errors.append(np.abs(arm.data.qpos - sweep(t).q).max()) if 1 < t < ONSET else None

    def stop(since, out):
        speeds.append((since, np.abs(arm.data.qvel).max()))
        return safe(since, out)

    loop.stop = stop
    provoke(cause, loop, arm)
    try:
        summary = loop.run(LENGTH)
    finally:
        loop.stop = safe
    with capsys.disabled():
        error = f"tracking error p50 {np.rad2deg(np.median(errors)):.3f} deg" if errors else ""
        print(f"\n{summary}\n{error}")

    found = [json.loads(line) for line in loop.event_file.read_text().splitlines()]
    (trip,) = [event for event in found if event["event"] == "trip"]
    assert trip["cause"] == summary.ended.cause == cause
    if summary.missed < realtime.Trips().missed:  # with more the loop stops by default, since a gap may look like a fault
        assert cause != "verdict" or (trip["text"] == "sensor fault of joint2" and ONSET < trip["t"] < ONSET + 0.1)
    last = summary.ticks + summary.skipped - 1  # number of the last tick
    assert last * 1e-3 <= summary.duration and last * 1e-3 >= trip["t"] + safe.hold + safe.ramp - 1e-3
    assert arm.reads == summary.ticks + 1 and len(arm.written) == summary.ticks == summary.work.count
    assert sum(event["missed"] for event in found if event["event"] == "deadlines") == summary.missed
    assert np.isfinite([tau for _, tau in arm.written]).all() and not np.any(arm.written[-1][1])
    assert max(speed for since, speed in speeds if 0.8 * safe.hold < since <= safe.hold) < 0.1, "braked and held"
