"""C code to a library that this process can call, by the C compiler of the machine."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

COMPILERS = ("cc", "gcc", "clang")
# Without contraction, a product and a sum are two roundings on every machine, as in the trace.
OPTIONS = ("-std=c99", "-O2", "-ffp-contract=off")


def compiler() -> str | None:
    """The C compiler that ``CC`` names, or the first one on the path."""
    named = os.environ.get("CC")
    return next(filter(None, map(shutil.which, (named,) if named else COMPILERS)), None)


def build(sources: Sequence[Path], out: Path, *options: str) -> None:
    """Compile and link C files.

    Raises:
        ValueError: there is no compiler, or it refuses; with its first line.
    """
    found = compiler()
    if found is None:
        named = os.environ.get("CC")
        raise ValueError(
            f"no C compiler: {f'CC is {named!r}, which is not there' if named else 'no ' + ', '.join(COMPILERS) + ' on PATH'}; "
            "install gcc or clang, or set CC"
        )
    command = [found, *OPTIONS, *options, *map(str, sources), "-o", str(out), "-lm"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    if run.returncode:
        lines = run.stderr.strip().splitlines()
        raise ValueError(f"{found} refused {sources[0]}: {lines[0] if lines else f'exit code {run.returncode}'}")


def library(*sources: Path) -> ctypes.CDLL:
    """A library of C files, loaded; its file is gone when this returns, what was loaded stays."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        path = Path(folder) / "ftc.so"
        build(sources, path, "-shared", "-fPIC")
        return ctypes.CDLL(str(path))


def library_of(text: str) -> ctypes.CDLL:
    """The same of C code in memory."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ftc.c"
        path.write_text(text, encoding="utf-8")
        return library(path)
