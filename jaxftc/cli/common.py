"""What the commands share: options, the run folder, robot and gains by name, JAX settings, atomic files."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from jaxftc.files import write_text

if TYPE_CHECKING:
    from jaxftc.arm.robot import Robot
    from jaxftc.config import Config
    from jaxftc.gains import Gains

MARK = ".jaxftc"  # in a folder of results: the command that made it
SEVERAL_RESULTS = "--xla_backend_extra_options=xla_cpu_use_multi_output_fusion=true"  # of a loop


@dataclasses.dataclass
class Options:
    """Options of every command that simulates and writes."""

    engine: Literal["mjx", "chain"] = "mjx"
    """Plant dynamics: MuJoCo MJX, or the unrolled chain (several times faster, same motion)."""
    robot: str = "puma560"
    """Built-in arm, or an MJCF or URDF file of a serial arm of hinges."""
    coulomb: bool = False
    """Give the PUMA 560 its Coulomb friction, in plant and model; the paper's conditions have none."""
    gains: Path | None = None
    """Gains file (TOML); the default gains if not given."""
    seed: int = 0
    """Seed of the encoder noise."""
    out: Path | None = None
    """Folder for the results; runs/<command>-<n> if not given."""
    json: bool = False
    """Print one JSON object on stdout and nothing else there."""
    cache: Annotated[bool, tyro.conf.arg(name="compilation-cache")] = True
    """Keep compiled programs between runs, in the user's cache folder."""


def say(options: Options, text: str = "") -> None:
    """Text for people: stdout, unless that is JSON's."""
    print(text, file=sys.stderr if options.json else sys.stdout)


def prepare(options: Options, *, many: bool = False, devices: bool = False) -> None:
    """Settings of JAX that a command may make: the persistent compilation cache, and XLA's log.

    ``many`` is for commands that run many scenarios side by side: it lets a loop on the CPU have several results, by a flag
    of XLA's that no compile option reaches. Programs for single arms take longer with it. ``devices`` makes each core a
    device, for commands that spread one program over them.
    XLA warns at length when a cached program was compiled with its own tuning hints, which no machine reports as features.
    """
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    flags = os.environ.get("XLA_FLAGS", "")  # read when JAX starts, so not to be changed later
    if many and "jax" not in sys.modules and "xla_backend_extra_options" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {SEVERAL_RESULTS}".strip()
    import jax

    if devices:
        from jaxftc.parallel import cores

        jax.config.update("jax_num_cpu_devices", cores())
    if options.cache:
        from jaxftc import kept

        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxftc"
        kept.folder = home / "programs"
        jax.config.update("jax_compilation_cache_dir", str(home / "xla"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


def key(options: Options) -> Any:
    """The random key that ``--seed`` names."""
    import jax

    if not 0 <= options.seed < 2**63:
        raise ValueError(f"--seed must lie in 0 to 2^63 - 1, got {options.seed}")
    return jax.random.key(options.seed)


def load_arm(options: Options) -> Robot:
    """The robot that ``--robot`` names."""
    from jaxftc import load_robot, puma560

    if options.robot != "puma560":
        if options.coulomb and not type(options).coulomb:  # asked for, not the command's default
            raise ValueError(
                "--coulomb is for the built-in arm; a robot file says its friction itself (user or frictionloss)"
            )
        return load_robot(options.robot)
    return puma560(coulomb=options.coulomb)


def load_or_default(options: Options, config: Config) -> Gains:
    """The gains that ``--gains`` names."""
    from jaxftc import default_gains, load_gains

    return default_gains(config) if options.gains is None else load_gains(options.gains, config)


def make_folder(options: Options, command: str) -> Path:
    """The folder for results, made and marked as the command's; the first free number if none was named.

    Raises:
        ValueError: the folder cannot be made or written, or holds what another command made.
    """
    try:
        folder = _numbered(command) if options.out is None else options.out
        folder.mkdir(parents=True, exist_ok=True)
        mark = folder / MARK
        made_by = mark.read_text(encoding="utf-8").strip() if mark.exists() else command
        if made_by == command:
            write_text(mark, command + "\n")
            return folder
    except OSError as error:
        raise ValueError(f"cannot write results: {error}; give another folder with --out") from error
    raise ValueError(f"{folder} holds what jaxftc {made_by} made; give another folder with --out")


def _numbered(command: str) -> Path:
    """A new folder in ``runs``, of the first number that is free."""
    number = 1
    while True:
        folder = Path("runs") / f"{command}-{number}"
        try:
            folder.mkdir(parents=True)
            return folder
        except FileExistsError:
            number += 1


def write_json(path: Path, value: dict[str, Any]) -> str:
    """Write a JSON file and return its text."""
    text = json.dumps(value, indent=2, allow_nan=False)
    write_text(path, text + "\n")
    return text
