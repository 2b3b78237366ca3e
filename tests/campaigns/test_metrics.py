"""Figures of merit on traces whose answers are known."""

import numpy as np
import pytest

from jaxftc.evaluation import metrics
from jaxftc.types import LABELS, Verdict


def fault(start, stop, joint=2, ticks=300):
    """(wanted verdict [n], presence [T]) of an actuator fault."""
    tau = np.zeros((ticks, 6))
    tau[start:stop, joint] = 4.0
    return metrics.truth({"fault_tau": tau, "fault_q": 0 * tau, "contact_tau": 0 * tau})


def test_delay_counts_from_onset_and_earlier_alarms_are_false(config):
    verdict = np.zeros((300, 6), int)
    verdict[117:, 2] = Verdict.ACTUATOR
    found = metrics.detection(config, verdict, *fault(100, 300))
    assert found.delay_s == pytest.approx(0.017) and found.isolated and found.false_alarm_s is None
    verdict[50:60, 0] = Verdict.ACTUATOR
    found = metrics.detection(config, verdict, *fault(100, 300))
    assert found.delay_s == pytest.approx(0.017) and found.false_alarm_s == pytest.approx(0.050)


def test_verdict_is_scored_after_it_settled(config):
    verdict = np.zeros((300, 6), int)
    verdict[100:130, 2], verdict[130:, 2] = Verdict.SENSOR, Verdict.ACTUATOR
    assert metrics.detection(config, verdict, *fault(100, 300)).isolated
    verdict[165, 0] = Verdict.ACTUATOR  # later than the scored tick
    assert metrics.detection(config, verdict, *fault(100, 300)).isolated
    verdict[160, 0] = Verdict.ACTUATOR
    assert not metrics.detection(config, verdict, *fault(100, 300)).isolated


def test_an_alarm_that_outlasts_the_fault_is_false(config):
    verdict = np.zeros((300, 6), int)
    verdict[100:200, 2] = Verdict.ACTUATOR
    assert metrics.detection(config, verdict, *fault(100, 150)).false_alarm_s is None
    verdict[100:260, 2] = Verdict.ACTUATOR
    assert metrics.detection(config, verdict, *fault(100, 150)).false_alarm_s == pytest.approx(0.250)


def test_an_alarm_long_after_the_fault_finds_nothing(config):
    verdict = np.zeros((400, 6), int)
    verdict[300:310, 2] = Verdict.ACTUATOR
    found = metrics.detection(config, verdict, *fault(100, 150, ticks=400))
    assert found.delay_s == float("inf") and found.false_alarm_s == pytest.approx(0.300)


def test_a_miss_is_infinite_and_a_healthy_run_is_right_without_alarm(config):
    quiet, healthy = np.zeros((300, 6), int), fault(0, 0)
    assert metrics.detection(config, quiet, *fault(100, 200))[:2] == (float("inf"), False)
    assert metrics.detection(config, quiet, *healthy)[:3] == (None, True, None)
    alarm = quiet.copy()
    alarm[3, 1] = Verdict.SENSOR
    found = metrics.detection(config, alarm, *healthy)
    assert found[:2] == (None, False) and found.false_alarm_s == pytest.approx(0.003)


def test_a_force_is_borne_by_all_joints_before_the_last_that_it_turns():
    none, pushed = np.zeros((5, 4)), np.zeros((5, 4))
    pushed[2:, 0], pushed[2:, 2] = 3.0, 1.0
    wanted, present = metrics.truth({"fault_tau": none, "fault_q": none, "contact_tau": pushed})
    assert wanted.tolist() == [Verdict.CONTACT] * 3 + [0] and present.tolist() == [False] * 2 + [True] * 3


def test_truth_comes_from_what_was_really_there():
    tau, q = np.zeros((5, 4)), np.zeros((5, 4))
    tau[1, 1], tau[2, 3], q[3, 2], q[4, 3] = 1.0, -2.0, 0.1, 0.1
    wanted, present = metrics.truth({"fault_tau": tau, "fault_q": q, "contact_tau": 0 * tau})
    assert wanted.tolist() == [0, Verdict.ACTUATOR, Verdict.SENSOR, Verdict.BOTH]
    assert present.tolist() == [
        False,
        True,
        True,
        True,
        True,
    ]


def test_a_run_that_diverged_is_refused(config):
    names = ("q", "q_ref", "fault_tau", "fault_q", "contact_tau", "fault_tau_hat", "fault_q_hat", "tau")
    trace = {name: np.zeros((10, 2)) for name in names}
    trace |= {"verdict": np.zeros((10, 2), int)}
    metrics.evaluate(config, trace)
    trace["q"][7:, 1] = np.nan
    with pytest.raises(ValueError, match=r"diverged.*0.007 s.*smaller"):
        metrics.evaluate(config, trace)


def test_chattering_of_a_square_wave():
    tau = np.zeros((1000, 2))
    tau[::2, 0] = 1.0
    assert metrics.chattering(tau, np.array([10.0, np.inf]), 1e-3) == pytest.approx(0.5 * 999 * 0.1 / 1.0)


def test_rms_adds_up_in_double_precision():
    assert metrics.rms(np.full(10_000_000, 1e-3, np.float32)) == pytest.approx(1e-3, rel=1e-6)


def test_a_verdict_is_two_bits_with_a_name_for_files():
    assert Verdict.ACTUATOR | Verdict.SENSOR is Verdict.BOTH and Verdict(np.int32(2)) is Verdict.SENSOR
    assert tuple(Verdict(k).label for k in range(4)) == LABELS == ("normal", "actuator", "sensor", "both")
