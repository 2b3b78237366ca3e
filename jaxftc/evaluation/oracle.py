"""What an oracle could have said of a run: the ceiling of every share of right verdicts.

The oracle knows every true fault, and of the arm what healthy runs show: the threshold. A fault is visible to it from the
moment at which it is as large as its joint's threshold, or its reading is absent; then it is known for good. A verdict that
is wrong although all of its faults were visible is the scheme's fault. One that is wrong about a fault that never was
visible could only have been right by luck.

The ceiling holds for the thresholds that ran. It is not strict: a fault below the threshold can add to what the arm shows
anyway and raise an alarm, and the sensor check sees some faulty readings before they are far off.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.numerics import barrier
from jaxftc.simulation.closed_loop import Trace
from jaxftc.types import Array, Verdict


class Sight(NamedTuple):
    """What has been visible."""

    at: Array  # [...] s, first time that a fault was visible, infinite before
    early: Array  # [n, ...] int32, a Verdict's number: faults visible before the verdict was scored
    late: Array  # [n, ...] int32, before the settled verdict was scored


def init(like: Array) -> Sight:
    """Nothing seen; ``like`` [n, ...] gives the axes."""
    none = jnp.zeros(like.shape, jnp.int32)
    return Sight(jnp.full_like(like[0], jnp.inf), none, none)


def step(before: Sight, tick: Trace, wanted: Array, until: Array, until_late: Array) -> Sight:
    """One tick; both verdicts are scored at the times ``until`` and ``until_late`` [...] s, infinite without an alarm.

    ``wanted`` [n, ...] int32 is the verdict that is right: a contact that one joint shows is known of all that bear it.
    """
    tau = jnp.abs(tick.fault_tau) >= tick.out.threshold_tau
    q = (jnp.abs(tick.fault_q) >= tick.out.threshold_q) | ~jnp.isfinite(tick.y)
    pushed = (jnp.abs(tick.contact_tau) >= tick.out.threshold_tau).any(0)
    now = Verdict.ACTUATOR * tau.astype(jnp.int32) + Verdict.SENSOR * q.astype(jnp.int32)
    now = barrier.store(now | jnp.where(pushed, wanted & Verdict.CONTACT, 0))  # else all of it again in the loop over joints
    return Sight(
        at=jnp.minimum(before.at, jnp.where((now > 0).any(0), tick.t, jnp.inf)),
        early=jnp.where(tick.t <= until, before.early | now, before.early),
        late=jnp.where(tick.t <= until_late, before.late | now, before.late),
    )
