"""C code to a library that this process can call, by the C compiler of the machine; a traced function to C code."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxftc.compile import c99
from jaxftc.compile.operations import TYPES
from jaxftc.compile.scalars import scalars

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
        sought = f"CC is {named!r}, which is not there" if named else f"none of {', '.join(COMPILERS)} is on the PATH"
        raise ValueError(f"no C compiler: {sought}; install gcc or clang, or set CC")
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


def function(fun: Callable[..., Any], *examples: np.ndarray) -> Callable[..., list[np.ndarray]]:
    """``fun`` of arrays, for arrays like the examples, as C code; results are NumPy arrays.

    Raises:
        ValueError: there is no C compiler, or ``fun`` does what C code is not written for.
    """
    program, taken = scalars(fun, *examples), [np.asarray(example).dtype for example in examples]
    inputs = [[f"in{k}[{j}]" for j in range(np.size(example))] for k, example in enumerate(examples)]
    results = [[f"out{k}[{j}]" for j in range(places.size)] for k, places in enumerate(program.results)]
    kinds = [program.operations[int(places.flat[0])].dtype for places in program.results]
    pointers = [f"const {TYPES[kind.name]} *in{k}" for k, kind in enumerate(taken)]
    pointers += [f"{TYPES[kind.name]} *out{k}" for k, kind in enumerate(kinds)]
    lines = ["#include <math.h>", "#include <stdbool.h>", "#include <stdint.h>", *c99.helpers(program)]
    lines += [f"void ftc({', '.join(pointers)}) {{", *c99.body(program, inputs, results), "}", ""]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ftc.c"
        path.write_text("\n".join(lines), encoding="utf-8")
        loaded = library(path)
    loaded.ftc.restype, loaded.ftc.argtypes = None, [ctypes.c_void_p] * len(pointers)
    room = [ctypes.c_char * (places.size * kind.itemsize) for places, kind in zip(program.results, kinds, strict=True)]
    shapes = [(kind, places.shape) for places, kind in zip(program.results, kinds, strict=True)]

    def call(*arrays: Any) -> list[np.ndarray]:
        # Bytes and buffers, since asking an array for its address takes as long as the code does.
        made: list[Any] = [kind() for kind in room]
        loaded.ftc(*[np.asarray(a, kind).tobytes() for a, kind in zip(arrays, taken, strict=True)], *made)
        return [np.frombuffer(b, kind).reshape(shape) for b, (kind, shape) in zip(made, shapes, strict=True)]

    return call
