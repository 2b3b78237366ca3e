"""What every stage takes in that estimates the actuator fault from the innovation.

A stage is a block whose info is its share of psi [n, ...] rad/s^2. Which are there is the table in ``cascade.py``.
"""

from __future__ import annotations

from typing import NamedTuple

from jaxftc.stages import Stages
from jaxftc.types import Array


class Inputs(NamedTuple):
    """What a tick takes in."""

    e: Array  # [n, ...] rad, innovation
    h_s: Array  # [n, ...] grade with which the reading jumped
    on: Stages  # which stages run
