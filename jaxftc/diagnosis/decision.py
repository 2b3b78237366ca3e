"""Decision logic, Eqs. (17), (18), block 7: two alarms per joint, one verdict.

An alarm rises when |S| stays at its threshold for a few ticks (at once on the encoder channel, where a jump decides) and
ends below 0.7 of it. Slow encoder faults do not jump far enough, so the torque channel sees them first; a second look then
takes them for what they are:

* **kick**: the onset of a drift changes the reading's speed, which looks like a torque until the observer has settled, and
  then like nothing. A torque that is really there stays. A torque residual that falls to a third of its peak (or a
  statistic below the release level) within ``config.kick_ticks`` of the alarm was a kick;
* **freeze**: equal readings while the arm moved by more than a jump's worth since the last change, or no reading at all;
* **noise** or a steep drift: many jumps in a tenth of a second, to and fro or one way.

A reading found out in this way explains the torque residual of its joint, so the actuator bit of that joint is off; and the
acceleration it feigned is kept out of the other joints' residuals (``trusted``). Of several kicks at once only the largest
counts: the inertia matrix spreads it to the neighbours.

Limits: an actuator fault on the very joint of a slow encoder fault is hidden by it; a torque pulse shorter than
``kick_ticks`` changes the speed just as a drift does and is called one; encoders alone cannot tell them apart. Decisions are
comparisons: no gradient passes through a verdict (tune on the statistics instead).
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.observer.cascade import Doubt, Innovation
from jaxftc.types import Array

RELEASE = 0.7  # share of the threshold below which an alarm ends
KICK = 0.35  # share of its peak to which a kick has fallen
FROZEN_READINGS = 5
MANY_JUMPS = 8.0
KICK_MEMORY = 500  # ticks without an alarm after which a kick is forgotten
JUMP_MEMORY = 0.99  # forgetting of the jump count per tick, about 100 ticks


class State(NamedTuple):
    """Alarms, run lengths and what the second look remembers; all [n, ...], float so that they mix with the signals."""

    tau_on: Array  # 1 while the torque alarm is up
    tau_run: Array  # ticks in a row that speak against the torque alarm's present state
    q_on: Array  # 1 while the encoder alarm is up
    q_run: Array
    age: Array  # ticks since the torque alarm rose
    peak: Array  # N m, largest torque residual in this alarm
    kicked: Array  # 1 once an alarm was found to be a kick, until all has been quiet for KICK_MEMORY
    quiet: Array  # ticks since an alarm was up
    jumps: Array  # leaky count of jumps
    lean: Array  # the same, jumps down counted negative
    y: Array  # rad, last reading
    equal: Array  # readings in a row that did not change or did not come
    speed: Array  # rad/s, when the reading last changed
    doubt: Doubt  # what the second look holds of the readings


def init(q: Array) -> State:
    """No alarm."""
    zero = jnp.zeros_like(q)
    return State(*[zero] * 10, y=q, equal=zero, speed=zero, doubt=Doubt(zero, zero, zero, zero))


def trusted(state: State, psi: Array) -> Array:
    """Fault estimate psi [n, ...] rad/s^2 without the joints whose reading is held to be wrong."""
    return psi * (1 - state.doubt.suspect)


def step(
    config: Config, gains: Gains, state: State, s_tau: Array, s_q: Array, r_tau: Array, seen: Innovation, qd_hat: Array
) -> tuple[State, Array]:
    """Verdict [n, ...] int32 from the statistics [n, ...] N m and rad.

    The torque residual r_tau [n, ...] N m, the reading and qd_hat rad/s feed the second look.
    """
    s_tau, s_q, r_tau, seen, qd_hat = jax.lax.stop_gradient((s_tau, s_q, r_tau, seen, qd_hat))
    level = jax.lax.stop_gradient(gains.diagnosis)
    tau_on, tau_run = alarm(s_tau, level.alpha_tau, state.tau_on, state.tau_run, config.alarm_ticks, config.release_ticks)
    q_on, q_run = alarm(s_q, level.alpha_q, state.q_on, state.q_run, 1, config.release_ticks)

    alarmed = (state.tau_on > 0) | (tau_on > 0)
    age = jnp.where(alarmed, state.age + 1, 0.0)
    peak = jnp.where(alarmed, jnp.maximum(state.peak, jnp.abs(r_tau)), 0.0)
    fallen = (tau_on == 0) | (jnp.abs(r_tau) < KICK * peak)
    excess = peak / level.alpha_tau
    kick = (state.tau_on > 0) & (age < config.kick_ticks) & fallen & (excess >= excess.max(0))
    quiet = jnp.where((tau_on > 0) | (q_on > 0), 0.0, state.quiet + 1)
    kicked = jnp.where(kick, 1.0, jnp.where(quiet >= KICK_MEMORY, 0.0, state.kicked))

    jumps = JUMP_MEMORY * state.jumps + seen.jump.h_s
    lean = JUMP_MEMORY * state.lean + seen.jump.h_s * seen.jump.side
    unchanged = seen.missing | (seen.y == state.y)
    equal = jnp.where(unchanged, state.equal + 1, 0.0)
    speed = jnp.where(unchanged, state.speed, qd_hat)
    moved = equal * config.dt * jnp.abs(speed) > jax.lax.stop_gradient(gains.observer.jump)
    frozen = (equal >= FROZEN_READINGS) & (moved | seen.absent)

    many = jumps >= MANY_JUMPS
    noisy = many & (jnp.abs(lean) < 0.5 * jumps)  # a steep drift jumps one way
    suspect = frozen | many | (kicked > 0)
    sensor = (q_on > 0) | suspect
    actuator = (tau_on > 0) & ~suspect
    verdict = actuator.astype(jnp.int32) + 2 * sensor.astype(jnp.int32)  # Eq. (18)
    doubt = Doubt(*(flag.astype(s_tau.dtype) for flag in (suspect, kicked > 0, frozen, noisy)))
    return State(tau_on, tau_run, q_on, q_run, age, peak, kicked, quiet, jumps, lean, seen.y, equal, speed, doubt), verdict


def alarm(s: Array, alpha: Array, on: Array, run: Array, rise: int, fall: int) -> tuple[Array, Array]:
    """Two-level switch with persistence: (alarm, run length), Eq. (17) with |S|."""
    against = jnp.where(on > 0, jnp.abs(s) < RELEASE * alpha, jnp.abs(s) >= alpha)
    run = jnp.where(against, run + 1, 0.0)
    flips = run >= jnp.where(on > 0, fall, rise)
    return jnp.where(flips, 1 - on, on), jnp.where(flips, 0.0, run)
