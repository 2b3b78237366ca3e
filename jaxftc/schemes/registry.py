"""What runs on a robot, whatever the scheme: the paper's cascade, or a baseline that it is measured against.

What comes into ``init`` and ``step`` is checked and made whole here, so that no scheme needs to. ``jaxftc/variants.py``
has the table of schemes and what each must have.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import jax.numpy as jnp

from jaxftc import checks
from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.gains import Gains, align
from jaxftc.gains import check as check_gains
from jaxftc.numerics import smooth
from jaxftc.robot import dynamics, lanes, reach, rigid_body
from jaxftc.stages import Stages
from jaxftc.types import Array, Measurement, Output, Reference
from jaxftc.variants import SCHEMES


def scheme(config: Config) -> Any:
    """The module of a config's scheme."""
    return import_module(SCHEMES[config.scheme])


def init(config: Config, gains: Gains, q: Array) -> Any:
    """Controller state at rest in q [n, ...] rad, holding the arm against gravity.

    Raises:
        ValueError: q has the wrong shape or is not finite, or a gain is not allowed.
    """
    checks.joints_first("q", q, config.n)
    checks.finite("q", q, "give the arm's measured angles in rad")
    check_gains(config, gains)
    q = jnp.asarray(q, gains.arx.xi_a.dtype)
    return scheme(config).init(config, align(gains, q.ndim - 1), q)


def step(config: Config, gains: Gains, state: Any, reference: Reference, measurement: Measurement) -> tuple[Any, Output]:
    """One controller tick: pure, and differentiable in everything but the verdict.

    Raises:
        ValueError: a shape is wrong (shapes are known even under a trace; values are checked by ``init``), or the state is
            that of another scheme.
    """
    return tick(config, gains, state, reference, measurement, None)


def tick(
    config: Config, gains: Gains, state: Any, reference: Reference, measurement: Measurement, stages: Stages | None
) -> tuple[Any, Output]:
    """``step``, with the cascade's stages given as data in place of the config's observer and control."""
    chosen = scheme(config)
    if not isinstance(state, chosen.State):
        raise ValueError(
            f"state must come from init with the same config, scheme {config.scheme!r}, got {type(state).__module__}."
            f"{type(state).__name__}"
        )
    check_gains(config, gains)
    reference, measurement = _signals(config, state, reference, measurement)
    beside = {} if stages is None else {"stages": stages}
    return chosen.step(config, align(gains, state.q.ndim - 1), state, reference, measurement, **beside)


def holding_torque(config: Config, q: Array) -> Array:
    """Command [n, ...] N m that holds the nominal arm at rest in q [n, ...] rad, within the limits."""
    zero = jnp.zeros_like(q)
    tau = dynamics.nominal_torque(config.robot, rigid_body.pose(config.robot, q), zero, zero)
    return smooth.saturate(tau, lanes.trailing_constant(config.robot.torque_limit, q))


@box("Interface: what no arm can do is left out of the signals")
def _signals(config: Config, state: Any, reference: Reference, measurement: Measurement) -> tuple[Reference, Measurement]:
    """Signals as arrays of the right shape, what no arm can do left out of them: what every scheme sees.

    * A reading further from ``state.q`` than a turn, and than the joint can have turned since one was last used, or outside
      the joint's range, is absent, as one that is not finite. Nearer than a turn, it is the observer's to judge.
    * A torque is what the limits leave of it; one that is not finite is the last command.
    * A joint whose reference is not finite, or faster or further out than a joint can follow, is held where it is. What the
      limits would leave of such a reference is as little meant, and would move the arm.
    """
    at, robot = state.q, config.robot
    q, qd, qdd = map(jnp.asarray, reference)
    reading, tau = map(jnp.asarray, measurement)
    names = ["reference.q", "reference.qd", "reference.qdd", "measurement.q", "measurement.tau"]
    for name, signal in zip(names, (q, qd, qdd, reading, tau), strict=True):
        checks.joints_first(name, signal, config.n)
    checks.same_shape(["state.q", *names], [at, q, qd, qdd, reading, tau])
    middle, half = (lanes.trailing_constant(bound, at) for bound in reach.angles(robot))
    near = jnp.abs(reading - at) <= reach.TURN + reach.SPEED * config.dt * state.unread
    reading = jnp.where(near & (jnp.abs(reading - middle) <= half), reading, jnp.nan)
    limit = lanes.trailing_constant(robot.torque_limit, at)
    tau = smooth.saturate(jnp.where(jnp.isfinite(tau), tau, state.command.tau), limit)
    slow = (jnp.abs(qd) <= reach.SPEED) & (jnp.abs(qdd) <= reach.ACCELERATION)
    wanted = slow & (jnp.abs(q - middle) <= half)
    held = Reference(jnp.where(wanted, q, at), jnp.where(wanted, qd, 0.0), jnp.where(wanted, qdd, 0.0))
    return held, Measurement(reading, tau)
