"""The ARX-Laguerre model of the joints, Eqs. (4), (5), block 1.

Two banks per joint, on its own angle and on the input, and a linear read-out::

    y(k) = kappa_a x_a(k) + sum over inputs of kappa_b x_b(k) + offset

Y(k+1) = kappa^T X(k) as printed in Eq. (5) would be one tick off Eq. (6). With the input ``rigid_body``, v is the
acceleration that the nominal arm gives for the commanded torque (the paper's own Eqs. (2), (3)), and each joint is a double
integrator of it. With ``torque``, the signal-based form, every joint reads the torques of all joints and a constant.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxftc.config import Config
from jaxftc.gains import ArxGains, Gains
from jaxftc.observer import laguerre
from jaxftc.types import Array


class State(NamedTuple):
    """Bank states."""

    x_a: Array  # [n, order_a, ...] rad, bank on the angle
    x_b: Array  # [n, order_b, ...] rad/s^2 or N m, bank on the input


def init(config: Config, gains: Gains, q: Array) -> State:
    """At rest in q [n, ...] rad: the angle's bank settled, no input."""
    settled = laguerre.steady_gain(gains.arx.xi_a) * q
    return State(
        x_a=jnp.repeat(settled[:, None], config.order_a, axis=1),
        x_b=jnp.zeros((q.shape[0], config.order_b, *q.shape[1:]), q.dtype),
    )


def predict(gains: ArxGains, state: State) -> Array:
    """y_hat [n, ...] rad of this tick."""
    y_hat = (gains.kappa_a * state.x_a).sum(1) + gains.offset
    if gains.kappa_b.shape[1] == 1:
        return y_hat + (gains.kappa_b[:, 0] * state.x_b).sum(1)
    return y_hat + sum((gains.kappa_b[:, i] * state.x_b[i]).sum(1) for i in range(state.x_b.shape[0]))


def advance(gains: ArxGains, state: State, y: Array, u: Array) -> State:
    """Bank states one tick later for an angle y [n, ...] rad and an input u [n, ...], Eq. (5)."""
    return State(laguerre.advance(gains.xi_a, state.x_a, y), laguerre.advance(gains.xi_b, state.x_b, u))


def exact_kappa(xi: Array, order_a: int, order_b: int, dt: float) -> tuple[Array, Array]:
    """Read-out [n, order_a], [n, order_b] that makes the model an exact double integrator of v, for equal poles xi [n].

    From ``1 - H_y = (z - 1)^2 / (z - xi)^2`` and ``H_v = dt^2 z / (z - xi)^2``, which two Laguerre functions each span;
    higher orders get 0. ``H_y(1) = 1``: a constant angle is predicted without error.
    """
    scale = jnp.sqrt(1 - xi**2)
    c1 = -(1 - xi) / ((1 + xi) * scale)
    c0 = xi * c1 + 2 * (1 - xi) / scale
    d0 = dt**2 / scale**3
    pad = lambda columns, order: jnp.stack(columns + [jnp.zeros_like(xi)] * (order - 2), axis=1)  # noqa: E731
    return pad([c0, c1], order_a), pad([d0, xi * d0], order_b)
