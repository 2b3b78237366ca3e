"""The closed loop: plant, faults, encoder noise and ``step``, as one scan.

The wall: the controller gets the reference, the reading and its own last command. Nothing else of the scenario reaches it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.ad_checkpoint import checkpoint_name
from jax.core import Tracer

from jaxftc import checks, stages
from jaxftc.compile.jit import jit
from jaxftc.compile.xla import Kind
from jaxftc.config import Config
from jaxftc.diagnosis import threshold
from jaxftc.gains import Gains
from jaxftc.gains import check as check_gains
from jaxftc.numerics.batch import trailing
from jaxftc.robot import dynamics, lanes
from jaxftc.scenarios import reference
from jaxftc.scenarios.faults import Actuator, Fault, Sensor, common
from jaxftc.scenarios.scenario import Scenario, trail
from jaxftc.schemes import registry
from jaxftc.simulation import contact, fault_injection, noise
from jaxftc.types import Array, Measurement, Output


class Trace(NamedTuple):
    """A simulated run, time first. Inside, scenarios are the last axis; ``simulate`` gives a set a leading one.

    Attributes:
        t: [T] s.
        q: [T, n, ...] rad, true angle.
        qd: [T, n, ...] rad/s, true speed.
        y: [T, n, ...] rad, encoder reading.
        q_ref: [T, n, ...] rad.
        tau_applied: [T, n, ...] N m, torque of the motors that reached the arm.
        fault_tau: [T, n, ...] N m, true actuator fault, at the motor (the plant's torque_constant
            comes after it).
        fault_q: [T, n, ...] rad, true encoder fault.
        contact_tau: [T, n, ...] N m, true torque of a contact on the joints, J^T F.
        out: What the controller said, time first.
    """

    t: Array
    q: Array
    qd: Array
    y: Array
    q_ref: Array
    tau_applied: Array
    fault_tau: Array
    fault_q: Array
    contact_tau: Array
    out: Output


class Loop(NamedTuple):
    """Carry of the closed loop."""

    q: Array  # [n, ...] rad
    qd: Array  # [n, ...] rad/s
    tau: Array  # [n, ...] N m, last command
    fault: fault_injection.State
    controller: Any  # the scheme's state


def simulate(config: Config, gains: Gains, scenario: Scenario, key: Array) -> Trace:
    """Run one scenario, or a set of them side by side, for ``config.duration``.

    Compiled with this library's options when called from Python, inlined under a caller's trace.

    Args:
        config: Robot, structure and timing.
        gains: One set for all scenarios. For a set of gains, ``jax.vmap`` this function over them.
        scenario: One, or a set with a leading axis, as ``sample_scenarios`` draws it.
        key: Of the encoder noise; a scenario's noise depends on it and the scenario's id.

    Returns:
        Trace of one run, time first; of a set, every leaf with a leading scenario axis.

    Raises:
        ValueError: gains or scenario are of a wrong shape, not finite or outside their limits, or the observer is unstable.
    """
    check(config, gains, scenario)
    checks.random_key("key", key)
    many = jnp.ndim(scenario.id) == 1
    trace = rollout(config, gains, _trail(scenario) if many else scenario, key)
    return lead(trace) if many else trace


def rollout(config: Config, gains: Gains, scenario: Scenario, key: Array) -> Trace:
    """``simulate`` without its checks, scenarios on trailing axes; gains may have the same axes behind their own."""
    return _PROGRAMS[program_kind(config.engine, one_arm=jnp.ndim(scenario.id) == 0)](
        stages.general(config), threshold.follows(gains.diagnosis), stages.as_data(config), gains, scenario, key
    )


def check(config: Config, gains: Gains, scenario: Scenario) -> None:
    """Refuse what cannot be simulated, before anything compiles: one scenario, or a set with a leading axis.

    Raises:
        ValueError: naming the leaf, what came and what is allowed.
    """
    check_gains(config, gains)
    registry.check_stable(config, gains)
    checks.instance("scenario", scenario, Scenario)
    scenario = jax.tree.map(jnp.asarray, scenario)
    axes = scenario.id.shape
    if len(axes) > 1:
        raise ValueError(f"scenario must be one, or a set with one leading axis, got ids of shape {list(axes)}")
    for path, leaf in jax.tree_util.tree_leaves_with_path(scenario):
        name = "scenario" + jax.tree_util.keystr(path)
        own = _OWN.get(name, () if name.startswith("scenario.contact") else (config.n,))
        if leaf.shape != axes + own:
            raise ValueError(f"{name} must have shape {list(axes + own)}, got {list(leaf.shape)}; ids are {list(axes)}")
        allowed, rule = _ALLOWED.get(name.rpartition(".")[2], (np.isfinite, "be finite"))
        if not isinstance(leaf, Tracer) and not allowed(np.asarray(leaf)).all():
            raise ValueError(f"{name} must {rule}, got {np.asarray(leaf).tolist()}")
    if scenario.uncommon is None:
        for fault, kinds in ((scenario.fault_tau, Actuator), (scenario.fault_q, Sensor)):
            largest = 0 if isinstance(fault.kind, Tracer) else np.asarray(fault.kind).max(initial=0)
            if largest > common(kinds):
                raise ValueError(
                    f"scenario.uncommon is None, which stands for common kinds of fault only, got {kinds(int(largest))!r}; "
                    "add faults with scenario.with_..., or say _replace(uncommon=()) with them"
                )


def _positive(x: np.ndarray) -> np.ndarray:
    return (x > 0) & np.isfinite(x)


_OWN = {  # shapes of leaves that are neither a number a joint nor one a contact
    **dict.fromkeys(("scenario.id", "scenario.noise", "scenario.resolution", "scenario.plant.payload"), ()),
    **dict.fromkeys(("scenario.contact.offset", "scenario.contact.axis"), (3,)),
}
_ALLOWED = {  # leaves that may be more or less than any finite number
    "clear": (lambda x: ~np.isnan(x), "be a number, infinite if the fault stays"),
    "period": (lambda x: x > 0, "be positive, infinite if the fault is not intermittent"),
    "duty": (lambda x: (x >= 0) & (x <= 1), "lie in [0, 1]"),
    "kind": (lambda x: (x >= 0) & (x <= max(max(Actuator), max(Sensor))) & (x == np.round(x)), "be an Actuator or a Sensor"),
    "noise": (lambda x: (x >= 0) & np.isfinite(x), "be finite and not negative"),
    "resolution": (lambda x: (x >= 0) & np.isfinite(x), "be finite and not negative"),
    "link": (lambda x: (x >= 0) & (x == np.round(x)), "be a link's number, from 1, or 0 for none"),
    "size": (lambda x: (x >= 0) & np.isfinite(x), "be finite and not negative"),
    "payload": (lambda x: (x >= 0) & np.isfinite(x), "be finite and not negative"),
    "mass": (_positive, "be positive and finite"),
    "armature": (_positive, "be positive and finite"),
}


def start(config: Config, gains: Gains, scenario: Scenario) -> Loop:
    """Everything at rest in q_start, the arm held against gravity."""
    dtype = gains.arx.xi_a.dtype
    q = jnp.asarray(scenario.q_start, dtype)
    tau = registry.holding_torque(config, q)
    fault = fault_injection.init(tau, q, q, uncommon=scenario.uncommon is not None)
    return Loop(q, jnp.zeros_like(q), tau, fault, registry.init(config, gains, q))


def advance(
    config: Config,
    gains: Gains,
    scenario: Scenario,
    loop: Loop,
    t: Array,
    reading_error: Array,
    on: stages.Stages | None = None,
) -> tuple[Loop, Trace]:
    """One tick of plant, faults and controller at t s; reading_error [n, ...] rad is the encoder's noise."""
    axes, robot = loop.q.ndim - 1, config.robot
    fault_tau, fault_q = _align(scenario.fault_tau, axes), _align(scenario.fault_q, axes)
    fault, y, angle_fault = fault_injection.read(fault_q, loop.fault, t, loop.q, reading_error, scenario.resolution)
    desired = reference.cubic(trailing(scenario.q_start, 1, axes), trailing(scenario.q_goal, 1, axes), config.t_final, t)
    state, out = registry.tick(config, gains, loop.controller, desired, Measurement(y, loop.tau), on)
    limit = lanes.trailing_constant(robot.torque_limit, loop.q)
    constant = trailing(scenario.plant.torque_constant, 1, axes)
    inertia = lanes.trailing_constant(robot.inertia_diagonal, loop.q)
    motion = fault_injection.Motion(loop.q, loop.qd, inertia, config.dt)
    fault, delivered = fault_injection.deliver(fault_tau, fault, t, out.tau, limit, motion)
    pushed = contact.torque(robot, scenario.contact, t, loop.q)
    tau = constant * delivered + pushed
    q, qd = dynamics.advance(robot, config.engine, scenario.plant, loop.q, loop.qd, tau, config.dt)
    trace = Trace(
        t=t,
        q=loop.q,
        qd=loop.qd,
        y=y,
        q_ref=desired.q,
        tau_applied=constant * delivered,
        fault_tau=delivered - out.tau,
        fault_q=angle_fault,
        contact_tau=pushed,
        out=out,
    )
    return Loop(q, qd, out.tau, fault, state), trace


