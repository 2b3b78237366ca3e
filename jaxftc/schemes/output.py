"""What a scheme says that has one estimate for each channel, or none: an ``Output`` with all else filled in."""

from __future__ import annotations

import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxftc.config import Config
from jaxftc.numerics import smooth
from jaxftc.robot import lanes
from jaxftc.types import Array, Output


def output(
    config: Config,
    tau: Array,
    q: Array,
    qd: Array,
    *,
    threshold_tau: ArrayLike = jnp.inf,
    threshold_q: ArrayLike = jnp.inf,
    fault_tau: Array | None = None,
    fault_q: Array | None = None,
    verdict: Array | None = None,
) -> Output:
    """The output of a scheme: its estimates are residuals and statistics at once, and zero where it has none.

    Args:
        config: The scheme's.
        tau: [n, ...] N m, command before the limits.
        q: [n, ...] rad, estimated angle.
        qd: [n, ...] rad/s, estimated speed.
        threshold_tau: [n, ...] N m, infinite for a scheme without that channel.
        threshold_q: [n, ...] rad, the same.
        fault_tau: [n, ...] N m, estimated actuator fault.
        fault_q: [n, ...] rad, estimated encoder fault.
        verdict: [n, ...] int32, a Verdict's number.
    """
    zero = jnp.zeros_like(q)
    fault_tau, fault_q = (zero if fault is None else fault for fault in (fault_tau, fault_q))
    verdict = jnp.zeros(q.shape, jnp.int32) if verdict is None else verdict
    return Output(
        tau=smooth.saturate(tau, lanes.trailing_constant(config.robot.torque_limit, q)),
        fault_tau_hat=fault_tau,
        fault_q_hat=fault_q,
        residual_tau=fault_tau,
        residual_q=fault_q,
        statistic_tau=fault_tau,
        statistic_q=fault_q,
        threshold_tau=jnp.broadcast_to(jnp.asarray(threshold_tau, q.dtype), q.shape),
        threshold_q=jnp.broadcast_to(jnp.asarray(threshold_q, q.dtype), q.shape),
        verdict=verdict,
        detected=(verdict > 0).any(0),
        suspect=zero,
        q_hat=q,
        qd_hat=qd,
        s=zero,
        alpha_online=jnp.ones_like(q),
        force=zero,
        unsure=zero,
    )
