"""What runs on a robot, whatever the scheme: the paper's cascade, or a baseline that it is measured against.

What comes into ``init`` and ``step`` is checked and made whole here, so that no scheme needs to. ``jaxftc/variants.py``
has the table of schemes and what each must have.
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax.tree_util import tree_leaves_with_path

from jaxftc import checks, variants
from jaxftc.compile.box import box
from jaxftc.config import Config
from jaxftc.gains import Gains, align
from jaxftc.gains import check as check_gains
from jaxftc.numerics import barrier, smooth
from jaxftc.observer import stability
from jaxftc.robot import dynamics, lanes, reach, rigid_body
from jaxftc.stages import Stages
from jaxftc.types import Array, Measurement, Output, Reference, Verdict

LARGEST = 1e12  # of any number in a state: a tick makes no larger one, and overflows float32 on none below


def scheme(config: Config) -> Any:
    """The module or object of a config's scheme."""
    return variants.load(config.scheme)


def init(config: Config, gains: Gains, q: Array) -> Any:
    """Controller state at rest in q [n, ...] rad, holding the arm against gravity.

    Args:
        config: Robot, structure and timing.
        gains: As ``default_gains`` or ``load_gains`` gives them.
        q: [n, ...] rad, the first reading.

    Returns:
        The state that the first ``step`` takes.

    Raises:
        ValueError: an argument is of another kind, q has the wrong shape or is not finite, a gain is not allowed, or the
            observer is unstable with them.
    """
    check_gains(config, gains)
    q = checks.filled(q)
    checks.joints_first("q", q, config.n)
    checks.finite("q", q, "give the arm's measured angles in rad")
    check_stable(config, gains)
    q = jnp.asarray(q, gains.arx.xi_a.dtype)
    return scheme(config).init(config, align(gains, q.ndim - 1), q)


def check_stable(config: Config, gains: Gains) -> None:
    """Refuse gains with which the cascade's error grows, where the scheme has the cascade.

    Raises:
        ValueError: with the spectral radius.
    """
    if getattr(scheme(config), "STAGED", False):
        stability.check(config, gains)


def step(config: Config, gains: Gains, state: Any, reference: Reference, measurement: Measurement) -> tuple[Any, Output]:
    """One controller tick: pure, and differentiable in everything but the verdict.

    An arm whose state is not finite, or beyond all that a tick makes, starts anew at its readings, and its verdict of this
    tick is ``Verdict.UNKNOWN`` for every joint.

    Args:
        config: Robot, structure and timing; static.
        gains: Of the observer, the decision and the controller.
        state: Of ``init`` or of the last tick.
        reference: Angle, speed and acceleration that are wanted now, [n, ...] each.
        measurement: The reading [n, ...] rad, nan where there is none, and the torque [n, ...] N m that the drives were
            last told.

    Returns:
        The next state, and what the controller commands and says, [n, ...] each.

    Raises:
        ValueError: an argument is of another kind or a shape is wrong (shapes are known even under a trace; values are
            checked by ``init``), or the state is that of another config.
    """
    check_gains(config, gains)
    _check_state(config, state)
    checks.instance("reference", reference, Reference)
    checks.instance("measurement", measurement, Measurement)
    reference, measurement = _arrays(config, state.q, reference, measurement)
    lost = _lost(state)
    anew = functools.partial(_anew, config, gains, lost, state, measurement.q)
    state = jax.lax.cond(lost.any(), anew, lambda: state)
    state, out = tick(config, gains, state, reference, measurement, None)
    return state, out._replace(
        verdict=jnp.where(lost, Verdict.UNKNOWN, out.verdict).astype(out.verdict.dtype),
        detected=out.detected | lost,
        unsure=jnp.where(lost, 1.0, out.unsure),
    )


def tick(
    config: Config, gains: Gains, state: Any, reference: Reference, measurement: Measurement, stages: Stages | None
) -> tuple[Any, Output]:
    """``step`` of a state that is its own, with the cascade's stages given as data in place of the config's.

    The closed loop runs this: no state comes to it from elsewhere, and a run that diverges is to be seen as one.
    """
    _check_state(config, state)
    check_gains(config, gains)
    reference, measurement = _possible(config, state, *_arrays(config, state.q, reference, measurement))
    beside = {} if stages is None else {"stages": stages}
    return scheme(config).step(config, align(gains, state.q.ndim - 1), state, reference, measurement, **beside)


def holding_torque(config: Config, q: Array) -> Array:
    """Command [n, ...] N m that holds the nominal arm at rest in q [n, ...] rad, within the limits."""
    zero = jnp.zeros_like(q)
    tau = dynamics.nominal_torque(config.robot, rigid_body.pose(config.robot, q), zero, zero)
    return smooth.saturate(tau, lanes.trailing_constant(config.robot.torque_limit, q))


