"""Compiled programs that outlive their process, so that a command that has run before need not trace them again.

JAX's own persistent cache saves compiling, but asks for a program by its text, so that Python has to trace it first: for a
gradient through the closed loop most of what is left. Here a program is asked for by what its text is made from: the source
of our packages, the versions of those that it is built with, XLA's and JAX's settings, the machine, shapes and types of the
arguments, and ``origin``, in which the caller names all that the function closes over. Commands keep programs beside JAX's
cache; a library does so only if it is told to.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import os
import pickle
import platform
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
from jax.experimental import serialize_executable
from jax.experimental.compilation_cache import compilation_cache

from jaxftc.files import aside

MOST = 64  # programs in the folder; the ones used longest ago go first
BUILT_WITH = ("jax", "jaxlib", "numpy", "optax", "mujoco", "mujoco-mjx")
folder: Path | None = None  # where programs are kept; nowhere if None
_one_at_a_time = threading.Lock()


def across_processes(jitted: Any, origin: str) -> Callable[..., Any]:
    """``jitted`` with programs that are kept in ``folder``; only arrays as arguments, none by name, on no chosen device.

    JAX's settings count as at the first call with arguments of a kind, constants of modules as their source has them.
    """
    programs: dict[Any, Any] = {}

    def call(*args: Any) -> Any:
        if folder is None:
            return jitted(*args)
        leaves, tree = jax.tree.flatten(args)
        types = tuple(map(jax.typeof, leaves))
        kind = tree, types
        if kind not in programs:
            with _one_at_a_time:  # threads that meet here need the same program, and making it changes a setting of JAX
                if kind not in programs:
                    text = f"{_circumstances()}{origin}{tree}{[(str(t), t.weak_type) for t in types]}"
                    programs[kind] = _kept(jitted, args, folder / hashlib.sha256(text.encode()).hexdigest())
        return programs[kind](*args)

    return call


def _kept(jitted: Any, args: tuple[Any, ...], path: Path) -> Any:
    """The program in a file, or a new one, which is written there."""
    with contextlib.suppress(Exception):  # whatever it is, the program can be made anew
        return _read(path)
    with _uncached():  # what JAX's cache has read, XLA cannot write again
        program = jitted.lower(*args).compile()
    with contextlib.suppress(Exception):  # a program that cannot be kept costs time, nothing else
        _write(path, program)
    return program


def _read(path: Path) -> Any:
    data = path.read_bytes()
    if hashlib.sha256(data[32:]).digest() != data[:32]:
        raise OSError(f"{path} is damaged")
    path.touch()
    *program, ids = pickle.loads(data[32:])
    devices = [device for device in jax.devices() if device.id in ids]
    return serialize_executable.deserialize_and_load(*program, execution_devices=devices)


def _write(path: Path, program: Any) -> None:
    ids = {device.id for sharding in jax.tree.leaves(program.output_shardings) for device in sharding.device_set}
    data = pickle.dumps((*serialize_executable.serialize(program), ids))
    path.parent.mkdir(parents=True, exist_ok=True)
    with aside(path) as temporary:
        temporary.write_bytes(hashlib.sha256(data).digest() + data)
    for old in sorted(path.parent.iterdir(), key=lambda file: file.stat().st_mtime)[:-MOST]:
        old.unlink(missing_ok=True)


@contextlib.contextmanager
def _uncached() -> Iterator[None]:
    """JAX's persistent cache off."""
    cache = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", None)
    compilation_cache.reset_cache()
    try:
        yield
    finally:
        jax.config.update("jax_compilation_cache_dir", cache)
        compilation_cache.reset_cache()


def _circumstances() -> str:
    """What a compiled program depends on besides its function and its arguments."""
    settings = {name: value for name, value in jax.config.values.items() if "cache" not in name}
    devices = [(device.platform, device.device_kind) for device in jax.devices()]
    return f"{_installation()}{settings}{jax.dtypes.canonicalize_dtype(float)}{os.environ.get('XLA_FLAGS')}{devices}"


@functools.cache
def _installation() -> str:
    """Our source, the packages that it is built with, and the processor."""
    source = hashlib.sha256()
    for name in ("jaxftc", "tuning"):
        for path in sorted(Path(sys.modules[name].__path__[0]).rglob("*.py")) if name in sys.modules else ():
            source.update(path.read_bytes())
    versions = {name: importlib.metadata.version(name) for name in BUILT_WITH}
    processor = platform.processor() + platform.machine()
    with contextlib.suppress(OSError), open("/proc/cpuinfo") as file:
        processor += next((line for line in file if line.startswith(("flags", "Features"))), "")
    return f"{source.hexdigest()}{versions}{sys.version}{processor}"
