"""Files that are whole or not there: written to a new file beside their place, then renamed.

A file's own checksum, at its end, tells one that is as it was written from one that is not (``write_sealed``).
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

SUFFIX = ".jaxftc-tmp"  # of a file that is not whole yet
SEAL = hashlib.sha256().digest_size  # bytes
_unfinished: set[Path] = set()


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A new file beside ``path`` to write to; it takes the place of ``path`` when the block ends without an error.

    Its name is nobody else's, and what was there under that name, a link for one, would be refused and not followed. What
    was written is on the disk before it takes its place; after an error it is removed.
    """
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(6)}{SUFFIX}")
    os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    _unfinished.add(temporary)
    try:
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    finally:
        _unfinished.discard(temporary)


def drop_unfinished() -> None:
    """Remove what this process has begun to write, just before it ends."""
    for temporary in tuple(_unfinished):
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def sweep(folder: Path) -> None:
    """Remove what processes that were killed had begun to write, from a folder that nobody else writes to."""
    for temporary in folder.glob(f".*{SUFFIX}"):
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_sealed(path: Path, data: bytes) -> None:
    """Write bytes and their checksum behind them, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data + hashlib.sha256(data).digest())


def read_sealed(path: Path) -> bytes:
    """The bytes that ``write_sealed`` wrote.

    Raises:
        OSError: it cannot be read, or is not as it was written.
    """
    whole = path.read_bytes()
    data, seal = whole[:-SEAL], whole[-SEAL:]
    if hashlib.sha256(data).digest() != seal:
        raise OSError(f"{path} is damaged: it does not match the checksum at its end")
    return data


def digest(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