def _check_state(config: Config, state: Any) -> None:
    if not isinstance(state, scheme(config).State):
        raise ValueError(
            f"state must come from init with the same config, scheme {config.scheme!r}, got {type(state).__module__}."
            f"{type(state).__name__}"
        )


def _check_shapes(fresh: Any, state: Any) -> None:
    """Refuse a state with other arrays than ``fresh``, one of this config."""
    ours, theirs = ({jax.tree_util.keystr(at): x.shape for at, x in tree_leaves_with_path(s)} for s in (fresh, state))
    for name in [*ours, *theirs]:
        if ours.get(name) != theirs.get(name):
            came, wanted = (f"of shape {list(s[name])}" if name in s else "absent" for s in (theirs, ours))
            raise ValueError(f"state{name} is {came}, here it must be {wanted}; take the state of init with the same config")


def _arrays(config: Config, at: Array, reference: Reference, measurement: Measurement) -> tuple[Reference, Measurement]:
    """Signals as arrays of the shape [n, ...] of ``at``; a torque that is not known, or masked, is NaN."""
    tau = jnp.full_like(at, jnp.nan) if measurement.tau is None else measurement.tau
    signals = [jnp.asarray(checks.filled(signal)) for signal in (*reference, measurement.q, tau)]
    names = ["reference.q", "reference.qd", "reference.qdd", "measurement.q", "measurement.tau"]
    for name, signal in zip(names, signals, strict=True):
        checks.joints_first(name, signal, config.n)
    checks.same_shape(["state.q", *names], [at, *signals])
    return Reference(*signals[:3]), Measurement(*signals[3:])


@box("Interface: what no arm can do is left out of the signals")
def _possible(config: Config, state: Any, reference: Reference, measurement: Measurement) -> tuple[Reference, Measurement]:
    """Signals without what no arm can do: what every scheme sees.

    * A reading further from ``state.q`` than a turn, and than the joint can have turned since one was last used, or outside
      the joint's range, is absent: infinite, so that an observer can count it. Nearer, it is the observer's to judge.
    * A torque is what the limits leave of it; one that is not finite is the last command.
    * A joint whose reference is not finite, or faster or further out than a joint can follow, is held where it is. What the
      limits would leave of such a reference is as little meant, and would move the arm.
    """
    at, (q, qd, qdd) = state.q, reference
    middle, half = (lanes.trailing_constant(bound, at) for bound in reach.angles(config.robot))
    near = jnp.abs(measurement.q - at) <= reach.TURN + reach.SPEED * config.dt * state.unread
    there = near & (jnp.abs(measurement.q - middle) <= half) if reach.limited(config.robot) else near
    side = jnp.where(measurement.q >= at, jnp.inf, jnp.where(measurement.q < at, -jnp.inf, jnp.nan))
    reading = jnp.where(there, measurement.q, side)
    limit = lanes.trailing_constant(config.robot.torque_limit, at)
    tau = smooth.saturate(jnp.where(jnp.isfinite(measurement.tau), measurement.tau, state.tau), limit)
    slow = (jnp.abs(qd) <= reach.REFERENCE_SPEED) & (jnp.abs(qdd) <= reach.REFERENCE_ACCELERATION)
    wanted = slow & (jnp.abs(q - middle) <= half)
    held = Reference(jnp.where(wanted, q, at), jnp.where(wanted, qd, 0.0), jnp.where(wanted, qdd, 0.0))
    return held, Measurement(reading, tau)


def _lost(state: Any) -> Array:
    """Where [...] a state holds a number that is not finite or that no tick makes.

    All numbers in one array: for a single arm each reduction costs more than what it reduces.
    """
    batch = state.q.shape[1:]
    numbers = barrier.store(jnp.concatenate([leaf.reshape(-1, *batch) for leaf in jax.tree.leaves(state)]))
    return ~(jnp.abs(numbers) <= LARGEST).all(0)


def _anew(config: Config, gains: Gains, lost: Array, state: Any, reading: Array) -> Any:
    """The state, at rest at the readings [n, ...] rad where it is lost; without one where it was last, or at zero."""
    middle, half = (lanes.trailing_constant(bound, reading) for bound in reach.angles(config.robot))
    q = lanes.trailing_constant(config.robot.q_zero, state.q)
    for angle in (state.q, reading):
        q = jnp.where(jnp.abs(angle - middle) <= half, angle, q)
    fresh = scheme(config).init(config, align(gains, q.ndim - 1), q)
    _check_shapes(fresh, state)
    return jax.tree.map(lambda new, old: jnp.where(lost, new, old), fresh, state)
