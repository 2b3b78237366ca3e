"""Figures of merit on traces whose answers are known."""

import numpy as np
import pytest

from jaxftc import metrics
from jaxftc.types import ACTUATOR, BOTH, NORMAL, SENSOR


def test_delay_counts_from_onset_and_ignores_what_was_before(config):
    verdict = np.zeros((300, 6), int)
    verdict[50:60, 0] = ACTUATOR  # a false alarm before onset is not a detection
    verdict[117:, 2] = ACTUATOR
    wanted = np.array([0, 0, ACTUATOR, 0, 0, 0])
    delay, isolated, scored = metrics.detection(config, verdict, wanted, 0.1)
    assert delay == pytest.approx(0.017) and isolated and scored.tolist() == wanted.tolist()


def test_verdict_is_scored_after_it_settled(config):
    verdict = np.zeros((300, 6), int)
    verdict[100:130, 2], verdict[130:, 2] = ACTUATOR, SENSOR
    wanted = np.array([0, 0, SENSOR, 0, 0, 0])
    assert metrics.detection(config, verdict, wanted, 0.1)[1]
    verdict[165, 0] = ACTUATOR  # later than the scored tick
    assert metrics.detection(config, verdict, wanted, 0.1)[1]
    verdict[160, 0] = ACTUATOR
    assert not metrics.detection(config, verdict, wanted, 0.1)[1]


def test_a_miss_is_infinite_and_a_healthy_run_is_right_without_alarm(config):
    quiet = np.zeros((300, 6), int)
    assert metrics.detection(config, quiet, np.full(6, ACTUATOR), 0.1)[:2] == (float("inf"), False)
    assert metrics.detection(config, quiet, np.full(6, NORMAL), 0.1)[:2] == (None, True)
    alarm = quiet.copy()
    alarm[3, 1] = SENSOR
    assert metrics.detection(config, alarm, np.full(6, NORMAL), 0.1)[:2] == (None, False)


def test_true_verdict():
    kinds = metrics.true_verdict(np.array([0, 1, 0, 2]), np.array([0, 0, 3, 1]))
    assert kinds.tolist() == [NORMAL, ACTUATOR, SENSOR, BOTH]


def test_chattering_of_a_square_wave():
    tau = np.zeros((1000, 2))
    tau[::2, 0] = 1.0
    assert metrics.chattering(tau, np.array([10.0, np.inf]), 1e-3) == pytest.approx(0.5 * 999 * 0.1 / 1.0)


def test_rms_adds_up_in_double_precision():
    assert metrics.rms(np.full(10_000_000, 1e-3, np.float32)) == pytest.approx(1e-3, rel=1e-6)
