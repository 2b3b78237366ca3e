"""The closed loop: plant, faults, encoder noise and ``step``, as one scan.

The wall: the controller gets the reference, the reading and its own last command. Nothing else of the scenario reaches it.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxftc import checks, controller, reference, smooth
from jaxftc.arm import chain, plant
from jaxftc.compile import jit
from jaxftc.config import Config
from jaxftc.faults import inject
from jaxftc.faults.kinds import Fault
from jaxftc.faults.scenario import Scenario
from jaxftc.gains import Gains
from jaxftc.gains import check as check_gains
from jaxftc.types import Array, Measurement, Output, trailing


class Trace(NamedTuple):
    """A simulated run, time first."""

    t: Array  # [T] s
    q: Array  # [T, n, ...] rad, true angle
    qd: Array  # [T, n, ...] rad/s, true speed
    y: Array  # [T, n, ...] rad, encoder reading
    q_ref: Array  # [T, n, ...] rad
    tau_applied: Array  # [T, n, ...] N m, torque that reached the arm
    fault_tau: Array  # [T, n, ...] N m, true actuator fault
    fault_q: Array  # [T, n, ...] rad, true encoder fault
    out: Output  # what the controller said, time first


class Loop(NamedTuple):
    """Carry of the closed loop."""

    q: Array  # [n, ...] rad
    qd: Array  # [n, ...] rad/s
    tau: Array  # [n, ...] N m, last command
    fault: inject.State
    controller: controller.State


def simulate(config: Config, gains: Gains, scenario: Scenario, key: Array) -> Trace:
    """Run one scenario, or several side by side on trailing axes, for ``config.duration``.

    Compiled with this library's options when called from Python, inlined under a caller's trace.

    Raises:
        ValueError: gains or scenario are of a wrong shape, not finite or outside their limits.
    """
    check(config, gains, scenario)
    return _simulate(config, gains, scenario, key)


def check(config: Config, gains: Gains, scenario: Scenario) -> None:
    """Refuse what cannot be simulated, before anything compiles."""
    check_gains(config, gains)
    if scenario.q_start.shape[1:] != scenario.id.shape:
        raise ValueError(
            f"scenario.q_start has shape {list(scenario.q_start.shape)}, scenario.id {list(scenario.id.shape)}; "
            "sampled scenarios have a leading axis, simulate takes one of them or trail(scenarios)"
        )
    for name in ("q_start", "q_goal"):
        checks.joints_first(f"scenario.{name}", getattr(scenario, name), config.n)
        checks.finite(f"scenario.{name}", getattr(scenario, name), "give angles in rad")
    for channel in ("fault_tau", "fault_q"):
        for name in ("kind", "magnitude", "onset"):
            leaf = getattr(getattr(scenario, channel), name)
            checks.joints_first(f"scenario.{channel}.{name}", leaf, config.n)
            checks.finite(f"scenario.{channel}.{name}", leaf, "a fault that is not there has kind 0 and magnitude 0")


def start(config: Config, gains: Gains, scenario: Scenario) -> Loop:
    """Everything at rest in q_start, the arm held against gravity."""
    dtype = gains.arx.xi_a.dtype
    q = jnp.asarray(scenario.q_start, dtype)
    rest = controller.init(config, gains, q)
    tau = smooth.saturate(rest.pending.tau, chain.trailing_constant(config.robot.torque_limit, q))
    return Loop(q, jnp.zeros_like(q), tau, inject.State(tau, q), rest)


def advance(config: Config, gains: Gains, scenario: Scenario, loop: Loop, t: Array, noise: Array) -> tuple[Loop, Trace]:
    """One tick of plant, faults and controller at t s; noise [n, ...] rad is the encoder's."""
    axes, robot = loop.q.ndim - 1, config.robot
    fault_tau, fault_q = _align(scenario.fault_tau, axes), _align(scenario.fault_q, axes)
    fault, y, angle_fault = inject.read(fault_q, loop.fault, t, loop.q, noise)
    desired = reference.cubic(trailing(scenario.q_start, 1, axes), trailing(scenario.q_goal, 1, axes), config.t_final, t)
    state, out = controller.step(config, gains, loop.controller, desired, Measurement(y, loop.tau))
    limit = chain.trailing_constant(robot.torque_limit, loop.q)
    constant = trailing(scenario.plant.torque_constant, 1, axes)
    fault, delivered = inject.deliver(fault_tau, fault, t, out.tau, limit)
    q, qd = plant.advance(robot, config.engine, scenario.plant, loop.q, loop.qd, constant * delivered, config.dt)
    trace = Trace(
        t=t,
        q=loop.q,
        qd=loop.qd,
        y=y,
        q_ref=desired.q,
        tau_applied=constant * delivered,
        fault_tau=delivered - out.tau,
        fault_q=angle_fault,
        out=out,
    )
    return Loop(q, qd, out.tau, fault, state), trace


def encoder_noise(config: Config, scenario: Scenario, key: Array, dtype: jnp.dtype) -> Array:
    """Noise [T, n, ...] rad, a function of the key and of each scenario's id alone."""

    def one(scenario_id: Array) -> Array:
        return jax.random.normal(jax.random.fold_in(key, scenario_id), (config.ticks, config.n), dtype)

    ids = scenario.id
    draws = jax.vmap(one)(ids.reshape(-1))
    return jnp.moveaxis(draws, 0, -1).reshape(*draws.shape[1:], *ids.shape) * scenario.noise.astype(dtype)


def _simulate(config: Config, gains: Gains, scenario: Scenario, key: Array) -> Trace:
    loop = start(config, gains, scenario)
    dtype = loop.q.dtype
    scenario = _cast(scenario, dtype)
    noise = encoder_noise(config, scenario, key, dtype)

    def body(carry: Loop, x: tuple[Array, Array]) -> tuple[Loop, Trace]:
        k, drawn = x
        return advance(config, gains, scenario, carry, k.astype(dtype) * config.dt, drawn)

    return jax.lax.scan(body, loop, (jnp.arange(config.ticks), noise))[1]


_simulate = jit(_simulate, static_argnums=0)


def _align(fault: Fault, axes: int) -> Fault:
    return Fault(*(trailing(leaf, 1, axes) for leaf in fault))


def _cast(scenario: Scenario, dtype: jnp.dtype) -> Scenario:
    """Floats of the scenario in the controller's precision; integers stay."""
    return jax.tree.map(lambda x: x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x, scenario)
