"""Residuals, Eq. (13), block 5. One residual cannot serve two kinds of fault, so there is one for each channel."""

from __future__ import annotations

from typing import NamedTuple

from jaxftc.numerics.barrier import stack
from jaxftc.robot.rigid_body import Lane, lanes
from jaxftc.types import Array


class Residuals(NamedTuple):
    """Eq. (13), by channel."""

    tau: Array  # [n, ...] N m
    q: Array  # [n, ...] rad


def generate(mass: list[list[Lane]], psi: Array, y: Array, y_hat: Array) -> Residuals:
    """Torque channel M(q_hat) psi from psi [n, ...] rad/s^2; encoder channel y - y_hat [n, ...] rad."""
    return Residuals(tau=torque(mass, psi), q=y - y_hat)


def torque(mass: list[list[Lane]], qdd: Array) -> Array:
    """M qdd [n, ...] N m for M as n x n lanes."""
    parts = lanes(qdd)
    return stack([sum(m * a for m, a in zip(row, parts, strict=True)) for row in mass])
