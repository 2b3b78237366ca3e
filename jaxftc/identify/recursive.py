"""Recursive least squares with forgetting, in square-root information form: the read-out from a running robot.

The state is the triangle R and the right-hand side z of ``R w = z``. A tick rotates a new row in with p Givens rotations:
the information R^T R cannot lose its sign to rounding, as a covariance can. Forgetting raises the weight of new rows in
place of lowering R and z; once it reaches 2, all three are halved, which is exact. Scaling R and z by sqrt(forgetting)
tick by tick would round each entry its own way, and some thousand ticks at rest in float32 would scatter w.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxftc import checks
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.gains import check as check_gains
from jaxftc.identify.linear_model import span
from jaxftc.numerics.batch import trailing
from jaxftc.types import Array


class RlsState(NamedTuple):
    """What is known of kappa = origin + basis w; p unknowns a joint."""

    root: Array  # [n, p, p + 1, ...] upper triangle R, and z as last column
    weight: Array  # [n, ...] 1, weight of the next row, in [1, 2)
    floor: Array  # diagonal of R at the start; forgetting never takes it lower
    quiet: Array  # [p] a tick teaches where a row entry reaches this; rad for kappa_a, infinite for the rest
    origin: Array  # [n, features] read-out at the start, H_y(1) = 1
    basis: Array  # [features, p] directions that keep H_y(1) = 1


def rls_init(
    config: Config, gains: Gains, *, prior: float = 1e-3, quiet: float = 2e-4, scenarios: tuple[int, ...] = ()
) -> RlsState:
    """Start from the read-out of the gains, moved to H_y(1) = 1, in their precision.

    ``prior`` is the diagonal of R, in rad for kappa_a and input units for kappa_b: the start counts as much as one reading
    that shows each direction with that size. A joint learns while the differences between its angle's Laguerre functions
    reach ``quiet`` rad: at poles of 0.8 they are 37 dt times its speed, and six times an encoder's 3e-5 rad is 2e-4. A
    joint at rest shows noise alone, which would be learned in the motion's place. ``scenarios`` are trailing axes of phi, y.

    Raises:
        ValueError: a gain is not allowed, prior is not positive, or quiet is negative.
    """
    check_gains(config, gains)
    if not 0 <= quiet < np.inf:
        raise ValueError(
            f"quiet must be a finite number of rad, 0 or more, got {quiet}; 2e-4 suits an encoder's noise of 3e-5"
        )
    checks.positive("prior", prior, "regressor units, 1e-3 where nothing else is known")
    origin, basis = span(config, gains.arx)
    p, dtype = basis.shape[1], gains.arx.kappa_a.dtype
    root = prior * np.eye(p, p + 1)
    every = np.broadcast_to(root.reshape(1, p, p + 1, *(1,) * len(scenarios)), (config.n, p, p + 1, *scenarios))
    weight = np.ones((config.n, *scenarios))
    threshold = np.where(np.arange(p) < config.order_a - 1, quiet, np.inf)
    return RlsState(*(jnp.asarray(leaf, dtype) for leaf in (every, weight, prior, threshold, origin, basis)))


def rls_step(
    state: RlsState, phi: Array, y: Array, frozen: Array, forgetting: float | Array = 1.0
) -> tuple[RlsState, Array]:
    """One tick: kappa [n, features, ...] from phi [n, features, ...] (``features``) and the reading y [n, ...] rad. Pure.

    A joint keeps its state bit for bit while it is ``frozen`` [n, ...], because a fault is flagged, while it is at rest
    (``rls_init``), and where its reading is not finite. ``forgetting`` in [0.5, 1] is the weight of the past, 1 - 1/ticks
    of memory; with 1, a small prior and quiet = 0 the result is batch least squares. A joint forgets only what new
    readings replace: where R would fall below its start, it keeps the past.

    Raises:
        ValueError: phi has another number of features, or forgetting is not in [0.5, 1].
    """
    axes = y.ndim - 1
    if phi.shape[:2] != state.origin.shape:
        raise ValueError(f"phi must be {list(state.origin.shape)} with y's axes behind, got shape {phi.shape}")
    if not isinstance(forgetting, Tracer) and not 0.5 <= float(forgetting) <= 1:
        raise ValueError(f"forgetting must lie in [0.5, 1], got {forgetting}; 0.999 remembers about 1000 ticks")
    root, p = state.root, state.root.shape[1]
    phi, y = jnp.asarray(phi, root.dtype), jnp.asarray(y, root.dtype)
    origin = trailing(state.origin, 2, axes)
    row = jnp.concatenate([_onto(state.basis, phi), (y - (origin * phi).sum(1))[:, None]], axis=1)
    raised = state.weight / jnp.sqrt(jnp.asarray(forgetting, root.dtype))
    least = jnp.stack([root[:, i, i] for i in range(p)]).min(0)
    weight = jnp.where(least >= state.floor * raised, raised, state.weight)
    learns = (jnp.abs(row[:, :p]) >= trailing(state.quiet[None], 2, axes)).any(1)
    row, rows = weight[:, None] * row, []
    for i in range(p):
        rotated, row = _rotate(root[:, i], row, i)
        rows.append(rotated)
    still = frozen | ~jnp.isfinite(y) | ~learns
    scale = jnp.where(weight >= 2, 0.5, 1.0).astype(root.dtype)
    root = jnp.where(still[:, None, None], root, scale[:, None, None] * jnp.stack(rows, axis=1))
    weight = jnp.where(still, state.weight, scale * weight)
    return state._replace(root=root, weight=weight), origin + _onto(state.basis.T, _back_substitute(root))


def _onto(matrix: Array, x: Array) -> Array:
    """Matrix^T x over axis 1: [a, b] and [n, a, ...] to [n, b, ...]."""
    product = jnp.tensordot(matrix, x, axes=(0, 1), precision=jax.lax.Precision.HIGHEST)
    return jnp.moveaxis(product, 0, 1)


def _rotate(upper: Array, row: Array, i: int) -> tuple[Array, Array]:
    """Givens rotation of two rows [n, p + 1, ...] that makes row[:, i] zero and keeps upper[:, i] positive."""
    radius = jnp.sqrt(upper[:, i] ** 2 + row[:, i] ** 2)
    c, s = (upper[:, i] / radius)[:, None], (row[:, i] / radius)[:, None]
    return (c * upper + s * row).at[:, i].set(radius), (c * row - s * upper).at[:, i].set(0.0)


def _back_substitute(root: Array) -> Array:
    """W [n, p, ...] of R w = z."""
    p = root.shape[1]
    w: list[Array] = [root[:, i, p] for i in range(p)]
    for i in reversed(range(p)):
        for j in range(i + 1, p):
            w[i] = w[i] - root[:, i, j] * w[j]
        w[i] = w[i] / root[:, i, i]
    return jnp.stack(w, axis=1)
