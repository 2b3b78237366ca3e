"""Where a command's results go: its folder, and what of its options they depend on."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jaxftc.cli.common import Output
from jaxftc.io.files import digest, write_text
from jaxftc.io.folder import taken

# Options that a result does not depend on.
NO_RESULT = ("out", "json", "cache", "force", "words", "check", "ticks", "cluster",
             "distributed", "coordinator", "processes", "process")  # fmt: skip
NAMES = ("robot", "preset")  # options that are a name or a file


@contextlib.contextmanager
def folder(options: Output, command: str, *, goes_on: bool = False) -> Iterator[Path]:
    """The folder for results, made, marked as the command's, and this process's alone; if none was named, a new one.

    A command that ``goes_on`` from what it finds there checks itself that it is of the same run.

    Raises:
        ValueError: the folder cannot be made or written, is written to by another process, holds files of others or
            another result, or an input lies in it.
    """
    try:
        path = _numbered(command) if options.out is None else options.out
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"cannot write results: {error}; give another folder with --out") from error
    files = [file for name, value in given(options) for file in _files(name, value)]
    inside = [file for file in files if file.resolve().parent == path.resolve()]
    if inside:
        raise ValueError(f"{inside[0]} is read by this command and lies in its folder for results; give another --out")
    with taken(path, command, {} if goes_on else request(options), force=options.force):
        yield path


def request(options: Output) -> dict[str, Any]:
    """What a result depends on, option by option, as JSON has it: of files their names and a digest of their content."""
    found: dict[str, Any] = {}
    for name, value in given(options):
        files = _files(name, value)
        if files:
            found[name] = [" ".join(map(str, files)), " ".join(digest(file)[:16] for file in files)]
        elif value is not None:
            found[name] = value if isinstance(value, bool | int | float | str) else " ".join(map(str, _each(value)))
    return found


def given(options: Any) -> Iterator[tuple[str, Any]]:
    """Names and values of all options that a result depends on, those of settings among them."""
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if dataclasses.is_dataclass(value):
            yield from given(value)
        elif field.name not in NO_RESULT:
            yield field.name, value


def _files(name: str, value: Any) -> list[Path]:
    """Files that an option names."""
    return [Path(one) for one in _each(value) if (isinstance(one, Path) or name in NAMES) and Path(one).is_file()]


def _each(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)


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
