"""What the commands share: options, robot and gains by name, settings of JAX."""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from jaxftc.variants import variants

if TYPE_CHECKING:
    from jaxftc.config import Config
    from jaxftc.gains import Gains
    from jaxftc.robot.arm_table import Arm
    from jaxftc.robot.model import Robot
    from jaxftc.scenarios.preset import Preset


def left_out(value: str) -> Any:
    """Of an option that is left out by default: the help names its ``value``, and no ``None`` as the default."""
    return tyro.conf.arg(metavar=value, help_behavior_hint="")


MaybePath = Annotated[Path | None, left_out("PATH")]
MaybeNumber = Annotated[float | None, left_out("NUMBER")]
MaybeInteger = Annotated[int | None, left_out("INTEGER")]
MaybeName = Annotated[str | None, left_out("NAME")]
Names = Annotated[tuple[str, ...], left_out("NAME ...")]
Poses = Annotated[tuple[str, ...], left_out("JOINT=POSITION ...")]
Scheme = Annotated[str, tyro.conf.arg(help=f"{', '.join(variants())}, or your own, module:object (docs/campaigns.md).")]
MANY_OBJECTS = (100_000, 20, 20)  # gc.set_threshold: tracing makes young objects by the million, none of them garbage


@dataclasses.dataclass
class Output:
    """Options of every command that writes results."""

    out: MaybePath = None
    """Folder for the results; a new one, runs/<command>-<n>, if not given."""
    json: bool = False
    """Print one JSON object on stdout and nothing else there."""
    force: bool = False
    """Start over in a folder that holds another result or other files; files of the same names are replaced."""
    cache: Annotated[bool, tyro.conf.arg(name="compilation-cache")] = True
    """Keep compiled programs in ~/.cache/jaxftc for later runs."""
    words: tyro.conf.Suppress[tuple[str, ...]] = ()
    """The command line, as it was given."""


@dataclasses.dataclass
class ArmOptions(Output):
    """Options of every command that takes an arm."""

    robot: str = "puma560"
    """Built-in arm, an MJCF or URDF file, or an arm's own file (arm.toml, or the folder that it is in)."""
    tip: MaybeName = None
    """Link, site or joint at which the arm ends, where the file holds more than one arm."""
    lock: Poses = ()
    """Joints to weld, each with its position in rad or m, such as gripper=0.5."""


@dataclasses.dataclass
class Options(ArmOptions):
    """Options of every command that simulates."""

    engine: Literal["mjx", "chain"] = "mjx"
    """Simulated arm: MuJoCo MJX, or recursions unrolled from its model (several times faster, same motion)."""
    coulomb: bool = False
    """Give the PUMA 560 its Coulomb friction, in plant and model; the paper's conditions have none."""
    gains: MaybePath = None
    """Gains file (TOML); the default gains if not given."""
    dt: MaybeNumber = None
    """Sample time of the controller, s; 0.001 if not given."""
    seed: int = 0
    """Seed of the encoder noise."""


def say(options: Output, text: str = "") -> None:
    """Text for people: stdout, unless that is JSON's."""
    print(text, file=sys.stderr if options.json else sys.stdout, flush=True)


def _import_mujoco() -> None:
    """Without its search for a window system: that is a process of its own, which goes on when this one is stopped."""
    known = "MUJOCO_GL" in os.environ
    os.environ.setdefault("MUJOCO_GL", "disable")
    import mujoco  # noqa: F401

    if not known:
        del os.environ["MUJOCO_GL"]


def quiet_xla() -> None:
    """Leave out what XLA logs, before JAX is imported.

    It warns at length when a cached program was compiled with its own tuning hints, which no machine reports as features.
    """
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")


def prepare(
    options: Output,
    *,
    many: bool = False,
    devices: bool = False,
    engine: str | None = None,
    platform: str | None = None,
) -> None:
    """Settings that a command may make of its process: XLA's flags and log, the compilation cache, the garbage collector.

    ``many`` is for commands that run many scenarios side by side: ``configure_xla``. Programs for single arms take longer to
    compile with it. ``engine`` is what they run on, if not the options'. ``devices`` makes each core a device, for commands
    that spread one program over them. ``platform`` is where JAX runs, if not where it would.
    """
    quiet_xla()
    gc.set_threshold(*MANY_OBJECTS)
    _import_mujoco()
    import jax

    if platform is not None:
        jax.config.update("jax_platforms", platform)
    if devices:
        from jaxftc.compile.devices import cores

        jax.config.update("jax_num_cpu_devices", cores())
    if many:
        from jaxftc.compile.xla import configure_xla

        engine = engine or (options.engine if isinstance(options, Options) else "chain")
        with contextlib.suppress(RuntimeError):  # a process that has used JAX already keeps the flags that it has
            configure_xla(several_results=True if engine == "chain" else None)
    if options.cache:
        from jaxftc.compile import program_cache

        program_cache.keep()


