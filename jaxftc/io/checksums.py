"""Checksums of a folder's files, in a file that ``sha256sum --check`` reads.

A line that is damaged makes its file look damaged, so the file needs no checksum of its own.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from jaxftc.io.files import digest, write_text

NAME = "SHA256SUMS"


def agrees(path: Path) -> bool:
    """Whether a file is there and as its folder's checksums say."""
    return path.is_file() and _read(path.parent).get(path.name) == digest(path)


def record(folder: Path, files: dict[str, str | None]) -> None:
    """Add checksums: of a text that a file is to hold, or, where it is None, of the file that is there."""
    add(folder, {name: digest(folder / name) if text is None else _of_text(text) for name, text in files.items()})


def add(folder: Path, values: dict[str, str]) -> None:
    """Add checksums that are known, by the file's name."""
    lines = [f"{value}  {name}\n" for name, value in sorted((_read(folder) | values).items())]
    write_text(folder / NAME, "".join(lines))


def _of_text(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _read(folder: Path) -> dict[str, str]:
    """Checksum by name; nothing where there is no file."""
    try:
        text = (folder / NAME).read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return {}
    return {name: value for value, _, name in (line.partition("  ") for line in text.split("\n")) if name}
