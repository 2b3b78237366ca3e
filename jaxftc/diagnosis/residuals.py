"""Residuals, Eq. (13), block 5. One residual cannot serve two kinds of fault, so there is one for each channel."""

from __future__ import annotations

from typing import NamedTuple

from jaxftc.compile.box import box
from jaxftc.observer.cascade import Estimate
from jaxftc.robot.mass_matrix import MassMatrix
from jaxftc.types import Array


class Residuals(NamedTuple):
    """Eq. (13), by channel."""

    tau: Array  # [n, ...] N m
    q: Array  # [n, ...] rad


@box("Block 5: residuals, Eq. (13)")
def generate(mass: MassMatrix, seen: Estimate) -> Residuals:
    """Torque channel M(q_hat) psi; encoder channel y - y_hat."""
    return Residuals(tau=mass.matvec(seen.psi), q=seen.y - seen.y_hat)
