"""Default gains: one set that serves every scenario."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc import arx
from jaxftc.arm import chain, plant
from jaxftc.config import Config
from jaxftc.gains import BLOCKS, Gains, build, shape_of, specs
from jaxftc.identify.readout import rounded, with_kappa


def default_gains(config: Config) -> Gains:
    """One set of gains that serves every scenario; the ARX read-out is the exact model of the nominal arm.

    For ``input="torque"`` the read-out is that of an arm with the constant inertia it has in its zero position.
    """
    values: dict[str, dict[str, Any]] = {block: {} for block in BLOCKS}
    for block, name, spec in specs():
        if spec.default is not None:
            values[block][name] = np.broadcast_to(spec.default, shape_of(config, spec))
    with jax.enable_x64(True):  # the read-out's parts differ by a factor of dt^2
        xi = jnp.asarray(values["arx"]["xi_a"])
        kappa_a, kappa_b = map(np.asarray, arx.exact_kappa(xi, config.order_a, config.order_b, config.dt))
        read_in = np.ones((config.n, 1)) if config.input == "rigid_body" else np.linalg.inv(_inertia(config))
    kappa_b = read_in[:, :, None] * kappa_b[:, None]
    values["arx"] |= {"kappa_a": kappa_a, "kappa_b": kappa_b}
    gains = build(config, values)
    kappa = np.concatenate([kappa_a, kappa_b.reshape(config.n, -1), np.zeros((config.n, 1))], axis=1)
    return with_kappa(config, gains, rounded(config, gains.arx, kappa))


def _inertia(config: Config) -> np.ndarray:
    """M [n, n] kg m^2 of the nominal arm in its zero position."""
    rows = plant.nominal_mass(config.robot, chain.pose(config.robot, jnp.asarray(config.robot.q_zero)))
    return np.array([[float(m) for m in row] for row in rows])
