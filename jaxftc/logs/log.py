"""A recorded motion, what is refused of it, and the model's input made from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc import checks
from jaxftc.compile.jit import jit
from jaxftc.config import Config
from jaxftc.robot import dynamics
from jaxftc.types import Array

if TYPE_CHECKING:
    from jaxftc.simulation.closed_loop import Trace

LEAST_TICKS = 100
LEAST_TRAVEL = 0.01  # rad, some hundred times the noise of an encoder
REST_TICKS, REST_SPEED = 10, 0.15  # ticks that the speed at the start is taken from, and rad/s that still pass as rest


class Log(NamedTuple):
    """A recorded motion at even times, time first; ``read`` makes it from a file."""

    q: np.ndarray | Array  # [T, n] rad, encoder
    tau: np.ndarray | Array  # [T, n] N m, commanded in the tick of the reading and held until the next; NaN: not recorded
    t: np.ndarray | None = None  # [T] s, from the file's first row; jumps between segments
    dt: float | None = None  # s, sample time; None: that of the config that it is used with
    segments: tuple[tuple[int, int], ...] = ()  # [start, stop) of stretches without a gap; none: all is one stretch
    notes: tuple[str, ...] = ()  # what was found and repaired in the file, one line each
    unit: str = "N m"  # of tau; another ("A", "%") where the torque for one is not known
    jitter: np.ndarray | None = None  # [T] s, by which the time between readings may be wrong; None: by nothing
    degrees: bool = False  # the file has its angles in degrees; q is in rad all the same
    rest: float = 0.0  # s, from the last tick to the file's last row

    @property
    def stretches(self) -> tuple[tuple[int, int], ...]:
        """[start, stop) of every stretch without a gap."""
        return self.segments or ((0, len(self.q)),)

    @property
    def sample_time(self) -> float:
        """Sample time in s, where no config has it.

        Raises:
            ValueError: the log does not say it.
        """
        if self.dt is None:
            raise ValueError("the log has no sample time; give it, Log(q, tau, dt=...) in s")
        return self.dt

    @property
    def has_torque(self) -> bool:
        """Whether torques were recorded."""
        return bool(np.isfinite(np.asarray(self.tau)).all())


def from_trace(trace: Trace) -> Log:
    """Log of one simulated run: readings and commands, as a robot would record them; no true value is used.

    A fault in the run is identified as part of the arm: take a healthy one.

    Args:
        trace: Of ``simulate``, one scenario.

    Returns:
        Readings and commands of that run.

    Raises:
        ValueError: the trace has scenario axes.
    """
    if np.ndim(trace.y) != 2:
        raise ValueError(
            f"trace must be of one run, [T, n], got y of shape {np.shape(trace.y)}; "
            "take one scenario of it: jax.tree.map(lambda x: x[i], trace)"
        )
    return Log(np.asarray(trace.y), np.asarray(trace.out.tau))


def check_log(config: Config, log: Log, *, moving: bool = True) -> Log:
    """The log in float64, or a refusal; ``moving`` asks that every joint moved.

    Raises:
        ValueError: a wrong shape, too few ticks, a value that is not finite, a start in motion, or a joint that stood still.
    """
    checks.instance("config", config, Config)
    checks.instance("log", log, Log)
    q, tau = (np.asarray(checks.filled(signal), float) for signal in (log.q, log.tau))
    for name, value in (("q", q), ("tau", tau)):
        if value.ndim != 2 or value.shape[1] != config.n or value.shape != q.shape:
            raise ValueError(
                f"log.q and log.tau must both be [T, {config.n}], ticks first, got shapes {q.shape} and {tau.shape}"
            )
        bad = np.argwhere(~np.isfinite(value))
        if len(bad):
            raise ValueError(
                f"log.{name} holds {len(bad)} values that are not finite, the first at tick {bad[0][0]} of joint "
                f"{bad[0][1] + 1}; cut the log there, or interpolate single dropouts"
            )
    if len(q) < LEAST_TICKS:
        raise ValueError(f"log must have at least {LEAST_TICKS} ticks, got {len(q)}; record a longer motion")
    speed = np.polyfit(config.dt * np.arange(REST_TICKS), q[:REST_TICKS], 2)[1]
    if np.abs(speed).max() > REST_SPEED:
        raise ValueError(
            f"log must start with the arm at rest, got {np.abs(speed).max():.3g} rad/s in joint "
            f"{np.abs(speed).argmax() + 1}; at most {REST_SPEED} rad/s pass, so begin the log before the motion does"
        )
    travel = np.ptp(q, axis=0)
    if moving and travel.min() < LEAST_TRAVEL:
        raise ValueError(
            f"joint {travel.argmin() + 1} ({config.robot.joint_names[travel.argmin()]}) moved by {travel.min():.3g} rad in "
            f"the log; at least {LEAST_TRAVEL} rad is needed to identify it, so record a motion of every joint"
        )
    return log._replace(q=q, tau=tau)


def model_input(config: Config, log: Log, half_window: int = 5) -> np.ndarray:
    """What drives the ARX model, u [T, n]: the torques themselves, or for ``rigid_body`` an acceleration v, rad/s^2.

    v = M^-1 (tau - h - D qd - f_c), Eqs. (2), (3), of the nominal arm at the measured angle. The speed is the slope of the
    straight line through the 2 ``half_window`` readings around the middle of the tick before: offline the readings to come
    are there to use, so nothing lags. Ten readings bring an encoder's 3e-5 rad down from 0.04 to 0.003 rad/s at 1 kHz and
    cost 2.4 dt^2 of the jerk; ``half_window=1`` is the plain difference, exact on a log without noise. Viscous friction
    acts at the mean speed of the interval in which tau is held (the implicit term dt D), as in the plant's integration: at
    the speed of the reading, 0.2 % of v and a degree of free run after a second would be lost.

    Raises:
        ValueError: the log is refused (``check_log``), or half_window is below 1.
    """
    checks.integer("half_window", half_window, 1, "1 is the difference of two readings")
    log = check_log(config, log, moving=False)
    if config.input == "torque":
        return np.asarray(log.tau)
    steps = np.arange(-half_window, half_window) + 0.5
    weights = steps / (steps @ steps) / config.dt
    tail = 2 * log.q[-1] - log.q[-half_window - 1 : -1][::-1]  # the motion goes on past the last reading
    padded = np.concatenate([np.repeat(log.q[:1], half_window, axis=0), log.q, tail])
    qd = np.stack([np.convolve(column, weights[::-1], "valid") for column in padded.T])[:, : len(log.q)]
    with jax.enable_x64(True):
        return np.asarray(_acceleration(config, jnp.asarray(log.q.T), jnp.asarray(qd), jnp.asarray(log.tau.T))).T


def _acceleration(config: Config, q: Array, qd: Array, tau: Array) -> Array:
    return dynamics.acceleration(config.robot, "chain", dynamics.nominal_plant(config.robot), q, qd, tau, config.dt)


_acceleration = jit(_acceleration, static_argnums=0)
