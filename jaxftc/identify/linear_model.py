"""The read-out as one vector a joint, what it multiplies, and the constraint on it.

kappa [n, features] holds, in this order, kappa_a (order_a), kappa_b (inputs times order_b) and the offset; phi has the same
order. A constant angle is to be predicted without error::

    H_y(1) = steady_gain(xi_a) * sum(kappa_a) = 1

so every fit searches kappa = origin + basis w, whose w is free. For ``rigid_body`` the offset is held as well: v knows
gravity. For ``torque`` the constraint is not exact. A gravity torque that grows by K with the angle makes
1 - H_y(1) = dt^2 K / (M (1 - xi)^2), about 2e-4 for the PUMA's joint 2. But encoder noise of 3e-5 rad moves a free
H_y(1) by up to 5e-3 (a motion of 0.1 rad), and its free run is ten times worse than with 1 held: 1.0 against 0.09 deg.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.compile.jit import jit
from jaxftc.config import Config
from jaxftc.gains import ArxGains, Gains
from jaxftc.gains import check as check_gains
from jaxftc.logs.log import Log, check_log, model_input
from jaxftc.observer import arx, laguerre
from jaxftc.observer.readout import total
from jaxftc.robot import dynamics, rigid_body
from jaxftc.types import Array


def features(config: Config, bank: arx.State) -> Array:
    """Phi [n, features, ...] of a tick, from the bank states before its reading enters: y_hat = kappa^T phi, Eq. (5)."""
    x_b = bank.x_b
    if config.input == "torque":
        every = x_b.reshape(1, -1, *x_b.shape[2:])
        x_b = jnp.broadcast_to(every, (config.n, *every.shape[1:]))
    return jnp.concatenate([bank.x_a, x_b, jnp.ones_like(bank.x_a[:, :1])], axis=1)


def regressors(config: Config, gains: ArxGains, q: np.ndarray | Array, u: np.ndarray | Array) -> np.ndarray:
    """Phi [T, n, features] of every tick in float64, from angles q [T, n] rad and inputs u [T, n] of ``model_input``.

    The banks start at rest in q[0]: the angle's settled, the input's at 0, or for ``torque`` at what holds the nominal arm
    there. (At 0 the torques' banks would show a push that never was.)

    Raises:
        ValueError: q or u is not [T, n].
    """
    q, u = np.asarray(q, float), np.asarray(u, float)
    if q.ndim != 2 or q.shape[1] != config.n or q.shape != u.shape:
        raise ValueError(f"q and u must both be [T, {config.n}], ticks first, got shapes {q.shape} and {u.shape}")
    with jax.enable_x64(True):
        return np.asarray(_scan(config, in_float64(gains), jnp.asarray(q), jnp.asarray(u)))


def _scan(config: Config, gains: ArxGains, q: Array, u: Array) -> Array:
    """Phi [T, n, features] for angles q [T, n] rad and inputs u [T, n]."""
    gain_a, gain_b = laguerre.steady_gain(gains.xi_a), laguerre.steady_gain(gains.xi_b)
    zero = jnp.zeros_like(q[0])
    hold = (
        zero
        if config.input == "rigid_body"
        else dynamics.nominal_torque(config.robot, rigid_body.pose(config.robot, q[0]), zero, zero)
    )
    x_a = jnp.repeat((gain_a * q[0])[:, None], config.order_a, axis=1)
    x_b = jnp.repeat((gain_b * hold)[:, None], config.order_b, axis=1)

    def body(bank: arx.State, x: tuple[Array, Array]) -> tuple[arx.State, Array]:
        return arx.advance(gains, bank, *x), features(config, bank)

    return jax.lax.scan(body, arx.State(x_a, x_b), (q, u))[1]


_scan = jit(_scan, static_argnums=0)


def in_float64(gains: ArxGains) -> ArxGains:
    """The block in float64; call it where x64 is on."""
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), float), gains)


def data(config: Config, gains: Gains, log: Log, *, moving: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Phi [T, n, features] and q [T, n] of a log, once the log and the gains are checked.

    Raises:
        ValueError: the log or a gain is refused, or the gains have scenario axes.
    """
    check_gains(config, gains)
    if np.ndim(gains.arx.kappa_a) != 2:
        shape = np.shape(gains.arx.kappa_a)
        raise ValueError(f"gains of one arm are needed, without scenario axes, got arx.kappa_a of shape {shape}")
    log = check_log(config, log, moving=moving)
    return regressors(config, gains.arx, log.q, model_input(config, log)), np.asarray(log.q)


def flatten(gains: ArxGains) -> np.ndarray:
    """Kappa [n, features] in float64."""
    n = len(gains.kappa_a)
    parts = (gains.kappa_a, np.reshape(gains.kappa_b, (n, -1)), np.reshape(gains.offset, (n, 1)))
    return np.concatenate([np.asarray(part, float) for part in parts], axis=1)


def span(config: Config, gains: ArxGains) -> tuple[np.ndarray, np.ndarray]:
    """Origin [n, features] and basis [features, p] of the allowed read-outs; the origin is the nearest to the given one."""
    a, b = config.order_a, config.inputs * config.order_b
    origin = flatten(gains)
    origin[:, :a] -= ((origin[:, :a].sum(1) - total(gains)) / a)[:, None]
    free = b + (config.input == "torque")
    basis = np.zeros((a + b + 1, a - 1 + free))
    basis[:a, : a - 1] = np.linalg.qr(np.ones((a, 1)), mode="complete")[0][:, 1:]  # changes of kappa_a that sum to 0
    basis[a : a + free, a - 1 :] = np.eye(free)
    return origin, basis
