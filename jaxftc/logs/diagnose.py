"""What the controller would have said of a recorded log."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from scipy.signal import savgol_filter

from jaxftc.compile.xla import jit
from jaxftc.config import Config
from jaxftc.gains import Gains
from jaxftc.logs.log import Log
from jaxftc.schemes import registry
from jaxftc.types import Measurement, Output, Reference

SMOOTHING = 31  # readings that the speed of the motion is taken from


def diagnose(config: Config, gains: Gains, log: Log) -> Output:
    """What the controller would have said of a log, [T, n]; its own commands go nowhere.

    A log does not say which motion was wanted: the one that was made takes its place, smoothed; the friction model needs it.
    """
    window = {"window_length": SMOOTHING, "polyorder": 3, "axis": 0, "delta": config.dt}
    motion = [savgol_filter(np.asarray(log.q), deriv=d, **window) for d in range(3)]
    dtype = gains.arx.xi_a.dtype
    reference = Reference(*(jnp.asarray(x, dtype) for x in motion))
    q, tau = jnp.asarray(log.q, dtype), jnp.asarray(log.tau, dtype)
    before = jnp.full_like(tau[:1], jnp.nan)  # unknown: the arm was at rest, held as the controller itself would hold it
    return _diagnose(config, gains, reference, Measurement(q, jnp.concatenate([before, tau[:-1]])))


def _diagnose(config: Config, gains: Gains, reference: Reference, measurement: Measurement) -> Output:
    def body(state, told):
        return registry.step(config, gains, state, *told)

    return jax.lax.scan(body, registry.init(config, gains, measurement.q[0]), (reference, measurement))[1]


_diagnose = jit(_diagnose, static_argnums=0)
