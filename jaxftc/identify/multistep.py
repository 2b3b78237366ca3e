"""The simulation error: a model's own predictions fed back to it, for judging every model and for fitting one.

The model restarts from the measured bank states every ``horizon`` ticks and reads its own prediction in between. Horizon 1
is the one-step error, the length of the log is the free run.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc import checks
from jaxftc.compile.jit import jit
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.identify.linear_model import data, flatten, span
from jaxftc.logs.log import Log
from jaxftc.observer import laguerre
from jaxftc.observer.readout import rounded, with_kappa
from jaxftc.types import Array

HORIZON = 50  # ticks
SETTLED = 1e-10  # relative gain promised by a step that ends the search


class Size(NamedTuple):
    """Size of an error over all ticks."""

    rms: np.ndarray  # [n] rad
    max: np.ndarray  # [n] rad


class Errors(NamedTuple):
    """How far a model is from a log; and the straight line 2 y(k-1) - y(k-2), which alone predicts well at 1 kHz."""

    one_step: Size
    fifty_step: Size  # restarts from the readings every 50 ticks
    free_run: Size  # from the first reading, given only u
    extrapolator_one_step: Size
    extrapolator_fifty_step: Size


class _Problem(NamedTuple):
    """One fit or simulation."""

    xi: Array  # [n] pole of the angle's bank
    phi: Array  # [T, n, features]
    q: Array  # [T, n] rad
    restart: Array  # [T] bool


def errors(config: Config, gains: Gains, log: Log) -> Errors:
    """One-step, 50-step and free-run errors of a model on a log, and the linear extrapolator's; one that explodes is inf.

    With an encoder noise of sigma no one-step error can be below sigma, and the restarts of the 50-step error carry noise.

    Args:
        config: Robot, time step and the model's orders.
        gains: The model, ``gains.arx``.
        log: A recording that starts at rest.

    Returns:
        Errors, rad.

    Raises:
        ValueError: the log is refused (a joint may stand still here), or a gain is not allowed.
    """
    phi, q = data(config, gains, log, moving=False)

    def run(horizon: int) -> Size:
        return _size(_miss(config, gains, phi, q, horizon))

    return Errors(run(1), run(HORIZON), run(len(q)), _size(_extrapolate(q, 1) - q), _size(_extrapolate(q, HORIZON) - q))


def predict(config: Config, gains: Gains, log: Log, horizon: int) -> np.ndarray:
    """Angles [T, n] rad that a model predicts for a log, restarted from its readings every ``horizon`` ticks.

    Args:
        config: Robot, time step and the model's orders.
        gains: The model, ``gains.arx``.
        log: A recording that starts at rest.
        horizon: Ticks between restarts.

    Returns:
        Angles [T, n] rad.

    Raises:
        ValueError: the log is refused (a joint may stand still here), a gain is not allowed, or horizon is below 1.
    """
    checks.integer("horizon", horizon, 1, "1 is one-step prediction, the length of the log is the free run")
    phi, q = data(config, gains, log, moving=False)
    return q + _miss(config, gains, phi, q, horizon)


def _miss(config: Config, gains: Gains, phi: np.ndarray, q: np.ndarray, horizon: int) -> np.ndarray:
    """Prediction minus reading [T, n] rad."""
    with jax.enable_x64(True):
        return np.asarray(_residual(config.order_a, _problem(gains, phi, q, horizon), jnp.asarray(flatten(gains.arx))))


def fit_multistep(config: Config, gains: Gains, log: Log, horizon: int = HORIZON, steps: int = 60) -> Gains:
    """Gains whose read-out has the least simulation error over ``horizon`` ticks with H_y(1) = 1, from those given.

    Levenberg-Marquardt per joint, with forward derivatives of the whole simulation. No joint's simulation error becomes
    larger than it was: one that cannot be bettered, for instance because its start breaks H_y(1) = 1 to advantage, keeps
    its read-out. The horizon decides what is learned: over 50 ticks the encoder's noise at the restarts outweighs a gain of
    kappa_b that is 0.1 % off, so such a model is no better than batch least squares in free run; a model that is to run
    alone needs ``horizon=len(log.q)``. A longer horizon on an arm with unmodelled friction fits the friction instead.

    Args:
        config: Robot, time step and the model's orders.
        gains: Poles and a read-out to begin with; everything else in them stays.
        log: A healthy recording that starts at rest and in which every joint moves.
        horizon: Ticks between restarts of the simulation.
        steps: Of Levenberg-Marquardt, at most.

    Returns:
        The gains with another read-out.

    Raises:
        ValueError: the log or a gain is refused, horizon or steps is below 1, or the given model explodes in the horizon.
    """
    checks.integer("horizon", horizon, 1, f"{HORIZON} ticks is the default, the length of the log is the free run")
    checks.integer("steps", steps, 1, "60 is the default")
    phi, q = data(config, gains, log)
    origin, basis = span(config, gains.arx)
    length = np.sqrt(((phi @ basis) ** 2).mean(0))  # [n, p]
    scaled = basis[None] / np.where(length == 0, 1.0, length)[:, None]
    given = flatten(gains.arx)
    with jax.enable_x64(True):
        problem = _problem(gains, phi, q, horizon)
        before = np.asarray(_cost(config.order_a, problem, jnp.asarray(given)))
        kappa = _descend(config.order_a, problem, jnp.asarray(origin), jnp.asarray(scaled), steps)
        kappa = rounded(config, gains.arx, kappa)
        after = np.asarray(_cost(config.order_a, problem, jnp.asarray(kappa)))
        return with_kappa(config, gains, np.where((after <= before)[:, None], kappa, given))


def _descend(order_a: int, problem: _Problem, origin: Array, basis: Array, steps: int) -> np.ndarray:
    """Levenberg-Marquardt from origin [n, features] along basis [n, features, p]; joints at once, damped apart."""
    n, p = basis.shape[0], basis.shape[2]
    kappa, damping = origin, np.full(n, 1e-3)
    cost, hessian, gradient = map(np.asarray, _normal(order_a, problem, kappa, basis))
    if not np.isfinite(cost).all():
        joint = int(np.flatnonzero(~np.isfinite(cost))[0]) + 1
        raise ValueError(
            f"the given model of joint {joint} explodes within the horizon; start from default_gains, or shorten it"
        )
    for _ in range(steps):
        diagonal = np.einsum("npp->np", hessian)
        damped = hessian + np.maximum(damping[:, None] * diagonal, 1e-30)[:, :, None] * np.eye(p)
        step = np.linalg.solve(damped, -gradient[:, :, None])
        trial = kappa + (basis @ step)[:, :, 0]
        reached = np.asarray(_cost(order_a, problem, trial))
        better = reached < cost  # a trial that exploded is not
        promised = -(gradient * step[:, :, 0]).sum(1)
        kappa = jnp.where(better[:, None], trial, kappa)
        damping = np.where(better, 0.1 * damping, 10 * damping).clip(1e-12, 1e12)
        if (promised < SETTLED * cost).all():
            break
        cost, hessian, gradient = map(np.asarray, _normal(order_a, problem, kappa, basis))
    return np.asarray(kappa)


def _problem(gains: Gains, phi: np.ndarray, q: np.ndarray, horizon: int) -> _Problem:
    """What is fitted: features phi [T, n, features] and q [T, n] rad, restarted every ``horizon`` ticks."""
    restart = np.arange(len(q)) % horizon == 0
    return _Problem(jnp.asarray(np.asarray(gains.arx.xi_a, float)), jnp.asarray(phi), jnp.asarray(q), jnp.asarray(restart))


def _simulate(order_a: int, problem: _Problem, kappa: Array) -> Array:
    """Prediction minus reading [T, n] rad, the angle's bank fed with the prediction between restarts."""
    driven = jnp.einsum("nf,tnf->tn", kappa[:, order_a:], problem.phi[:, :, order_a:])  # inputs are measured throughout

    def body(x_a: Array, x: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        measured, drive, restart = x
        x_a = jnp.where(restart, measured, x_a)
        y_hat = (kappa[:, :order_a] * x_a).sum(1) + drive  # Eq. (5)
        return laguerre.advance(problem.xi, x_a, y_hat), y_hat

    measured = problem.phi[:, :, :order_a]
    return jax.lax.scan(body, measured[0], (measured, driven, problem.restart))[1] - problem.q


def _sum_of_squares(order_a: int, problem: _Problem, kappa: Array) -> Array:
    """Sum over time of squared errors [n] rad^2, from a read-out kappa [n, features]."""
    return (_simulate(order_a, problem, kappa) ** 2).sum(0)


def _normal_equations(order_a: int, problem: _Problem, kappa: Array, basis: Array) -> tuple[Array, Array, Array]:
    """Cost [n], J^T J [n, p, p] and J^T r [n, p]. Joints do not meet in the simulation, so all move along at once."""

    def residual(w: Array) -> tuple[Array, Array]:
        r = _simulate(order_a, problem, kappa + basis @ w)
        return r, r

    jacobian, r = jax.jacfwd(residual, has_aux=True)(jnp.zeros(basis.shape[2], kappa.dtype))
    return (r**2).sum(0), jnp.einsum("tnp,tnq->npq", jacobian, jacobian), jnp.einsum("tnp,tn->np", jacobian, r)


_residual, _cost, _normal = (jit(f, static_argnums=0) for f in (_simulate, _sum_of_squares, _normal_equations))


def _extrapolate(q: np.ndarray, horizon: int) -> np.ndarray:
    """Straight line [T, n] rad through the two readings before each restart; at rest before the first."""
    k = np.arange(len(q))
    start = k - k % horizon
    before = np.concatenate([q[:1], q[:1], q])
    return before[start + 1] + (k - start + 1)[:, None] * (before[start + 1] - before[start])


def _size(error: np.ndarray | Array) -> Size:
    error = np.abs(np.asarray(error))
    error[np.isnan(error)] = np.inf
    with np.errstate(over="ignore"):
        return Size(np.sqrt((error**2).mean(0)), error.max(0))
