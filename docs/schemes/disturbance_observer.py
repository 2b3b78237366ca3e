"""PD control with gravity compensation and a disturbance observer, which says which motor is at fault.

d' = c (qdd - M^-1 (tau + d - h)): Chen, Ballance, Gawthrop, O'Reilly, A nonlinear disturbance observer for robotic
manipulators, IEEE T-IE 47(4), 2000. With z = d - c qd no acceleration is needed.
"""

from typing import NamedTuple

import jax.numpy as jnp
import pd_gravity

import jaxftc
from jaxftc.diagnosis import alarm, decision
from jaxftc.diagnosis.statistics import Statistics
from jaxftc.gains import block, gain
from jaxftc.schemes.output import output
from jaxftc.types import Array

DIAGNOSES = True


@block
class GAINS(pd_gravity.GAINS):
    """Those of the PD law, and the observer's."""

    c: Array = gain("n", "N m s/rad", 30.0, low=0.0, doc="gain of the disturbance observer")


class State(NamedTuple):
    """What the next tick needs."""

    pd: pd_gravity.State
    z: Array  # [n, ...] N m
    alarm: alarm.State
    q, unread, tau = (property(lambda self, name=name: getattr(self.pd, name)) for name in ("q", "unread", "tau"))


def gains_used(config):
    """Names of the gains that this scheme reads."""
    return {*pd_gravity.gains_used(config), "own.c", "diagnosis.alpha_tau"}


def init(config, gains, q):
    """No disturbance, at rest in q [n, ...] rad."""
    return State(pd_gravity.init(config, gains, q), jnp.zeros_like(q), alarm.init(config, gains, q))


def step(config, gains, state, reference, measurement):
    """One tick: the disturbance of the last one is compensated, and judged."""
    c, qd = gains.own.c, state.pd.qd
    modelled = jaxftc.forward_dynamics(config.robot, state.q, qd, measurement.tau + state.z + c * qd, "chain")
    z = state.z - config.dt * c * modelled
    pd, said = pd_gravity.step(config, gains, state.pd, reference, measurement)
    fault, threshold = z + c * pd.qd, gains.diagnosis.alpha_tau
    own, alarms = alarm.step(config, gains, state.alarm, alarm.Inputs(Statistics(fault, jnp.zeros_like(fault)), threshold))
    tau, verdict = pd.tau - fault, decision.verdict(alarms.tau, alarms.q)
    said = output(config, tau, pd.q, pd.qd, fault_tau=fault, verdict=verdict, threshold_tau=threshold)
    return State(pd._replace(tau=tau), z, own), said
