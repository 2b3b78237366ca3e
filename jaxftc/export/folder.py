"""A folder with an exported tick: C code, StableHLO, the gains, an example, and what they belong to."""

from __future__ import annotations

import json
import re
from importlib import resources
from pathlib import Path
from typing import Any

import jax

from jaxftc.config import Config
from jaxftc.export.c import source
from jaxftc.export.stablehlo import FILES, METADATA, programs
from jaxftc.export.tick import Real, Tick, tick
from jaxftc.gains import Gains
from jaxftc.gains_file import save_gains
from jaxftc.io.files import atomic_path, digest, write_text
from jaxftc.numerics.decimals import decimals

GAINS, EXAMPLE = "gains.toml", "example.c"


def write(config: Config, gains: Gains, out: str | Path, *, real: Real = "double", gains_at_run_time: bool = False) -> Tick:
    """Write the tick of a config and its gains to a folder: ``ftc_step.h``, ``ftc_step.c`` and what goes with them.

    Args:
        config: Robot, scheme and sample time.
        gains: The gains, without scenario axes; all of them are constants of the code, or its first values.
        out: A folder, made if need be; files of the same names are replaced.
        real: Precision of the code, ``double`` or ``float``.
        gains_at_run_time: Make the gains an argument of the code, a struct, in place of constants.

    Returns:
        What was exported.

    Raises:
        ValueError: gains that do not fit the config, or a scheme that does what C code is not written for.
    """
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    save_gains(folder / GAINS, gains, config)
    made = tick(config, gains, real=real, gains_hash=digest(folder / GAINS), at_run_time=gains_at_run_time)
    example = (resources.files("jaxftc.export") / EXAMPLE).read_text(encoding="utf-8")
    if gains_at_run_time:
        example = re.sub(r"(ftc_init|ftc_step)\(&state, ", r"\1(&state, &ftc_default_gains, ", example)
    texts = source(made) | {EXAMPLE: example}
    for name, text in texts.items():
        write_text(folder / name, text)
    for name, data in programs(made).items():
        with atomic_path(folder / name) as temporary:
            temporary.write_bytes(data)
    names = [GAINS, *texts, *FILES]
    metadata = made.metadata | {"signals": _signals(made), "files": {name: digest(folder / name) for name in names}}
    write_text(folder / METADATA, json.dumps(metadata, indent=2, allow_nan=False) + "\n")
    return made


def _signals(made: Tick) -> dict[str, list[dict[str, Any]]]:
    """Leaves of every signal in the order of the StableHLO functions' arguments and results; of the gains with values."""
    found = {}
    for signal, leaves in made.leaves().items():
        rows = [{"name": x.name, "shape": list(x.shape), "dtype": x.dtype.name, "about": x.about} for x in leaves]
        if signal == "gains":
            values = [decimals(leaf).tolist() for leaf in jax.tree.leaves(made.gains)]
            rows = [row | {"value": value} for row, value in zip(rows, values, strict=True)]
        found[signal] = rows
    return found
