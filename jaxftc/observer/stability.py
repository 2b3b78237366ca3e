"""Is the observer stable? The spectral radius of its linear part, joint by joint.

The paper's Lyapunov argument, Eqs. (11), (12), uses a function that is not positive definite and a proof that needs relative
degree one, so it shows nothing here. What can be checked is the matrix that takes model and integrator from tick to tick,

    e = y - kappa x,   x+ = A x + b_y (kappa x + alpha_p e) + b_v psi,   psi+ = psi + alpha_i e,

without the fuzzy stage and with it fully on. For poles xi and the exact model the PI part is stable for
alpha_i < alpha_p^2 (1 - xi)^2 (1 - xi^2) / T^2 (found and checked numerically, not derived). The super-twisting stage is not
linear; simulation covers it.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxftc.config import Config
from jaxftc.gains import Gains, Spec, align, specs
from jaxftc.stages import Flag
from jaxftc.types import Array

MARGINAL = 1e-6  # rounding of gains in float32
SQUARINGS = 16  # of the matrix: the norm of its 65536th power is radius^65536 within a factor that the root takes to 1


def spectral_radius(config: Config, gains: Gains) -> np.ndarray:
    """Largest modulus of a pole of the observer's error, [n, ...]; below 1 is stable.

    Only for ``input="rigid_body"``, where the joints do not couple. Scenarios with equal gains are solved once.
    """
    axes = max(leaf.ndim - len(spec.axes) for leaf, spec in _with_specs(gains))
    leaves = [leaf.astype(float) for leaf in _of_joints(config, align(gains, axes), np)]
    swept = np.broadcast_shapes(*(leaf.shape[leaf.ndim - axes :] for leaf in leaves))
    own = [leaf.shape[: leaf.ndim - axes] for leaf in leaves]
    flat = [np.broadcast_to(x, size + swept).reshape(int(np.prod(size)), -1) for x, size in zip(leaves, own, strict=True)]
    table, back = np.unique(np.concatenate(flat), axis=1, return_inverse=True)
    parts = np.split(table, np.cumsum([len(x) for x in flat])[:-1])
    each = [
        _radius(config, [part[:, k].reshape(size) for part, size in zip(parts, own, strict=True)])
        for k in range(table.shape[1])
    ]
    return np.stack(each, 1)[:, back.reshape(-1)].reshape(config.n, *swept)


def _radius(config: Config, leaves: list[np.ndarray]) -> np.ndarray:
    """The same [n] of one scenario, from what ``_matrix`` takes."""
    cases = (0.0, 1.0) if config.observer == "ts" else (0.0,)
    matrices = [[_matrix(np, config, *joint, on) for joint in zip(*leaves, strict=True)] for on in cases]  # pyright: ignore[reportCallIssue]
    return np.abs(np.linalg.eigvals(np.array(matrices))).max(-1).max(0)


def check(config: Config, gains: Gains) -> None:
    """Refuse gains with which the observer's error grows; gains under a trace are not looked at.

    Raises:
        ValueError: the spectral radius of some joint, in some scenario, is above 1. At 1 stands an integral whose gain is 0.
    """
    if config.input != "rigid_body" or any(isinstance(leaf, Tracer) for leaf, _ in _with_specs(gains)):
        return
    radius = spectral_radius(config, gains)
    if not (radius <= 1 + MARGINAL).all():
        joint, *scenario = np.unravel_index(np.argmax(np.where(np.isfinite(radius), radius, np.inf)), radius.shape)
        where = f" in scenario {', '.join(map(str, scenario))} (from 0)" if scenario else ""
        raise ValueError(
            f"the observer of joint {joint + 1} ({config.robot.joint_names[joint]}){where} is unstable at dt = "
            f"{config.dt:g} s: the spectral radius of its error is {radius[joint, *scenario]:.4g} and must be below 1; "
            "default_gains(config) gives gains for this dt, or lower observer.alpha_i and alpha_f1, alpha_f3"
        )


def _with_specs(gains: Gains) -> Iterator[tuple[Any, Spec]]:
    for block, name, spec in specs():
        yield getattr(getattr(gains, block), name), spec


def smooth_radius(config: Config, gains: Gains, fuzzy: Flag | None = None) -> Array:
    """The same [n] within 2e-4, from a power of the matrix: with a gradient, on every backend, also at double poles.

    Gains with one trailing scenario axis give [n, scenarios]. ``fuzzy`` says by data whether the fuzzy stage runs.
    """
    leaves, tree = jax.tree.flatten(gains)
    own = [len(spec.axes) for _, _, spec in specs(gains)]
    swept = [-1 if leaf.ndim > rank else None for leaf, rank in zip(leaves, own, strict=True)]
    if any(axis is not None for axis in swept):
        along = jax.vmap(
            lambda one: smooth_radius(config, one, fuzzy), in_axes=(jax.tree.unflatten(tree, swept),), out_axes=-1
        )
        return along(gains)
    power = error_matrices(config, gains, fuzzy)

    def square(carry: tuple[Array, Array], share: Array) -> tuple[tuple[Array, Array], None]:
        power, total = carry
        size = jnp.sqrt((power * power).sum((-2, -1)))
        power = power / size[..., None, None]
        return (power @ power, total + share * jnp.log(size)), None

    total = jnp.zeros(power.shape[:2], power.dtype)  # log of what was divided out, per unit of exponent
    (_, total), _ = jax.lax.scan(square, (power, total), jnp.asarray(0.5 ** np.arange(SQUARINGS + 1), power.dtype))
    return jnp.exp(total).max(0)


def bank_matrices(xi: Array | float, order: int, xp: Any = jnp) -> tuple[Any, Any]:
    """A [order, order] and b [order] of one Laguerre bank, Eq. (5), as matrices of ``xp``, jnp or np."""
    i, j = np.indices((order, order))
    xi = xp.asarray(xi)
    below = (1 - xi**2) * (-xi) ** np.maximum(i - j - 1, 0)
    return xp.where(i == j, xi, xp.where(j < i, below, 0.0)), xp.sqrt(1 - xi**2) * (-xi) ** np.arange(order)


def error_matrices(config: Config, gains: Gains, fuzzy: Flag | None = None) -> Array:
    """State matrices [cases, n, size, size] of (x, dt^2 psi_PI, dt^2 psi_F) for a zero reading: an error after one tick.

    The cases are the fuzzy stage off and fully on, twice off for an observer without it. Inputs and psi are scaled by dt^2,
    so that all entries are angles.
    """
    leaves, on = _of_joints(config, gains, jnp), (0.0, 1.0 * (config.observer == "ts" if fuzzy is None else fuzzy))
    joints = jax.vmap(functools.partial(_matrix, jnp, config), in_axes=(0,) * len(leaves) + (None,))
    dtype = gains.arx.xi_a.dtype
    return jnp.stack([joints(*leaves, jnp.asarray(case, dtype)) for case in on])  # pyright: ignore[reportCallIssue]


def _of_joints(config: Config, gains: Gains, xp: Any) -> list[Any]:
    """What ``_matrix`` takes of each joint, [n, ...]."""
    if config.input != "rigid_body":
        raise ValueError('stability needs input="rigid_body"; with "torque" the joints couple and the arm closes the loop')
    arx, observer = gains.arx, gains.observer
    strongest = xp.maximum(xp.asarray(observer.alpha_f1), xp.asarray(observer.alpha_f3))
    leaves = (arx.xi_a, arx.xi_b, arx.kappa_a, arx.kappa_b, observer.alpha_p, observer.alpha_i, strongest, observer.leak)
    return [xp.asarray(leaf) for leaf in leaves]


def _matrix(
    xp: Any, config: Config, xi_a: Any, xi_b: Any, kappa_a: Any, kappa_b: Any, alpha_p: Any, alpha_i: Any, alpha_f: Any,
    leak: Any, on: Any,
) -> Any:  # fmt: skip
    """One joint's matrix, with the fuzzy stage ``on`` (1) or off (0); ``xp`` is jnp, or np where no gradient is wanted."""
    (a_a, b_a), (a_b, b_b) = bank_matrices(xi_a, config.order_a, xp), bank_matrices(xi_b, config.order_b, xp)
    square = config.dt**2
    read = xp.concatenate([kappa_a, kappa_b[0] / square])
    na, nb = config.order_a, config.order_b
    zeros = lambda *shape: xp.zeros(shape, read.dtype)  # noqa: E731
    angle = xp.concatenate([a_a, zeros(na, nb)], 1) + (1 - alpha_p) * xp.outer(b_a, read)
    return xp.block(
        [
            [angle, zeros(na, 2)],
            [zeros(nb, na), a_b, b_b[:, None], on * b_b[:, None]],
            [-alpha_i * square * read[None], xp.ones((1, 1), read.dtype), zeros(1, 1)],
            [-on * alpha_f * square * read[None], zeros(1, 1), xp.reshape(1 - leak, (1, 1)) * on],
        ]
    )
