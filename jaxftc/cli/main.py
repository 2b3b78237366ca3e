"""``jaxftc``: finds the commands, runs one, and turns a refusal into one line and exit code 2.

A command is a dataclass whose fields are its options and whose ``run`` does the work. Other packages add theirs through the
entry-point group ``jaxftc.commands``. Nothing that takes time is imported before ``main`` runs, so that a signal is always
answered.
"""

from __future__ import annotations

import contextlib
import os
import sys
from typing import TYPE_CHECKING, Any

from jaxftc.cli.stop import at_once
from jaxftc.version import __version__

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "jaxftc.commands"
COMMANDS = {
    "demo": "jaxftc.cli.demo:Demo",
    "simulate": "jaxftc.cli.simulate:Simulate",
    "view": "jaxftc.cli.view:View",
    "campaign": "jaxftc.cli.campaign:Campaign",
    "calibrate": "jaxftc.cli.calibrate:Calibrate",
    "inspect": "jaxftc.cli.inspect:Inspect",
    "identify": "jaxftc.cli.identify:Identify",
    "diagnose": "jaxftc.cli.diagnose:Diagnose",
    "export": "jaxftc.cli.export:Export",
}
DESCRIPTION = """Fault diagnosis and fault-tolerant control for robot arms.

Start with jaxftc demo. For the options of a command: jaxftc simulate --help. For the version: jaxftc --version.
"""


def commands() -> dict[str, Any]:
    """All commands by name: our own, then those of installed packages."""
    return {name: _load(entry) for name, entry in _entries().items()}


def _entries() -> dict[str, EntryPoint]:
    from importlib.metadata import EntryPoint

    ours = {name: EntryPoint(name, place, GROUP) for name, place in COMMANDS.items()}
    return ours | {entry.name: entry for entry in installed() if entry.name not in ours}


def _load(entry: EntryPoint) -> Any:
    try:
        return entry.load()
    except ModuleNotFoundError as error:
        if entry.name in COMMANDS:
            raise
        return _absent(entry, error)


def installed() -> Any:
    """Commands of installed packages."""
    from importlib.metadata import entry_points

    return entry_points(group=GROUP)


def _absent(entry: EntryPoint, error: ModuleNotFoundError) -> Any:
    """A command that says why it is not there: the wheel leaves out the benchmarks."""
    import dataclasses

    import tyro

    ours = error.name == entry.module.split(".")[0]
    what_to_do = "run it from a checkout, after pip install -e ." if ours else f"install {error.name}"

    def run(self: object) -> None:
        raise ValueError(f"jaxftc {entry.name} is not installed ({error}); {what_to_do}")

    words = ("words", tyro.conf.Positional[tuple[str, ...]], ())  # whatever the real one would take
    space = {"run": run, "__doc__": f"Not installed: {what_to_do}"}
    return dataclasses.make_dataclass(entry.name.capitalize(), [words], namespace=space)


def _summary(command: Any) -> Any:
    """A command without options whose help is the first line of the real one's, for the list of commands."""
    import dataclasses

    return dataclasses.make_dataclass(command.__name__, [], namespace={"__doc__": command.__doc__.partition("\n")[0]})


def parse(arguments: list[str] | None = None) -> Any:
    """The command's dataclass, filled in; leaves with exit code 2 on unknown options.

    Raises:
        ValueError: an argument that is no text, or a list without an entry.
    """
    import tyro

    words = tuple(sys.argv[1:] if arguments is None else arguments)
    for word in words:
        if any("\ud800" <= letter <= "\udfff" for letter in word):
            raise ValueError(f"arguments and names of files must be UTF-8, got {os.fsencode(word)!r}; rename it")
    entry = _entries().get(words[0]) if words else None
    if entry is None:  # help, or a command that is not there
        known = {name: _summary(command) for name, command in commands().items()}
        command = tyro.extras.subcommand_cli_from_dict(known, prog="jaxftc", description=DESCRIPTION, args=words)
    else:  # the parsers of all others would take as long again
        command = tyro.cli(_load(entry), prog=f"jaxftc {entry.name}", args=words[1:])
    from jaxftc.cli import common, results

    for name, value in results.given(command):
        option = "--" + name.replace("_", "-")
        if value == () and option in (word.replace("_", "-") for word in words):
            raise ValueError(f"{option} was given without an entry; name at least one, or leave it out")
    if isinstance(command, common.Output):
        command.words = words
    return command


def main(arguments: list[str] | None = None) -> None:
    """Entry point of the console script."""
    _open_streams()
    with at_once():
        if (sys.argv[1:] if arguments is None else arguments) == ["--version"]:
            print(f"jaxftc {__version__}")
            return
        try:
            parse(arguments).run()
        except BrokenPipeError:  # whoever read our output has gone: nobody is left to be told
            for stream in (sys.stdout, sys.stderr):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
            sys.exit(141)
        except (ValueError, OSError) as error:
            _refuse(" ".join(str(error).split()))
        except MemoryError:
            _refuse("not enough memory; ask for fewer scenarios or a shorter run")


def _refuse(reason: str) -> None:
    """Say why in one line, if anybody listens, and leave with exit code 2."""
    with contextlib.suppress(OSError):
        print(f"jaxftc: {reason}", file=sys.stderr)
    sys.exit(2)


def _open_streams() -> None:
    """What was closed leads nowhere; otherwise the next file that is opened would get its number, and what is printed."""
    if sys.stdin and sys.stdout and sys.stderr:
        return
    while os.open(os.devnull, os.O_RDWR) < 2:
        pass
    sys.stdout, sys.stderr = (stream or open(os.devnull, "w") for stream in (sys.stdout, sys.stderr))  # noqa: SIM115
