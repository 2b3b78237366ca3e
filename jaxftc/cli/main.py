"""``jaxftc``: finds the commands, runs one, and turns a refusal into one line and exit code 2.

A command is a dataclass whose fields are its options and whose ``run`` does the work. Other packages add theirs through the
entry-point group ``jaxftc.commands``.
"""

from __future__ import annotations

import dataclasses
import sys
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import tyro

from jaxftc.cli.calibrate import Calibrate
from jaxftc.cli.campaign import Campaign
from jaxftc.cli.demo import Demo
from jaxftc.cli.diagnose import Diagnose
from jaxftc.cli.identify import Identify
from jaxftc.cli.inspect import Inspect
from jaxftc.cli.simulate import Simulate
from jaxftc.cli.view import View
from jaxftc.version import __version__

COMMANDS: dict[str, Any] = {
    "demo": Demo,
    "inspect": Inspect,
    "simulate": Simulate,
    "campaign": Campaign,
    "identify": Identify,
    "calibrate": Calibrate,
    "diagnose": Diagnose,
    "view": View,
}
DESCRIPTION = "Fault diagnosis and fault-tolerant control for robot arms."


def commands() -> dict[str, Any]:
    """All commands by name: our own, then those of installed packages."""
    found = dict(COMMANDS)
    for entry in entry_points(group="jaxftc.commands"):
        try:
            found.setdefault(entry.name, entry.load())
        except ModuleNotFoundError as error:
            found.setdefault(entry.name, _absent(entry, error))
    return found


def _absent(entry: EntryPoint, error: ModuleNotFoundError) -> Any:
    """A command that says why it is not there: the wheel leaves out the benchmarks."""
    ours = error.name == entry.module.split(".")[0]
    what_to_do = "run it from a checkout, after pip install -e ." if ours else f"install {error.name}"

    def run(self: object) -> None:
        raise ValueError(f"jaxftc {entry.name} is not installed ({error}); {what_to_do}")

    words = ("words", tyro.conf.Positional[tuple[str, ...]], ())  # whatever the real one would take
    space = {"run": run, "__doc__": f"Not installed: {what_to_do}"}
    return dataclasses.make_dataclass(entry.name.capitalize(), [words], namespace=space)


def parse(arguments: list[str] | None = None) -> Any:
    """The command's dataclass, filled in; leaves with exit code 2 on unknown options."""
    return tyro.extras.subcommand_cli_from_dict(commands(), prog="jaxftc", description=DESCRIPTION, args=arguments)


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the console script."""
    if (sys.argv[1:] if arguments is None else arguments) == ["--version"]:
        print(f"jaxftc {__version__}")
        return
    command = parse(arguments)
    try:
        command.run()
    except (ValueError, OSError) as error:
        print(f"jaxftc: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("jaxftc: stopped; the files that are there are complete", file=sys.stderr)
        sys.exit(130)
