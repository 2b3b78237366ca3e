"""The stop of a loop: brake and hold the arm against gravity, then let the torque go to zero."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxftc import checks
from jaxftc.compile.jit import ahead
from jaxftc.config import Config
from jaxftc.numerics import smooth
from jaxftc.robot import dynamics, lanes, rigid_body
from jaxftc.types import Array, Output

LEAST_BRAKE = 5  # ticks: a brake that is quicker would overshoot


class SafeStop:
    """Torque of the nominal arm that brakes every joint to rest and holds it against gravity, then a ramp to zero.

    It needs the estimated angle and speed and nothing of the controller, which may be what went wrong. It does not go back
    to where the stop began, and it compensates no fault: give the loop a stop of your own for that. The brakes of the arm
    should close while it holds.

    Args:
        config: Robot and timing.
        hold: s, that it brakes and holds.
        ramp: s, in which the torque goes to zero after that.
        brake: s, time constant of braking.

    Raises:
        ValueError: a time is negative, infinite, or ``brake`` too short for the sample time.
    """

    def __init__(self, config: Config, *, hold: float = 1.0, ramp: float = 2.0, brake: float = 0.1) -> None:
        for name, value in (("hold", hold), ("ramp", ramp)):
            checks.span(name, value, finite=True)
        checks.positive("brake", brake, "seconds")
        if brake < LEAST_BRAKE * config.dt:
            raise ValueError(f"brake must be at least {LEAST_BRAKE} ticks of {config.dt:g} s, got {brake:g} s")
        self.hold, self.ramp, self._dt = hold, ramp, config.dt

        def braking(signals: Array) -> Array:
            q, qd = signals
            tau = dynamics.nominal_torque(config.robot, rigid_body.pose(config.robot, q), jnp.zeros_like(q), -qd / brake)
            return smooth.saturate(tau, lanes.trailing_constant(config.robot.torque_limit, q))

        self._signals = np.zeros((2, config.n))
        self._braking = ahead(braking, self._signals)

    def __call__(self, since: float, out: Output) -> tuple[np.ndarray, bool]:
        """Torque [n] N m at ``since`` s after the trip, and whether the stop is over."""
        left = self.hold + self.ramp - since
        if left < 0.5 * self._dt:  # a zero torque is what ends it, whatever times round to
            return np.zeros_like(out.q_hat), True
        signals = self._signals.copy()
        signals[0], signals[1] = out.q_hat, out.qd_hat
        share = 1.0 if since <= self.hold else left / self.ramp
        return share * np.asarray(self._braking(signals)), False
