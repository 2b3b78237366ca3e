"""A folder of results: one command's, one result's, one process's at a time.

The mark in it says which command made it and, where a command cannot go on with what another call began, from what.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jaxftc.io.files import sweep, write_text

MARK = ".jaxftc"
ANOTHER = "give another folder with --out, or --force to replace it"


@contextlib.contextmanager
def taken(folder: Path, command: str, request: dict[str, Any], *, force: bool = False) -> Iterator[None]:
    """The folder for one call of a command, from the look at what it holds to the end.

    ``request`` is what the result depends on; empty for a command that checks that itself, since it can go on.

    Raises:
        ValueError: another process writes to it, or, without ``force``, it holds files of others or another result.
    """
    with _locked(folder):
        sweep(folder)
        mark = {"command": command, "request": request}
        if not force:
            _refuse(folder, mark)
        write_text(folder / MARK, json.dumps(mark, indent=2) + "\n")
        yield


def differences(had: dict[str, Any], asked: dict[str, Any]) -> list[str]:
    """What differs between two requests, by option.

    A value that is a list is a file: its name, for people, and the fingerprint of its content, which counts.
    """

    def counts(value: Any) -> Any:
        return value[-1] if isinstance(value, list) else value

    def shown(value: Any) -> str:
        if value is None:
            return "left out"
        return " of content ".join(map(str, value)) if isinstance(value, list) else repr(value)

    return [
        f"--{key.replace('_', '-')} {shown(had.get(key))}, asked for {shown(asked.get(key))}"
        for key in sorted({*had, *asked})
        if counts(had.get(key)) != counts(asked.get(key))
    ]


def _refuse(folder: Path, mark: dict[str, Any]) -> None:
    """Refuse a folder that holds anything but an earlier result of the same request; hidden files are not looked at."""
    if all(path.name.startswith(".") for path in folder.iterdir()):
        return
    try:
        had = json.loads((folder / MARK).read_text(encoding="utf-8"))
        command, request = str(had["command"]), dict(had["request"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"{folder} holds files that are no result of jaxftc's; {ANOTHER}") from error
    if command != mark["command"]:
        raise ValueError(f"{folder} holds what jaxftc {command} made; {ANOTHER}")
    other = differences(request, mark["request"])
    if other:
        raise ValueError(f"{folder} holds another result: {'; '.join(other)}; {ANOTHER}")


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """The folder for this process alone; the system lets go of it when the process ends, however it ends."""
    try:
        import fcntl
    except ImportError:  # a system without it: nothing keeps two processes apart
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ValueError(
                f"another jaxftc command writes to {folder}; wait for it, or give another folder with --out"
            ) from error
        yield
    finally:
        os.close(handle)
