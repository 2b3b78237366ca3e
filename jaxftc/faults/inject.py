"""Faults between a controller and any simulator: what they do to a command and to a reading.

``init``, ``deliver`` and ``read`` are pure functions of JAX. ``Injector`` keeps the state, and takes and gives NumPy arrays
in double precision. Commands have the shape [..., n], readings [..., m]; leading axes are runs side by side. The units are
the simulator's: what ``jaxftc.scenarios.faults`` has in N m and rad is in the unit of the command and of the reading here.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxftc import checks
from jaxftc.numerics.decimals import decimals
from jaxftc.scenarios import builders
from jaxftc.scenarios.faults import Fault, no_fault
from jaxftc.simulation import fault_injection
from jaxftc.simulation.fault_injection import State
from jaxftc.types import Array

MOTION_UNKNOWN = fault_injection.Motion(0.0, 0.0, 1.0, 1.0)  # kinds that need to know how the arm moves are not offered here


class Faults(NamedTuple):
    """Faults of one run or of many; ``with_...`` adds one (``jaxftc.scenarios.builders``), joints being entries, from 1.

    Attributes:
        fault_tau: [..., n] each, of the commands.
        fault_q: [..., m] each, of the readings.
    """

    fault_tau: Fault
    fault_q: Fault

    @property
    def id(self) -> np.ndarray:
        """Numbers of the runs, which tell builders how many there are."""
        return np.zeros(np.shape(self.fault_tau.onset)[:-1], int)

    with_actuator_bias = builders.with_actuator_bias
    with_actuator_loss = builders.with_actuator_loss
    with_actuator_saturation = builders.with_actuator_saturation
    with_stuck_actuator = builders.with_stuck_actuator
    with_actuator_gain = builders.with_actuator_gain
    with_actuator_delay = builders.with_actuator_delay
    with_encoder_bias = builders.with_encoder_bias
    with_encoder_drift = builders.with_encoder_drift
    with_encoder_scale = builders.with_encoder_scale
    with_encoder_noise = builders.with_encoder_noise
    with_frozen_encoder = builders.with_frozen_encoder
    with_encoder_dropout = builders.with_encoder_dropout
    with_encoder_rounding = builders.with_encoder_rounding
    with_encoder_wrap = builders.with_encoder_wrap
    with_encoder_delay = builders.with_encoder_delay


def healthy(commands: int, readings: int | None = None, *, runs: int | None = None) -> Faults:
    """No fault.

    Args:
        commands: Entries of a command.
        readings: Entries of a reading; as many if None.
        runs: Runs side by side, on a leading axis; a single one without that axis if None.

    Raises:
        ValueError: a number is not a positive integer.
    """
    readings = commands if readings is None else readings
    for name, count in (("commands", commands), ("readings", readings), ("runs", 1 if runs is None else runs)):
        checks.integer(name, count, 1, "it is how many there are")
    found = Faults(no_fault(commands), no_fault(readings))
    axes = () if runs is None else (runs,)
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (*axes, *leaf.shape)), found)


def init(command: ArrayLike, reading: ArrayLike) -> State:
    """State of a run that begins with a command [..., n] and a reading [..., m]: what a stuck motor or encoder keeps."""
    command = jnp.asarray(command)
    return fault_injection.init(command, jnp.asarray(reading), jnp.zeros_like(command))


def deliver(
    faults: Faults, state: State, t: ArrayLike, command: ArrayLike, limit: ArrayLike = jnp.inf
) -> tuple[State, Array]:
    """What reaches the simulator.

    Args:
        faults: Of this run, or of runs side by side.
        state: Of the last call.
        t: s, one or [...] a run.
        command: [..., n].
        limit: [n], largest command, for faults that leave a share of it.

    Returns:
        The state, and [..., n].
    """
    command = jnp.asarray(command)
    limits = jnp.broadcast_to(jnp.asarray(limit, command.dtype), command.shape)
    return fault_injection.deliver(faults.fault_tau, state, _time(t), command, limits, MOTION_UNKNOWN)


def read(
    faults: Faults, state: State, t: ArrayLike, reading: ArrayLike, noise: ArrayLike = 0.0
) -> tuple[State, Array, Array]:
    """What reaches the controller.

    Args:
        faults: Of this run, or of runs side by side.
        state: Of the last call.
        t: s, one or [...] a run.
        reading: [..., m], without the sensors' noise.
        noise: [..., m], that noise; a fault can make it larger.

    Returns:
        The state, [..., m] with nan where a sensor gives nothing, and the part of it that is the fault's.
    """
    reading = jnp.asarray(reading)
    return fault_injection.read(
        faults.fault_q, state, _time(t), reading, jnp.broadcast_to(jnp.asarray(noise, reading.dtype), reading.shape)
    )


def _time(t: ArrayLike) -> Array:
    """Time [...] s with an axis for the joints."""
    return jnp.asarray(t)[..., None]


_deliver, _read = jax.jit(deliver), jax.jit(read)


class Injector:
    """The faults of one simulation, or of many side by side; NumPy in and out.

    Args:
        faults: What is to happen.
        limit: [n], largest command, for faults that leave a share of it.

    Attributes:
        command_error: [..., n], what the faults added to the last command.
        reading_error: [..., m], what they added to the last reading; 0 where there was none.
    """

    def __init__(self, faults: Faults, *, limit: ArrayLike = np.inf) -> None:
        checks.instance("faults", faults, Faults)
        meant = lambda leaf: decimals(leaf) if np.issubdtype(leaf.dtype, np.floating) else leaf  # noqa: E731
        self.faults, self.limit = jax.tree.map(meant, faults), limit  # an onset of 0.1 is a time of 0.1
        self.command_error, self.reading_error = (np.zeros(np.shape(fault.onset)) for fault in faults)
        self._commanded: State | None = None  # what faults of commands remember
        self._read: State | None = None  # and of readings

    def command(self, t: ArrayLike, command: ArrayLike) -> np.ndarray:
        """What reaches the simulator of a command [..., n] at t s.

        Raises:
            ValueError: the command has not the shape of the faults.
        """
        own = self._whole("command", command, self.command_error)
        with jax.enable_x64(True):
            state = self._commanded or init(own, own)
            self._commanded, delivered = _deliver(self.faults, state, t, own, self.limit)
        found = np.asarray(delivered)
        self.command_error = found - own
        return found

    def reading(self, t: ArrayLike, reading: ArrayLike, noise: ArrayLike = 0.0) -> np.ndarray:
        """What reaches the controller of a reading [..., m] at t s, nan where a sensor gives nothing.

        Raises:
            ValueError: the reading has not the shape of the faults.
        """
        own = self._whole("reading", reading, self.reading_error)
        with jax.enable_x64(True):
            self._read, found, error = _read(self.faults, self._read or init(own, own), t, own, noise)
        self.reading_error = np.asarray(error)
        return np.asarray(found)

    def _whole(self, name: str, value: ArrayLike, like: np.ndarray) -> np.ndarray:
        array = np.asarray(value, float)
        if array.shape != like.shape:
            raise ValueError(f"{name} must have the shape of its faults, {list(like.shape)}, got {list(array.shape)}")
        return array
