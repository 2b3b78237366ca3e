"""The state of a tuning run between two rounds, as one file that is whole or not there."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import jax
import numpy as np

from jaxftc.compile import processes
from jaxftc.gains_file import header
from jaxftc.io.files import read_sealed, write_sealed
from jaxftc.scenarios.scenario import Scenario
from jaxftc.version import __version__
from tuning.descent import behaviour
from tuning.problem import Problem
from tuning.settings import Settings
from tuning.transform import Space

NAME = "checkpoint.npz"


def identity(
    problem: Problem,
    space: Space,
    training: Scenario,
    validation: Scenario,
    settings: Settings,
    limits: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, Any]:
    """What must be the same for a run to go on to the same result; the code of a user's own terms is not looked at."""
    config = problem.config
    return {
        "version": __version__,
        "config": header(config) | config.record,
        "settings": {field.name: _plain(field.name, settings) for field in dataclasses.fields(settings)},
        "limits": dict(limits),
        "free gains": [[f"{leaf.block}.{leaf.name}", list(leaf.shape)] for leaf in space.leaves],
        "objective": {name: term.weight for name, term in problem.objective.items()},
        "start": _digest(space.start),
        "scenarios": _digest((training, validation)),
        "key": _digest(jax.random.key_data(problem.key)),
        "machine": {"jax": jax.__version__, "devices": jax.device_count()},
    }


def _same_everywhere(identity: dict[str, Any]) -> None:
    """Refuse processes that were begun with different options or files; machines may draw scenarios a bit apart."""
    told = json.dumps({name: value for name, value in identity.items() if name != "scenarios"})
    theirs = json.loads(processes.from_first(told.encode()))
    other = [name for name, value in json.loads(told).items() if theirs[name] != value]
    if other:
        raise ValueError(
            f"process 0 has another {', '.join(other)} than this one; begin all with the same options and files"
        )


def write(path: Path, identity: dict[str, Any], arrays: dict[str, Any]) -> None:
    """Write the state and its checksum, whole or not at all."""
    data = io.BytesIO()
    np.savez(data, identity=np.array(json.dumps(identity)), **arrays)
    write_sealed(path, data.getvalue())


def read(path: Path | None, identity: dict[str, Any]) -> dict[str, np.ndarray] | None:
    """The state, or None where there is none; of several processes the first reads it.

    Raises:
        ValueError: the file is not a checkpoint as it was written, or of a run with other settings.
    """
    _same_everywhere(identity)
    try:
        data = processes.from_first(b"" if path is None or not path.exists() else read_sealed(path))
        if not data:
            return None
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = dict(file)
        found = json.loads(str(arrays.pop("identity")))
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise ValueError(f"{path} is no checkpoint of a tuning run ({error}); remove it to begin anew") from error
    other = [name for name in identity if found.get(name) != identity[name]]
    if other:
        changes = [
            f"{key} {theirs.get(key)!r}, here {ours[key]!r}"
            for name in other
            if isinstance(ours := identity[name], dict) and isinstance(theirs := found.get(name), dict)
            for key in ours
            if theirs.get(key) != ours[key]
        ]
        details = f" ({', '.join(changes)})" if changes else ""
        raise ValueError(
            f"{path} is of another run: its {', '.join(other)} differ{details}; "
            "go on with it under the same options, version and number of devices, or give another folder"
        )
    return arrays


def _plain(name: str, settings: Settings) -> Any:
    """A setting as JSON has it."""
    value = getattr(settings, name)
    if name == "optimizer":
        return behaviour(value, settings.steps)
    return list(value) if isinstance(value, tuple) else value


def _digest(tree: Any) -> str:
    digest = hashlib.sha256()
    for leaf in jax.tree.leaves(tree):
        digest.update(np.ascontiguousarray(leaf).tobytes())
    return digest.hexdigest()[:16]
