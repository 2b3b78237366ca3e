"""Default gains: one set that serves every scenario."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from jaxftc import arx
from jaxftc.config import Config
from jaxftc.gains import BLOCKS, Gains, build, shape_of, specs


def default_gains(config: Config) -> Gains:
    """One set of gains that serves every scenario; the ARX read-out is the exact model of the nominal arm.

    For ``input="torque"`` the read-out is that of an arm with the constant inertia it has in its zero position.
    """
    values: dict[str, dict[str, Any]] = {block: {} for block in BLOCKS}
    for block, name, spec in specs():
        if spec.default is not None:
            values[block][name] = np.broadcast_to(spec.default, shape_of(config, spec))
    kappa_a, kappa_b = _exact_kappa(config, values["arx"]["xi_a"])
    values["arx"] |= {"kappa_a": kappa_a, "kappa_b": kappa_b}
    return build(config, values)


def _exact_kappa(config: Config, xi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    kappa_a, kappa_b = (
        np.asarray(k, float) for k in arx.exact_kappa(np.asarray(xi), config.order_a, config.order_b, config.dt)
    )  # pyright: ignore[reportArgumentType]
    if config.input == "rigid_body":
        return kappa_a, kappa_b[:, None]
    mass = np.zeros((config.n, config.n))
    data = mujoco.MjData(config.robot.mj_model)
    mujoco.mj_forward(config.robot.mj_model, data)
    mujoco.mj_fullM(config.robot.mj_model, mass, data.qM)
    return kappa_a, np.linalg.inv(mass)[:, :, None] * kappa_b[None]