def encoder_noise(config: Config, scenario: Scenario, key: Array) -> Array:
    """Noise [T, n, ...] rad of a whole run, as the loop draws it tick by tick."""
    stream = noise.streams(key, scenario.id)
    draws = jax.vmap(lambda k: noise.normal(stream, k, config.n))(jnp.arange(config.ticks))
    return draws * scenario.noise


def watch(
    config: Config,
    gains: Gains,
    scenario: Scenario,
    key: Array,
    seen: Any,
    look: Callable[[Any, Trace], tuple[Any, Any]],
    on: stages.Stages | None = None,
) -> tuple[Any, Any]:
    """Run the loop while ``look(seen, tick) -> (seen, kept)`` sees every tick; the last ``seen``, and all ``kept`` stacked.

    ``on`` says by data which stages of the cascade run: with it one program serves every observer and controller.
    ``tick`` is a ``Trace`` of one moment, [n, ...]. To be traced: this is what ``simulate`` and scores are made of.
    """
    loop = start(config, gains, scenario)
    dtype = loop.q.dtype
    scenario = _cast(scenario, dtype)
    stream = noise.streams(key, scenario.id)

    def body(carry: tuple[Loop, Any], k: Array) -> tuple[tuple[Loop, Any], Any]:
        loop, seen = carry
        drawn = checkpoint_name(scenario.noise * noise.normal(stream, k, config.n).astype(dtype), "noise")
        loop, tick = advance(config, gains, scenario, loop, k.astype(dtype) * config.dt, drawn, on)
        seen, kept = look(seen, tick)
        return (loop, seen), kept

    # A gradient keeps the carry of every tick and the noise, which is dear, and runs the rest of the tick again.
    body = jax.checkpoint(body, prevent_cse=False, policy=jax.checkpoint_policies.save_only_these_names("noise"))
    (_, seen), kept = jax.lax.scan(body, (loop, seen), jnp.arange(config.ticks))
    return seen, kept


