"""The observer's linear part in the frequency domain, joint by joint: what reaches the residual, and the margins.

With e = y - y_hat the observer is a loop around the innovation: y_hat = L e, where L holds the model's double integrator,
the correction alpha_p and the integral alpha_i. Closing it gives

    e = S y,   psi = N y,   psi = F d,   S = 1 / (1 + L),   F = N T^2 z / (z - 1)^2,

for a reading error y and an acceleration d that the model does not know: an actuator fault, or a mismatch of the model such
as friction and payload. They enter at the same place, so no observer gain can pass one and stop the other: thresholds have
to. F is 1 at low frequency: a lasting fault is estimated without bias. The torque residual is M(q) psi, Eq. (13). The
super-twisting stage is not linear and is left out.

The compensation has a rate of its own (control/compensation.py): psi_c = C d with

    C = F + H w S T^2 z / (z - 1)^2,   H = a z / (z - 1 + a),   a = 1 - exp(-rate T),   w = alpha_p (1 - xi)^2 / T^2,

and 1 - C is what of a fault reaches the arm. Without the fuzzy stage C is F.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxftc import checks, stages
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.observer.stability import error_matrices

POINTS = 4000  # of the frequency grid on which margins are found
LOWEST = 1e-4  # of the Nyquist frequency, where that grid begins


class Response(NamedTuple):
    """Responses of every joint to a sine, complex: amplitude and phase."""

    frequency: np.ndarray  # [F] Hz
    fault: np.ndarray  # [n, F] 1, F: estimate psi over an unknown acceleration, be it a fault or a mismatch
    noise: np.ndarray  # [n, F] 1/s^2, N: psi over a reading error
    innovation: np.ndarray  # [n, F] 1, S: innovation over a reading error
    loop: np.ndarray  # [n, F] 1, L
    compensated: np.ndarray  # [n, F] 1, C: what the control law takes out, over an unknown acceleration


class Margins(NamedTuple):
    """How far the loop of each joint is from its stability limit."""

    gain_up: np.ndarray  # [n] factor by which the loop gain may grow; infinite if no growth makes it unstable
    gain_down: np.ndarray  # [n] factor to which it may fall; 0 if no loss does. The loop is conditionally stable
    phase: np.ndarray  # [n] deg, at the crossover that is nearest to the limit
    modulus: np.ndarray  # [n] 1, least distance of L from -1, the inverse of the largest |S|
    crossover: np.ndarray  # [n] Hz, highest frequency at which |L| is 1: the observer's bandwidth


def frequency_response(config: Config, gains: Gains, frequency: np.ndarray, *, fuzzy: bool = False) -> Response:
    """Responses at some frequencies.

    Args:
        config: Order of the model, sample time; ``input="rigid_body"``, where the joints do not couple.
        gains: Without scenario axes.
        frequency: [F] Hz, above 0 and below the Nyquist frequency.
        fuzzy: With the fuzzy stage fully on; off otherwise, as on a healthy arm.

    Returns:
        Responses [n, F], see ``Response``.

    Raises:
        ValueError: another input, or a frequency outside its range.
    """
    frequency = np.atleast_1d(np.asarray(frequency, float))
    nyquist = 0.5 / config.dt
    if frequency.ndim != 1 or not ((frequency > 0) & (frequency < nyquist)).all():
        raise ValueError(f"frequency must be [F], above 0 and below {nyquist:g} Hz, half the sample rate, got {frequency}")
    checks.instance("gains", gains, Gains)
    matrix, enters, y_hat, psi = _loop(config, gains, fuzzy)
    z = np.exp(2j * np.pi * frequency * config.dt)
    inverse = np.linalg.inv(z[:, None, None, None] * np.eye(matrix.shape[-1]) - matrix)  # [F, n, size, size]
    state = (inverse @ enters[..., None])[..., 0]  # [F, n, size], over a reading error
    closed, noise = ((row * state).sum(-1).T for row in (y_hat, psi))
    innovation = 1 - closed
    integrator = config.dt**2 * z / (z - 1) ** 2
    fault = noise * integrator
    compensated = fault + _ahead(config, gains, z) * innovation * integrator
    return Response(frequency, fault, noise, innovation, closed / innovation, compensated)


def margins(config: Config, gains: Gains, *, fuzzy: bool = False) -> Margins:
    """Gain, phase and modulus margins of every joint; arguments and errors as ``frequency_response``."""
    grid = np.geomspace(LOWEST, 1 - 1e-9, POINTS) * 0.5 / config.dt
    loops = frequency_response(config, gains, grid, fuzzy=fuzzy).loop
    return Margins(*(np.array(values) for values in zip(*(_margins(grid, loop) for loop in loops), strict=True)))


def _margins(frequency: np.ndarray, loop: np.ndarray) -> tuple[float, float, float, float, float]:
    real, imaginary, size = np.real(loop), np.imag(loop), np.log(np.abs(loop))
    on_axis = _crossings(imaginary, real)
    on_axis = np.append(on_axis, real[-1])  # L is real at the Nyquist frequency
    factors = -1 / on_axis[on_axis < 0]
    phase = np.abs(np.angle(-_crossings(size, loop)))
    crossover = _crossings(size, frequency)
    return (
        float(np.min(factors[factors > 1], initial=np.inf)),
        float(np.max(factors[factors < 1], initial=0.0)),
        float(np.rad2deg(phase.min(initial=np.pi))),
        float(np.abs(1 + loop).min()),
        float(crossover.max(initial=0.0)),
    )


def _crossings(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Y [crossings] where x changes its sign, of x and y [points], by straight lines between the points."""
    at = np.flatnonzero(x[:-1] * x[1:] < 0)
    share = x[at] / (x[at] - x[at + 1])
    return y[at] + share * (y[at + 1] - y[at])


