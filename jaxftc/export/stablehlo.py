"""The tick as StableHLO, by ``jax.export``: two files that any JAX of the next half year reads, and a loader for them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax import export

from jaxftc import checks
from jaxftc.export.tick import Tick, precision
from jaxftc.io.files import digest
from jaxftc.types import Measurement, Output, Reference

PLATFORMS = ("cpu", "cuda", "rocm", "tpu")
FILES = ("ftc_init.stablehlo", "ftc_step.stablehlo")
METADATA = "ftc.json"


def programs(tick: Tick) -> dict[str, bytes]:
    """Content of the files by name: functions of leaves, which ``ftc.json`` names in their order."""
    found = {}
    with precision(tick.real):
        for file, fun, arguments in zip(
            FILES, (tick.init, tick.step), (tick.init_arguments, tick.step_arguments), strict=True
        ):
            leaves, tree = jax.tree.flatten(arguments)
            flat = _flat(fun, tree)
            exported = export.export(jax.jit(flat), platforms=PLATFORMS)(*[jax.typeof(np.asarray(x)) for x in leaves])
            found[file] = bytes(exported.serialize())
    return found


def _flat(fun: Callable[..., Any], tree: Any) -> Callable[..., list[Any]]:
    return lambda *leaves: jax.tree.leaves(fun(*jax.tree.unflatten(tree, leaves)))


class Loaded:
    """``init`` and ``step`` of a folder that ``jaxftc export`` wrote, for JAX; the state is a list of arrays.

    Attributes:
        metadata: Joint names, sample time, limits, hash of the gains and the rest of ``ftc.json``.
        gains: Leaves of the gains in the order of ``metadata``, where they are an argument; to be changed between ticks.
    """

    def __init__(self, folder: Path, metadata: dict[str, Any]) -> None:
        self.metadata = metadata
        read = [export.deserialize(bytearray((folder / file).read_bytes())) for file in FILES]
        self.call_init, self.call_step = (exported.call for exported in read)  # of leaves, to be traced
        self._init, self._step = jax.jit(self.call_init), jax.jit(self.call_step)
        self._state, self._n = metadata["signals"]["state"], len(metadata["joint_names"])
        at_run_time = metadata["gains"] == "at run time"
        self.gains = [np.asarray(leaf["value"], self._dtype()) for leaf in metadata["signals"]["gains"] if at_run_time]

    def init(self, q: Any) -> list[jax.Array]:
        """State at rest in q [n] rad, holding the arm against gravity.

        Raises:
            ValueError: q has the wrong shape or is not finite.
        """
        q = checks.filled(q)
        checks.one_arm("q", q, self._n)
        checks.finite("q", q, "give the angles that the arm is at")
        with precision(self.metadata["real"]):
            return self._init(*self.gains, np.asarray(q, self._dtype()))

    def step(self, state: list[Any], reference: Reference, measurement: Measurement) -> tuple[list[jax.Array], Output]:
        """One tick: the next state, and what ``jaxftc.step`` says.

        Raises:
            ValueError: an argument is of another kind, or has the wrong shape.
        """
        checks.instance("reference", reference, Reference)
        checks.instance("measurement", measurement, Measurement)
        if measurement.tau is None:
            measurement = measurement._replace(tau=np.full(self._n, np.nan))
        given = {f"reference.{k}": x for k, x in reference._asdict().items()}
        given |= {f"measurement.{k}": x for k, x in measurement._asdict().items()}
        for name, value in given.items():
            checks.one_arm(name, value, self._n)
        self._check_state(state)
        with precision(self.metadata["real"]):
            signals = [np.asarray(checks.filled(x), self._dtype()) for x in given.values()]
            made = self._step(*self.gains, *state, *signals)
        return made[: len(state)], Output(*made[len(state) :])

    def _check_state(self, state: Any) -> None:
        wanted = f"state must be the list of {len(self._state)} arrays that init or step gave"
        if not isinstance(state, list | tuple):
            raise ValueError(f"{wanted}, got a {type(state).__name__}")
        if len(state) != len(self._state):
            raise ValueError(f"{wanted}, got {len(state)}")
        for k, (leaf, own) in enumerate(zip(state, self._state, strict=True)):
            came = list(np.shape(leaf))
            if came != own["shape"]:
                raise ValueError(f"{wanted}: number {k}, {own['name']}, has shape {own['shape']}, got {came}")

    def _dtype(self) -> Any:
        return np.float64 if self.metadata["real"] == "double" else np.float32


def load(folder: str | Path) -> Loaded:
    """The exported tick of a folder, for JAX.

    Raises:
        ValueError: the folder has none, or a file is not as it was written.
    """
    folder = Path(folder)
    try:
        metadata = json.loads((folder / METADATA).read_text(encoding="utf-8"))
        sums = {file: metadata["files"][file] for file in FILES}
        damaged = [file for file, sha256 in sums.items() if digest(folder / file) != sha256]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"no exported tick in {folder}: {error}; write one with jaxftc export --out {folder}") from error
    if damaged:
        raise ValueError(f"{folder / damaged[0]} is not as it was written; export again")
    return Loaded(folder, metadata)
