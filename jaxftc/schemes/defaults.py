"""Default gains: one set that serves every scenario, at any sample time and with any encoder.

The numbers of ``gains`` are for 1 ms and an encoder of 3e-5 rad. Elsewhere the observer is the same one, slowed down in time
by a factor ``pace`` and sampled anew. A triple integrator (angle, speed, fault) whose reading is white noise of intensity
sigma^2 T, and whose fault is a random walk, has its steady Kalman bandwidth at (walk^2 / (sigma^2 T))^(1/6): so

    pace = (sigma_0^2 T_0 / (sigma^2 T))^(1/6), at most 1,

for a better sensor leaves the model's errors as they are. With t the observer's own time, T pace / T_0 of today's ticks:

* the poles of its error are today's to the power of t, which gives xi and alpha_p; so is 1 less what a leak or a low-pass
  forgets in a tick, and what the integrals take up of a fault in a tick, which gives alpha_i and alpha_f;
* a fault of the same size is an innovation pace^-2 as large: alpha_sm, alpha_sm0 and control.rate go with pace, eps with
  pace^-2, lead with pace^2. The noise of the estimate, sigma T^(1/2) pace^(5/2), goes with pace^(-1/2), and with it
  alpha_tau;
* a jump must stand out of the noise and of what a torque can do in a tick;
* the loop of control is slowed where its delay of a tick or two would count.
"""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxftc.config import Config
from jaxftc.decision_gains import shipped
from jaxftc.gains import Gains, blocks, build, shape_of, specs
from jaxftc.observer.readout import exact
from jaxftc.robot import dynamics, rigid_body

DT, NOISE = 1e-3, 3e-5  # s and rad that the numbers of ``gains`` are for
PUSH = 100.0  # rad/s^2 that a torque fault may give a joint at once; twice that is a jump
LARGEST = 5e-3  # rad, a jump however light a joint is: an encoder that shifts by half of it is called a motor
SLOWEST = 0.01, 0.005  # s, sample times from which on the loop and its boundary layer are slowed
# Where the arm is learned, what psi has yet to take up is hardly the model's error: it is compensated and judged as a fault.
ADAPTIVE = {"control": {"rate": 80.0, "speed_weight": 0.13}, "diagnosis": {"lead": 5000.0}}
MARGIN = 0.31  # of the integral gain at which the loop turns unstable, the share that the defaults take at 1 ms


Level = ArrayLike | tuple[float, ...]  # a number, or one a joint


def default_gains(config: Config, *, noise: Level | None = None, resolution: Level | None = None) -> Gains:
    """One set of gains that serves every scenario; the ARX read-out is the exact model of the nominal arm.

    Where the arm is learned by the complete cascade, actuator faults are compensated with a bandwidth of its own,
    ``control.rate``, and alarms come sooner by ``diagnosis.lead``: there the estimate is hardly the model's error.

    For ``input="torque"`` the read-out is that of an arm with the constant inertia it has in its zero position.

    Args:
        config: Robot and sample time.
        noise: rad, standard deviation of a reading, a number or [n]; 3e-5 if neither is given.
        resolution: rad, one count of the encoder, a number or [n]: 2 pi / 4096 for 12 bits.

    Raises:
        ValueError: noise or resolution is negative or not finite.
    """
    pace, sigma = _pace(config, _sigma(config, noise, resolution))
    values: dict[str, dict[str, Any]] = {block: {} for block in blocks(config)}
    for block, name, spec in specs(config):
        if spec.default is not None:
            values[block][name] = np.broadcast_to(spec.default, shape_of(config, spec))
    if config.adaptive and config.observer == "ts" and config.control == "afesmc":
        for block, own in ADAPTIVE.items():
            values[block] |= {name: np.full(config.n, value) for name, value in own.items()}
    for path, factor in _factors(config, values, pace, sigma).items():
        block, name = path.split(".")
        values[block][name] = values[block][name] * factor
    values["arx"] |= {name: np.zeros(shape_of(config, spec)) for _, name, spec in specs() if spec.default is None}
    values |= {"decision": dict(shipped(config.dt))} if config.decision == "learned" else {}
    return exact(config, build(config, values), None if config.input == "rigid_body" else np.linalg.inv(_inertia(config)))


def _sigma(config: Config, noise: Level | None, resolution: Level | None) -> np.ndarray:
    """Standard deviation of a reading [n] rad: noise, and a count's width as that of an even distribution."""
    parts = {"noise": (noise, 1.0), "resolution": (resolution, 1 / math.sqrt(12))}
    for name, (value, _) in parts.items():
        array = np.asarray(0.0 if value is None else value, float)
        if array.shape not in ((), (config.n,)) or not (np.isfinite(array) & (array >= 0)).all():
            raise ValueError(f"{name} must be a number of rad, at least 0, or {config.n} of them, got {value!r}")
    if noise is None and resolution is None:
        return np.full(config.n, NOISE)
    total = sum((np.asarray(value, float) * share) ** 2 for value, share in parts.values() if value is not None)
    return np.broadcast_to(np.sqrt(total), (config.n,))