def _ahead(config: Config, gains: Gains, z: np.ndarray) -> np.ndarray:
    """What is compensated beside psi over the innovation, [n, F] 1/s^2: H w at z [F]; 0 without the fuzzy stage."""
    if not stages.of(config).fuzzy:
        return np.zeros((config.n, len(z)))
    alpha_p, xi, rate = (np.asarray(x, float)[:, None] for x in (gains.observer.alpha_p, gains.arx.xi_a, gains.control.rate))
    share = -np.expm1(-rate * config.dt)
    return alpha_p * ((1 - xi) / config.dt) ** 2 * share * z / (z - 1 + share)


def _loop(config: Config, gains: Gains, fuzzy: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of every joint: state matrix for a zero reading, how a reading enters, and the rows of y_hat and of psi.

    The state is that of ``error_matrices``: (x_a, x_b, dt^2 psi_PI, dt^2 psi_F).
    """
    matrix = np.asarray(error_matrices(config, gains, fuzzy)[int(fuzzy)], float)
    n, size, square = config.n, matrix.shape[-1], config.dt**2
    arx = {name: np.asarray(getattr(gains.arx, name), float) for name in ("xi_a", "kappa_a", "kappa_b")}
    names = ("alpha_p", "alpha_i", "alpha_f1", "alpha_f3")
    own = {name: np.asarray(getattr(gains.observer, name), float) for name in names}
    y_hat, psi, enters = (np.zeros((n, size)) for _ in range(3))
    y_hat[:, : size - 2] = np.concatenate([arx["kappa_a"], arx["kappa_b"][:, 0] / square], axis=1)
    psi[:, -2:] = 1 / square, fuzzy / square
    order = np.arange(config.order_a)
    bank = np.sqrt(1 - arx["xi_a"] ** 2)[:, None] * (-arx["xi_a"][:, None]) ** order
    enters[:, : config.order_a] = own["alpha_p"][:, None] * bank
    enters[:, -2] = square * own["alpha_i"]
    enters[:, -1] = fuzzy * square * np.maximum(own["alpha_f1"], own["alpha_f3"])
    return matrix, enters, y_hat, psi
