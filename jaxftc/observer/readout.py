"""The read-out of the ARX model, kappa and offset, Eq. (5): set, exact for the nominal arm, rounded with its sum kept."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc import checks
from jaxftc.config import Config
from jaxftc.gains import ArxGains, Gains
from jaxftc.observer import arx
from jaxftc.types import Array


def exact(config: Config, gains: Gains, read_in: np.ndarray | None = None) -> Gains:
    """Gains with the read-out of the exact double integrator for their poles, as their precision holds it.

    ``read_in`` [n, inputs] is the acceleration that each input gives; v is one already. Both banks need the same poles.
    """
    with jax.enable_x64(True):  # the parts differ by a factor of dt^2
        xi = jnp.asarray(np.asarray(gains.arx.xi_a, float))
        kappa_a, kappa_b = map(np.asarray, arx.exact_kappa(xi, config.order_a, config.order_b, config.dt))
    read_in = np.ones((config.n, 1)) if read_in is None else read_in
    parts = (kappa_a, (read_in[:, :, None] * kappa_b[:, None]).reshape(config.n, -1), np.zeros((config.n, 1)))
    return with_kappa(config, gains, rounded(config, gains.arx, np.concatenate(parts, axis=1)))


def with_kappa(config: Config, gains: Gains, kappa: np.ndarray | Array) -> Gains:
    """Gains with the read-out kappa [n, features, ...], in the precision they had; jit-able.

    Raises:
        ValueError: kappa has another number of features.
    """
    a, b = config.order_a, config.inputs * config.order_b
    checks.joints_first("kappa", kappa, config.n)
    if kappa.ndim < 2 or kappa.shape[1] != a + b + 1:
        raise ValueError(
            f"kappa must be [{config.n}, {a + b + 1}]: order_a, inputs times order_b, 1; got shape {kappa.shape}"
        )
    kappa = jnp.asarray(kappa, gains.arx.kappa_a.dtype)
    kappa_b = kappa[:, a : a + b].reshape(config.n, config.inputs, config.order_b, *kappa.shape[2:])
    block = dataclasses.replace(gains.arx, kappa_a=kappa[:, :a], kappa_b=kappa_b, offset=kappa[:, -1])
    return dataclasses.replace(gains, arx=block)


def rounded(config: Config, gains: ArxGains, kappa: np.ndarray) -> np.ndarray:
    """Kappa [n, features] as the precision of the gains holds it, the sum of kappa_a kept.

    The smallest entry of kappa_a, which has the finest steps, takes what rounding the others left over. In float32, H_y(1)
    would otherwise miss 1 by 1e-7, which is a push of 0.01 rad/s^2 and a quarter of a degree after a second of free run.
    """
    dtype, a = np.asarray(gains.kappa_a).dtype, config.order_a
    kappa = kappa.astype(dtype).astype(float)
    joints, smallest = np.arange(config.n), np.abs(kappa[:, :a]).argmin(1)
    kappa[joints, smallest] += total(gains) - kappa[:, :a].sum(1)
    return kappa.astype(dtype).astype(float)


def total(gains: ArxGains) -> np.ndarray:
    """What kappa_a [n, order_a] must sum to, [n], for H_y(1) = 1."""
    xi = np.asarray(gains.xi_a, float)
    return np.sqrt((1 - xi) / (1 + xi))