def _pace(config: Config, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pace [n] of the observer over that at 1 ms and 3e-5 rad, and sigma over the latter [n]."""
    ratio = sigma / NOISE
    return np.minimum(1.0, np.maximum(ratio**2 * (config.dt / DT), 1e-12) ** (-1 / 6)), ratio


def _factors(config: Config, today: dict[str, dict[str, Any]], pace: np.ndarray, sigma: np.ndarray) -> dict[str, Any]:
    """What each number of ``gains`` is multiplied by; exactly 1 at 1 ms and 3e-5 rad."""
    ticks = pace * (config.dt / DT)  # of today's, in one of ours
    per_tick = (config.dt / DT) ** -2
    own = {name: today["observer"][name] for name in ("alpha_p", "alpha_i", "alpha_f1", "alpha_f3")}
    xi = today["arx"]["xi_a"]
    before, after = (_placed(xi, own, t) for t in (np.ones_like(ticks), ticks))
    slow, wait = (max(1.0, config.dt / limit) for limit in SLOWEST)
    factors: dict[str, Any] = {f"observer.{name}": after[name] / before[name] for name in own}
    factors |= {f"observer.{name}": factors[f"observer.{name}"] * per_tick for name in own if name != "alpha_p"}
    factors |= {f"arx.{name}": after["xi"] / before["xi"] for name in ("xi_a", "xi_b")}
    factors |= {f"observer.{name}": pace for name in ("alpha_sm", "alpha_sm0")}
    factors |= {"observer.eps": pace**-2, "diagnosis.lead": pace**2, "diagnosis.alpha_tau": pace**-0.5}
    factors["control.rate"] = pace
    factors["observer.jump"] = np.maximum(np.maximum(1.0, sigma), _pushed(config) / today["observer"]["jump"])
    for path in ("observer.leak", "diagnosis.leak_tau", "diagnosis.leak_q", "control.speed_weight", "baseline.speed_weight"):
        block, name = path.split(".")
        kept = 1 - today[block][name]
        factors[path] = (1 - kept**ticks) / (1 - kept)
    factors |= {"control.lam": 1 / slow, "baseline.kd": 1 / slow, "baseline.kp": slow**-2, "control.eps": wait}
    return factors | {"baseline.rate": pace, "diagnosis.rate": pace, "baseline.noise_y": np.maximum(sigma, 1e-3)}


def _pushed(config: Config) -> np.ndarray:
    """Jump [n] rad of which a torque fault makes no more than a half in a tick: half the torque limit, at least PUSH.

    It ends at LARGEST: on a joint without motor inertia the rule alone would leave no encoder fault to be seen.
    """
    limit = config.robot.acceleration_limit
    known = np.where(np.isfinite(limit), np.minimum(limit * config.dt**2, LARGEST), 0.0)
    return np.maximum(2 * PUSH * config.dt**2, known)


def _placed(xi: np.ndarray, own: dict[str, np.ndarray], ticks: np.ndarray) -> dict[str, np.ndarray]:
    """xi, alpha_p, and alpha_i and alpha_f times dt^2 per tick^2, after ``ticks`` of today's ticks in one.

    With w = z - 1 the innovation's poles solve w^2 + 2 alpha_p (1 - xi) w + alpha_p (1 - xi)^2 = 0 (observer/stability.py);
    psi takes up the share alpha dt^2 / (alpha_p (1 - xi)^2) of what is left of a fault in a tick, as long as that is slow.
    """
    alpha_p, c = own["alpha_p"], 1 - xi
    pole = (1 - alpha_p * c + 1j * c * np.sqrt(alpha_p - alpha_p**2)) ** ticks - 1
    size, half = np.abs(pole) ** 2, -pole.real  # alpha_p c^2, alpha_p c
    placed = {"xi": 1 - size / half, "alpha_p": half**2 / size}
    limit = placed["alpha_p"] ** 2 * (1 - placed["xi"]) ** 2 * (1 - placed["xi"] ** 2)  # stability.py
    unit = DT**2 / (alpha_p * c**2)
    taken = lambda alpha: size * (1 - (1 - unit * alpha) ** ticks)  # noqa: E731
    lone = np.minimum(taken(own["alpha_i"]), MARGIN / 2 * limit)
    for name in ("alpha_f1", "alpha_f3"):
        placed[name] = np.minimum(taken(own["alpha_i"] + own[name]), MARGIN * limit) - lone
    return placed | {"alpha_i": lone}


def _inertia(config: Config) -> np.ndarray:
    """M [n, n] kg m^2 of the nominal arm in its zero position."""
    mass = dynamics.nominal_mass(config.robot, rigid_body.pose(config.robot, jnp.asarray(config.robot.q_zero)))
    return np.array([[float(m) for m in row] for row in mass.rows])
