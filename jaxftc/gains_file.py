"""Gains to and from a TOML file that says what each number is."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from jaxftc import variants
from jaxftc.config import Config
from jaxftc.decision_gains import shipped
from jaxftc.gains import Gains, Spec, blocks, build, specs
from jaxftc.io.files import write_text
from jaxftc.io.toml import read_toml
from jaxftc.numerics.decimals import decimals
from jaxftc.version import __version__

DIAGNOSER = "diagnoser"  # in place of a scheme: thresholds of jaxftc.Diagnoser


def save_gains(path: str | Path, gains: Gains, config: Config | None = None, *, scheme: str | None = None) -> None:
    """Write gains with their units to a TOML file, whole or not at all.

    Args:
        path: The file.
        gains: One set, without scenario axes.
        config: What they belong to, if it is to be in the file: robot, time step and structure.
        scheme: Whose thresholds they are, if not the config's: ``diagnoser`` for those of ``Diagnoser``.

    Raises:
        ValueError: the gains have scenario axes.
    """
    table: dict[str, Any] = {"made_with": {"jaxftc": __version__}}
    if config is not None:
        table["made_with"] |= header(config) | made_for(config, scheme)
    for block, name, spec in specs(gains):
        value = np.asarray(getattr(getattr(gains, block), name))
        if value.ndim > len(spec.axes):
            raise ValueError(f"{block}.{name} must be one set of gains, {list(spec.axes)}, got shape {list(value.shape)}")
        table.setdefault(block, {})[name] = {"unit": spec.unit, "value": decimals(value).tolist()}
    write_text(Path(path), tomli_w.dumps(table))


def load_gains(path: str | Path, config: Config) -> Gains:
    """Read gains from a TOML file written by ``save_gains``; every gain must be there and nothing else.

    Gains serve every scheme, but thresholds that were calibrated hold for the one that they were calibrated for alone.

    Args:
        path: The file.
        config: The robot, time step and structure that they are wanted for.

    Returns:
        The gains.

    Raises:
        ValueError: unreadable file, unknown or missing gain, wrong unit, wrong shape, or gains of another robot or orders.
    """
    return load_and_doubt(path, config)[0]


def load_and_doubt(path: str | Path, config: Config, scheme: str | None = None) -> tuple[Gains, str | None]:
    """Gains as ``load_gains`` reads them, and what to know where their thresholds may be of another scheme.

    ``scheme`` is whose thresholds are wanted, if not the config's. Of one that judges nothing there is nothing to know.
    """
    table = read_toml(path, "gains")
    strays = [key for key, entries in table.items() if not isinstance(entries, dict)]
    if strays:
        raise ValueError(
            f"{path}: {strays[0]!r} must be a table of gains, got {table[strays[0]]!r}; write it with save_gains"
        )
    made_with = table.pop("made_with", {})
    _check_made_with(path, made_with, config)
    return _read(path, table, made_with, config), _doubt(path, made_with, config, scheme)


def sample_time(path: str | Path) -> float | None:
    """Sample time in s that the gains of a file belong to, if the file says it.

    Raises:
        ValueError: the file cannot be read.
    """
    made_with = read_toml(path, "gains").get("made_with")
    dt = made_with.get("dt") if isinstance(made_with, dict) else None
    return float(dt) if isinstance(dt, float) and dt > 0 else None


def header(config: Config) -> dict[str, Any]:
    """What gains belong to."""
    return {
        "robot": config.robot.name,
        "robot_fingerprint": config.robot.fingerprint,
        "dt": config.dt,
        "order_a": config.order_a,
        "order_b": config.order_b,
        "input": config.input,
    }


def made_for(config: Config, scheme: str | None = None) -> dict[str, Any]:
    """What thresholds belong to, beside the rest: the config's scheme, or ``DIAGNOSER``."""
    if scheme == DIAGNOSER:
        return {"scheme": scheme}
    return {"scheme": config.scheme, "observer": config.observer, "adaptive": config.adaptive}


def _check_made_with(path: str | Path, made_with: dict[str, Any], config: Config) -> None:
    """Refuse gains that belong to another arm, sample time or structure."""
    ours = header(config)
    other = [f"{k} {v!r}, here {ours[k]!r}" for k, v in made_with.items() if k in ours and v != ours[k]]
    if not other:
        return
    arms = {str(made_with.get("robot")), ours["robot"]}
    friction = len(arms) == 2 and all(arm.startswith("puma560") for arm in arms)
    hint = ": --coulomb or puma560(coulomb=True) is the arm with dry friction" if friction else ""
    raise ValueError(f"{path} holds gains for another {'; another '.join(other)}; use the config they were made with{hint}")


def _doubt(path: str | Path, made_with: dict[str, Any], config: Config, scheme: str | None) -> str | None:
    ours = made_for(config, scheme)
    theirs = {k: made_with.get(k, v) for k, v in ours.items()}
    if theirs == ours or (scheme is None and not variants.load(config.scheme).DIAGNOSES):
        return None
    other, here = (", ".join(f"{k} {v}" for k, v in one.items()) for one in (theirs, ours))
    return (
        f"{path} was made with {other}; here {here}. Thresholds that were calibrated there do not hold here: set them with "
        "jaxftc calibrate"
    )


def _read(path: str | Path, table: dict[str, Any], made_with: dict[str, Any], config: Config) -> Gains:
    if made_with.get("scheme", config.scheme) != config.scheme:
        table.pop("own", None)  # another scheme's; all else in the file serves every scheme
    weights = table.pop("decision", None)  # a file without them is for any decision
    known = {(block, name): spec for block, name, spec in specs(config)}
    values: dict[str, dict[str, Any]] = {block: {} for block in blocks(config)}
    for block, entries in table.items():
        for name, entry in entries.items():
            values[block][name] = _read_entry(path, f"{block}.{name}", entry, known.get((block, name)), known)
    if config.decision == "learned":
        values["decision"] = dict(shipped(config.dt)) if weights is None else _weights(path, weights, known)
    missing = [f"{block}.{name}" for block, name in known if name not in values[block]]
    if missing:
        raise ValueError(f"{path} lacks {', '.join(missing)}; write it with save_gains")
    try:
        return build(config, values)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _weights(path: str | Path, entries: dict[str, Any], known: dict[tuple[str, str], Spec]) -> dict[str, np.ndarray]:
    return {n: _read_entry(path, f"decision.{n}", entry, known.get(("decision", n)), known) for n, entry in entries.items()}


def _read_entry(
    path: str | Path, name: str, entry: Any, spec: Spec | None, known: dict[tuple[str, str], Spec]
) -> np.ndarray:
    if spec is None:
        near = difflib.get_close_matches(name, [".".join(k) for k in known], n=1)
        raise ValueError(f"{path}: unknown gain {name!r}" + (f"; did you mean {near[0]!r}?" if near else ""))
    if not isinstance(entry, dict) or set(entry) != {"unit", "value"} or entry["unit"] != spec.unit:
        raise ValueError(f"{path}: {name} must be a table of unit = {spec.unit!r} and value, got {entry!r}")
    try:
        value = np.asarray(entry["value"])
        if value.dtype == bool:
            raise TypeError("a truth value is no number")
        return value.astype(float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {name} must hold numbers, got {entry['value']!r}") from error