@jax.jit
def lead(trace: Trace) -> Trace:
    """From one trailing scenario axis to a leading one: [N, T] and [N, T, n]."""
    count = trace.q.shape[-1]
    first = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), trace._replace(t=trace.out.detected))
    return first._replace(t=jnp.broadcast_to(trace.t, (count, *trace.t.shape)))


def run_loop(config: Config, on: stages.Stages | None, gains: Gains, scenario: Scenario, key: Array) -> Trace:
    """``simulate`` without its checks, to be traced; ``on`` says which stages of the cascade run."""
    return watch(config, gains, scenario, key, (), lambda seen, tick: (seen, tick), on)[1]


def _run(config: Config, follows: bool, on: stages.Stages | None, gains: Gains, scenario: Scenario, key: Array) -> Trace:
    """``run_loop`` of gains whose thresholds follow the motion, or are known not to."""
    return run_loop(config, on, gains if follows else threshold.known_constant(gains), scenario, key)


def program_kind(engine: str, *, one_arm: bool = False) -> Kind:
    """How a program of the closed loop is compiled."""
    return "mjx" if engine == "mjx" else "one arm" if one_arm else "batch"


def blank_trace() -> Trace:
    """The structure of a trace, without numbers."""
    out: Any = Output(*[0] * len(Output._fields))  # pyright: ignore[reportArgumentType]
    return Trace(*[0] * (len(Trace._fields) - 1), out=out)  # pyright: ignore[reportArgumentType]


_trail = jax.jit(trail)
_KINDS: tuple[Kind, ...] = ("batch", "one arm", "mjx")
_PROGRAMS: dict[Kind, Any] = {kind: jit(_run, kind=kind, static_argnums=(0, 1)) for kind in _KINDS}


def _align(fault: Fault, axes: int) -> Fault:
    return Fault(*(trailing(leaf, 1, axes) for leaf in fault))


def _cast(scenario: Scenario, dtype: jnp.dtype) -> Scenario:
    """Floats of the scenario in the controller's precision; integers stay."""
    return jax.tree.map(lambda x: x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x, scenario)
