"""Is the observer stable? The spectral radius of its linear part, joint by joint.

The paper's Lyapunov argument, Eqs. (11), (12), uses a function that is not positive definite and a proof that needs relative
degree one, so it shows nothing here. What can be checked is the matrix that takes model and integrator from tick to tick,

    e = y - kappa x,   x+ = A x + b_y (kappa x + alpha_p e) + b_v psi,   psi+ = psi + alpha_i e,

without the fuzzy stage and with it fully on. For poles xi and the exact model the PI part is stable for
alpha_i < alpha_p^2 (1 - xi)^2 (1 - xi^2) / T^2 (found and checked numerically, not derived). The super-twisting stage is not
linear; simulation covers it.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.config import Config
from jaxftc.gains import Gains, specs
from jaxftc.stages import Flag
from jaxftc.types import Array

SQUARINGS = 16  # of the matrix: the norm of its 65536th power is radius^65536 within a factor that the root takes to 1


def spectral_radius(config: Config, gains: Gains) -> np.ndarray:
    """Largest modulus of a pole of the observer's error, [n]; below 1 is stable.

    Only for ``input="rigid_body"``, where the joints do not couple; gains without scenario axes.
    """
    matrices = np.asarray(error_matrices(config, gains), float)
    return np.abs(np.linalg.eigvals(matrices)).max(-1).max(0)


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


def bank_matrices(xi: Array | float, order: int) -> tuple[Array, Array]:
    """A [order, order] and b [order] of one Laguerre bank, Eq. (5), as matrices."""
    i, j = np.indices((order, order))
    xi = jnp.asarray(xi)
    below = (1 - xi**2) * (-xi) ** np.maximum(i - j - 1, 0)
    return jnp.where(i == j, xi, jnp.where(j < i, below, 0.0)), jnp.sqrt(1 - xi**2) * (-xi) ** np.arange(order)


def error_matrices(config: Config, gains: Gains, fuzzy: Flag | None = None) -> Array:
    """State matrices [cases, n, size, size] of (x, dt^2 psi_PI, dt^2 psi_F) for a zero reading: an error after one tick.

    The cases are the fuzzy stage off and fully on, twice off for an observer without it. Inputs and psi are scaled by dt^2,
    so that all entries are angles.
    """
    if config.input != "rigid_body":
        raise ValueError('stability needs input="rigid_body"; with "torque" the joints couple and the arm closes the loop')
    arx, observer = gains.arx, gains.observer
    strongest = jnp.maximum(observer.alpha_f1, observer.alpha_f3)
    on = (0.0, 1.0 * (config.observer == "ts" if fuzzy is None else fuzzy))

    def one(xi_a, xi_b, kappa_a, kappa_b, alpha_p, alpha_i, alpha_f, leak, on):
        """One joint's matrix, with the fuzzy stage ``on`` (1) or off (0)."""
        (a_a, b_a), (a_b, b_b) = bank_matrices(xi_a, config.order_a), bank_matrices(xi_b, config.order_b)
        square = config.dt**2
        read = jnp.concatenate([kappa_a, kappa_b[0] / square])
        na, nb = config.order_a, config.order_b
        zeros = lambda *shape: jnp.zeros(shape, read.dtype)  # noqa: E731
        angle = jnp.concatenate([a_a, zeros(na, nb)], 1) + (1 - alpha_p) * jnp.outer(b_a, read)
        return jnp.block(
            [
                [angle, zeros(na, 2)],
                [zeros(nb, na), a_b, b_b[:, None], on * b_b[:, None]],
                [-alpha_i * square * read[None], jnp.ones((1, 1), read.dtype), zeros(1, 1)],
                [-on * alpha_f * square * read[None], zeros(1, 1), jnp.reshape(1 - leak, (1, 1)) * on],
            ]
        )

    joints = jax.vmap(one, in_axes=(0,) * 8 + (None,))
    leaves = (arx.xi_a, arx.xi_b, arx.kappa_a, arx.kappa_b, observer.alpha_p, observer.alpha_i, strongest, observer.leak)
    return jnp.stack([joints(*leaves, jnp.asarray(case, arx.xi_a.dtype)) for case in on])