def look_here_for(scheme: str) -> None:
    """Let Python find a scheme of the user's in the folder that the command is given in, after all other places."""
    if scheme not in variants() and "" not in sys.path:
        sys.path.append("")


def key(options: Options) -> Any:
    """The random key that ``--seed`` names."""
    import jax

    from jaxftc import checks

    checks.seed("--seed", options.seed)
    return jax.random.key(options.seed)


def load_arm(options: Options) -> Robot:
    """The robot that ``--robot`` names, once it is told on stderr what was welded, left out or is doubtful."""
    if options.robot == "puma560":
        return built_in(options.tip, options.lock, coulomb=options.coulomb)
    if options.coulomb and not type(options).coulomb:  # asked for, not the command's default
        raise ValueError("--coulomb is for the built-in arm; a robot file says its friction itself (user or frictionloss)")
    return read_arm(options.robot, options.tip, options.lock)


def built_in(tip: str | None, lock: tuple[str, ...], *, coulomb: bool) -> Robot:
    """The PUMA 560, which ends where it ends."""
    from jaxftc import puma560

    if tip is not None or lock:
        raise ValueError("--tip and --lock are for robot files; leave them out, or give --robot FILE")
    return puma560(coulomb=coulomb)


def read_arm(path: str, tip: str | None, lock: tuple[str, ...], *, cautions: bool = True) -> Robot:
    """A robot from a file; what was welded or left out, and what makes results doubtful, goes to stderr."""
    from jaxftc.robot.arm_file import read_robot

    robot = read_robot(path, tip=tip, lock=numbers("--lock", lock))
    for line in robot.notes + robot.cautions * cautions:
        print(f"{robot.name}: {line}", file=sys.stderr)
    return robot


def whole_arm(robot: str, tip: str | None, lock: tuple[str, ...]) -> Arm:
    """The robot that ``--robot`` names, and how its logs are read."""
    from jaxftc.robot import arm_file
    from jaxftc.robot.arm_table import Arm

    if robot == "puma560":
        found = built_in(tip, lock, coulomb=True)
        print(f"arm: {found.name}, built in, {found.n} joints; for another give --robot FILE", file=sys.stderr)
        return Arm(found)
    found = read_arm(robot, tip, lock)
    if tip is not None or lock:  # for a model file, which does not say how logs are read
        return Arm(found)
    return Arm(found, arm_file.read_arm(robot).recording)


def arm_words(options: Options) -> list[str]:
    """The words of a command line that name the same arm."""
    if options.robot == "puma560":
        return []
    words = ["--robot", str(Path(options.robot).resolve())]
    words += [] if options.tip is None else ["--tip", options.tip]
    return words + (["--lock", *options.lock] if options.lock else [])


def numbers(option: str, words: tuple[str, ...], example: str = "elbow=0.5") -> dict[str, float]:
    """Names and their numbers from words such as ``elbow=0.5``.

    Raises:
        ValueError: a word of another form, or a name twice.
    """
    found: dict[str, float] = {}
    for word in words:
        name, _, number = word.rpartition("=")
        try:
            value = float(number)
        except ValueError as error:
            raise ValueError(f"{option} takes names with a number each, such as {example}, got {word!r}") from error
        if not name:
            raise ValueError(f"{option} takes names with a number each, such as {example}, got {word!r}")
        if name in found:
            raise ValueError(f"{option} has {name!r} twice; give it once")
        found[name] = value
    return found


def sample_time(options: Options) -> float:
    """The sample time that ``--dt`` names, s."""
    from jaxftc import checks

    if options.dt is None:
        return 1e-3
    checks.positive("--dt", options.dt, "seconds")
    return options.dt


def motion_time(dt: float) -> float:
    """Time of a motion, s: one second, or the whole number of ticks nearest to it."""
    return max(1, round(1 / dt)) * dt


def load_or_default(options: Options, config: Config, *, anew: bool = False, preset: Preset | None = None) -> Gains:
    """The gains that ``--gains`` names, or the default ones for the encoders of a preset.

    A doubt of their thresholds goes to stderr, unless those are set ``anew``.
    """
    from jaxftc import default_gains
    from jaxftc.gains_file import load_and_doubt

    if options.gains is None:
        return default_gains(config, **({} if preset is None else preset.encoder.level))
    gains, doubt = load_and_doubt(options.gains, config)
    if doubt and not anew:
        print(doubt, file=sys.stderr)
    return gains
