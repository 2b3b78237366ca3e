"""The observer cascade as most people write it: NumPy arrays [n], one arm, one tick a call. The T-S observer only.

It is for arms whose faults are biases: what ``jaxftc.observer.cascade`` does beyond that for readings which are coarse, come
late or leap by more than a joint turns in a tick (``reach.SPEED * dt``) is left out. That is:

* a coarse reading (``resolution``) stands for the nearest angle within its count, and its jumps are not attributed to b;
* a reading that leaps is not used while its sensor is noisy or suspect, or while others are not used either;
* a pause sets b to 0 if the reading comes back nearer to the prediction without b; here b outlives every pause;
* a reading that comes back from a pause far off has leapt, and its leap goes to b; here the model moves to it;
* a leap that takes b back to almost 0 ends the fault, and the model takes up the rest;
* during a pause the model stays within a tick's turn of the last angle, and after it jumps do not count until it settles.

``numpy_controller`` leaves out two rules of the sensor check alike: the size of a coarse encoder's counts, and that readings
must be lost in a row to make a freeze. With biases as faults the two agree (``tests/project/test_benchmarks.py``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxftc.config import Config
from jaxftc.gains import Gains

Array = np.ndarray


class Seen(NamedTuple):
    """What a reading says, all [n]."""

    y: Array  # rad, reading, predicted where it was not used
    y_hat: Array  # rad
    e: Array  # rad, innovation, its jump taken out
    h_s: Array  # 1, grade of the jump
    side: Array  # 1, its sign
    shift: Array  # rad, by which the model was moved
    psi: Array  # rad/s^2, actuator fault
    missing: Array  # bool
    absent: Array  # bool


def share_at(x: Array, centres: Array, widths: Array) -> Array:
    """Share of the second of two Gaussian sets in the grade of x."""
    x = np.minimum(np.maximum(x, centres[0]), centres[1])  # np.clip takes five times as long
    low, high = ((x - centre) / width for centre, width in zip(centres, widths, strict=True))
    return 1 / (1 + np.exp(0.5 * (high * high - low * low)))


class Observer:
    """State and gains of the cascade, Eqs. (4) to (10)."""

    def __init__(self, config: Config, gains: Gains, q: Array) -> None:
        self.dt, self.gains = config.dt, gains.observer
        self.arx, self.threshold = gains.arx, gains.diagnosis.alpha_tau
        self.kappa_b = gains.arx.kappa_b[:, 0]
        self.banks = [_bank(xi, order) for xi, order in ((self.arx.xi_a, config.order_a), (self.arx.xi_b, config.order_b))]
        self.steady = np.sqrt((1 + self.arx.xi_a) / (1 - self.arx.xi_a))
        self.x_a = np.repeat((self.steady * q)[:, None], config.order_a, axis=1)
        self.x_b = np.zeros((len(q), config.order_b))
        self.psi_pi, self.gamma, self.psi_f, self.b, self.e, self.b_fresh = np.zeros((6, len(q)))
        self.q1, self.q2, self.reading = q, q, q
        self.held = np.zeros(len(q), bool)

    def explain(self, reading: Array, u: Array, qdd_hat: Array, transient: Array, frozen: Array, noisy: Array) -> Seen:
        """Innovation and fault estimates; the flags are doubts.

        ``u`` is the input of the model in the last tick, ``qdd_hat`` the acceleration with all that was compensated.
        """
        g = self.gains
        self.x_b = _advance(self.banks[1], self.x_b, u)
        y_hat = (self.arx.kappa_a * self.x_a).sum(1) + (self.kappa_b * self.x_b).sum(1) + self.arx.offset
        stuck = frozen & (reading == self.reading)
        absent = ~np.isfinite(reading)
        missing = absent | stuck
        back = ~missing & self.held
        b = np.where(stuck, self.b_fresh, self.b)
        y = np.where(missing, y_hat + b, reading)
        e = y - b - y_hat

        unexplained = np.where(missing | back, 0.0, y - b - 2 * self.q1 + self.q2 - self.dt**2 * qdd_hat)
        h_s = share_at(np.abs(unexplained) / g.jump, g.jump_centres, g.jump_widths)
        size = h_s * (e - self.e)
        book = ~(transient | noisy) | (np.abs(b + size) < np.abs(b))
        moved = np.where(book, g.alpha_f2 * size, 0.0)
        shift = np.where(back, e, np.where(book | noisy, 0.0, size))

        self.x_a = self.x_a + (self.steady * shift)[:, None]
        y_hat, e, b = y_hat + shift, e - shift - moved, b + moved
        sgn = np.tanh(e / g.eps)
        psi_sm = g.alpha_sm * np.sqrt(np.abs(e)) * sgn * (1 - h_s) + self.gamma  # Eq. (7)
        psi = self.psi_pi + psi_sm + self.psi_f  # Eq. (15)
        self.psi_pi = self.psi_pi + g.alpha_i * e  # Eq. (6)
        self.gamma = self.gamma + self.dt * g.alpha_sm0 * sgn
        self.b_fresh = np.where(~missing & (reading != self.reading), b, self.b_fresh)
        self.q1, self.q2, self.e, self.b, self.held = y - b, self.q1 + shift, e, b, missing
        self.reading = np.where(absent, self.reading, reading)
        return Seen(y, y_hat, e, h_s, np.sign(unexplained), shift, psi, missing, absent)

    def adapt(self, seen: Seen, residual_tau: Array) -> None:
        """The fuzzy stage learns from the torque residual, the angle's bank from the correction."""
        g = self.gains
        at = share_at(np.abs(residual_tau) / self.threshold, g.tau_centres, g.tau_widths)
        drive = (at * (1 - seen.h_s) * g.alpha_f1 + at * seen.h_s * g.alpha_f3) * seen.e  # Eq. (9)
        self.psi_f = (1 - g.leak) * self.psi_f + drive  # Eq. (10)
        self.x_a = _advance(self.banks[0], self.x_a, seen.y_hat + g.alpha_p * seen.e)  # Eq. (6)


def _bank(xi: Array, order: int) -> tuple[Array, Array]:
    """A [n, order, order] and b [n, order] of Eq. (5)."""
    i, j = np.indices((order, order))
    pole = xi[:, None, None]
    below = (1 - pole**2) * (-pole) ** np.maximum(i - j - 1, 0)
    matrix = np.where(i == j, pole, np.where(j < i, below, 0.0))
    return matrix, np.sqrt(1 - xi[:, None] ** 2) * (-xi[:, None]) ** np.arange(order)


def _advance(bank: tuple[Array, Array], x: Array, u: Array) -> Array:
    return np.matmul(bank[0], x[..., None])[..., 0] + bank[1] * u[:, None]
