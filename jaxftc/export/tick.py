"""What is exported: ``init`` and ``step`` as functions of flat arrays, the names of those, and what they belong to."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.config import Config
from jaxftc.gains import Gains, specs
from jaxftc.gains_file import header, made_for
from jaxftc.numerics.decimals import decimals
from jaxftc.schemes import registry
from jaxftc.types import Measurement, Output, Reference
from jaxftc.version import __version__

Real = Literal["double", "float"]
DTYPES: dict[Real, Any] = {"double": np.float64, "float": np.float32}


class Leaf(NamedTuple):
    """One array of a signal."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype
    about: str  # unit and meaning


class Tick(NamedTuple):
    """``init`` and ``step`` of one config and its gains, in one precision; trace and call under ``precision(real)``."""

    config: Config
    real: Real
    gains: Gains  # in that precision
    at_run_time: bool  # whether the gains are an argument, not constants
    state: Any  # an example, pytree
    metadata: dict[str, Any]

    @property
    def init_arguments(self) -> tuple[Any, ...]:
        """Examples of what ``init`` takes."""
        return (*self._gains(), self._zeros())

    @property
    def step_arguments(self) -> tuple[Any, ...]:
        """Examples of what ``step`` takes."""
        zero = self._zeros()
        return (*self._gains(), self.state, Reference(zero, zero, zero), Measurement(zero, zero))

    def init(self, *arguments: Any) -> Any:
        """State at rest: of the gains, where they are an argument, and q [n] rad."""
        gains, q = arguments if self.at_run_time else (self.gains, *arguments)
        return registry.init(self.config, gains, q)

    def step(self, *arguments: Any) -> tuple[Any, Output]:
        """One tick: of the gains, where they are an argument, the state, the reference and the measurement."""
        gains, *others = arguments if self.at_run_time else (self.gains, *arguments)
        return registry.step(self.config, gains, *others)

    def _gains(self) -> tuple[Gains, ...]:
        return (self.gains,) if self.at_run_time else ()

    def _zeros(self) -> Any:
        return np.zeros(self.config.n, DTYPES[self.real])

    def leaves(self) -> dict[str, list[Leaf]]:
        """Arrays of every signal, in JAX's order, by signal."""
        with precision(self.real):
            out = jax.eval_shape(self.step, *self.step_arguments)[1]
        _, reference, measurement = self.step_arguments[-3:]
        units = {f"{block}_{name}": f"[{', '.join(s.axes)}] {s.unit}, {s.doc}" for block, name, s in specs(self.gains)}
        return {
            "state": _leaves(self.state, {}),
            "reference": _leaves(reference, _attributes(Reference)),
            "measurement": _leaves(measurement, _attributes(Measurement)),
            "out": _leaves(out, _attributes(Output)),
            "gains": _leaves(self.gains, units),
        }


def precision(real: Real) -> Any:
    """Where JAX computes in one precision."""
    return jax.enable_x64(real == "double")


def tick(
    config: Config, gains: Gains, *, real: Real = "double", gains_hash: str | None = None, at_run_time: bool = False
) -> Tick:
    """What is to be exported; ``gains_hash`` is that of the gains' file."""
    with precision(real):
        own = jax.tree.map(lambda leaf: jnp.asarray(decimals(leaf), DTYPES[real]), gains)
        state = registry.init(config, own, jnp.asarray(config.robot.q_zero, DTYPES[real]))
    limits = [float(x) if np.isfinite(x) else None for x in config.robot.torque_limit]
    metadata = (
        header(config)
        | made_for(config)
        | {
            "jaxftc": __version__,
            "joint_names": list(config.robot.joint_names),
            "torque_limit_nm": limits,
            "control": config.control,
            "decision": config.decision,
            "real": real,
            "gains": "at run time" if at_run_time else "constants",
            "gains_sha256": gains_hash,
        }
    )
    return Tick(config, real, own, at_run_time, state, metadata)


def _leaves(tree: Any, about: dict[str, str]) -> list[Leaf]:
    found = []
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        name = "_".join(re.findall(r"\w+", jax.tree_util.keystr(path)))
        found.append(Leaf(name, tuple(leaf.shape), np.dtype(leaf.dtype), about.get(name, "")))
    return found


def _attributes(signal: Callable[..., Any]) -> dict[str, str]:
    """What the docstring of a signal says of its fields."""
    text = (inspect.getdoc(signal) or "").partition("Attributes:")[2]
    return {
        name: " ".join(about.split()).rstrip(".") for name, about in re.findall(r"^ {4}(\w+): ((?:.|\n {5,})+)", text, re.M)
    }
