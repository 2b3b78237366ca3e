"""Default gains: one set that serves every scenario."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxftc.config import Config
from jaxftc.gains import Gains, blocks, build, shape_of, specs
from jaxftc.observer.readout import exact
from jaxftc.robot import dynamics, rigid_body


def default_gains(config: Config) -> Gains:
    """One set of gains that serves every scenario; the ARX read-out is the exact model of the nominal arm.

    For ``input="torque"`` the read-out is that of an arm with the constant inertia it has in its zero position.
    """
    values: dict[str, dict[str, Any]] = {block: {} for block in blocks(config)}
    for block, name, spec in specs(config):
        if spec.default is not None:
            values[block][name] = np.broadcast_to(spec.default, shape_of(config, spec))
    values["arx"] |= {name: np.zeros(shape_of(config, spec)) for _, name, spec in specs() if spec.default is None}
    return exact(config, build(config, values), None if config.input == "rigid_body" else np.linalg.inv(_inertia(config)))


def _inertia(config: Config) -> np.ndarray:
    """M [n, n] kg m^2 of the nominal arm in its zero position."""
    mass = dynamics.nominal_mass(config.robot, rigid_body.pose(config.robot, jnp.asarray(config.robot.q_zero)))
    return np.array([[float(m) for m in row] for row in mass.rows])
