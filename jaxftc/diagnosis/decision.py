"""Decision logic, Eqs. (17), (18), block 7: two alarms and a sensor check for each joint, one verdict.

A reading that the sensor check holds to be wrong explains the torque residual of its joint, so the actuator bit of that
joint is off. No gradient passes through a verdict: tune on the statistics instead.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.diagnosis import alarm, decision_memory, learned_decision, sensor_check
from jaxftc.diagnosis.statistics import Statistics
from jaxftc.gains import Gains
from jaxftc.observer.cascade import Estimate
from jaxftc.types import Array, SensorStatus


class State(NamedTuple):
    """Alarms and what the sensor check remembers."""

    alarm: alarm.State
    check: sensor_check.State
    learned: learned_decision.State | None = None


class Inputs(NamedTuple):
    """What a tick takes in."""

    statistics: Statistics
    threshold_tau: Array  # [n, ...] N m, of this tick
    residual_tau: Array  # [n, ...] N m
    estimate: Estimate
    qd_hat: Array  # [n, ...] rad/s
    qdd: Array  # [n, ...] rad/s^2, acceleration that the command of the last tick stands for, without faults
    residual_of_all: Array | None = None  # [n, ...] N m, torque residual whatever the reading; for the learned decision


class Decision(NamedTuple):
    """What is said of each joint."""

    verdict: Array  # [n, ...] int32, Eq. (18)
    sensors: SensorStatus
    unsure: Array  # [n, ...] 1 where the verdict is a guess


def init(config: Config, gains: Gains, q: Array) -> State:
    """No alarm."""
    learned = learned_decision.init(config, gains, q) if config.decision == "learned" else None
    return State(alarm.init(config, gains, q), sensor_check.init(config, gains, q), learned)


@box("Block 7: decision, Eqs. (17), (18)")
def step(config: Config, gains: Gains, state: State, inputs: Inputs) -> tuple[State, Decision]:
    """Verdict and sensor status of this tick."""
    level = inputs.threshold_tau
    alarms_next, alarms = alarm.step(config, gains, state.alarm, alarm.Inputs(inputs.statistics, level))
    checked = sensor_check.Inputs(alarms, level, inputs.residual_tau, inputs.estimate, inputs.qd_hat, inputs.qdd)
    check_next, sensors = sensor_check.step(config, gains, state.check, checked)
    suspect = sensors.suspect > 0
    said, learned = verdict(alarms.tau & ~suspect, alarms.q | suspect), None
    unsure = jnp.zeros_like(level)
    if state.learned is not None and inputs.residual_of_all is not None:
        shown = inputs.statistics, level, inputs.residual_of_all, inputs.estimate.e, inputs.estimate.absent
        asked = decision_memory.Inputs(*shown, alarms_next, check_next, sensors.suspect, said)
        learned, (said, unsure) = learned_decision.step(config, gains, state.learned, asked)
    return State(alarms_next, check_next, learned), Decision(said, sensors, unsure)


def verdict(actuator: Array, sensor: Array) -> Array:
    """[n, ...] int32 of two bits [n, ...] bool, Eq. (18)."""
    return actuator.astype(jnp.int32) + 2 * sensor.astype(jnp.int32)
