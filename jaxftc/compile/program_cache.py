"""Programs that outlive their process, so that a command that has run before need not trace them again.

JAX's own cache saves compiling, but is asked by a program's text, so that Python has to trace it first: for a gradient
through the closed loop most of what is left. Here the text itself is kept, by ``jax.export``, under a name made of what it
comes from: the source of our packages, the versions of those that it is traced with, JAX's settings, shapes and types of the
arguments, and all that the function closes over. JAX's cache then has the compiled program. Commands keep both in the user's
cache folder; a library does so only if it is told to (``folder``).

A folder that others can write to could hand us a program of theirs, so only one of the user's own is used (``open_folder``).
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import logging
import os
import stat
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jax import export

from jaxftc.io.files import read_sealed, write_sealed

MOST = 64  # programs in the folder; the ones used longest ago go first
TRACED_WITH = ("jax", "jaxlib", "numpy", "optax", "mujoco", "mujoco-mjx")
folder: Path | None = None  # where programs are kept; nowhere if None
_log = logging.getLogger("jaxftc")


def user_folder() -> Path:
    """The user's cache folder; a relative ``XDG_CACHE_HOME`` is ignored, as its specification says."""
    named = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(named) if os.path.isabs(named) else Path.home() / ".cache") / "jaxftc"


def keep() -> None:
    """Keep programs, traced and compiled, in the user's cache folder: for a process that is a command's own."""
    global folder
    home = open_folder(user_folder())
    folder = home and open_folder(home / "programs")
    compiled = home and open_folder(home / "xla")
    if compiled is not None:
        jax.config.update("jax_compilation_cache_dir", str(compiled))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


def open_folder(path: Path) -> Path | None:
    """A cache folder that nobody else can enter, made if need be; None, with a warning, where others may have written.

    What is in it runs as the user, so nothing is read from a folder that was not the user's alone.
    """
    try:
        path.mkdir(parents=True, exist_ok=True, mode=0o700)
        others = stat.S_IWGRP | stat.S_IWOTH
        foreign = [entry for entry in (path.resolve(), *path.iterdir()) if not _ours(entry)]
        if not foreign and not path.stat().st_mode & others:
            path.chmod(0o700)
            return path
        if foreign:
            why = f"{foreign[0]} belongs to another user; remove it"
        else:
            why = "others can write to it; look at what is in it, then chmod 700 it"
    except OSError as error:
        why = str(error)
    _log.warning("compiled programs are not cached in %s: %s", path, why)
    return None


def _ours(path: Path) -> bool:
    return not hasattr(os, "getuid") or path.lstat().st_uid == os.getuid()


def program(
    fun: Callable[..., Any], args: tuple[Any, ...], name: str, like: Any, compiled: Callable[..., Any]
) -> Callable[..., Any]:
    """``fun`` for arguments like ``args``, traced once for all processes.

    Args:
        fun: A function of arrays.
        args: Example arguments, pytrees of arrays.
        name: All that ``fun`` closes over, as a text.
        like: Any pytree with the structure of the results.
        compiled: ``compiled(fun, examples, **kwargs of jax.jit)`` to a program.
    """
    leaves, tree = jax.tree.flatten(args)
    impls = {k: jax.random.key_impl(leaf) for k, leaf in enumerate(leaves) if _is_key(leaf)}

    def plain(leaves: list[Any]) -> list[Any]:
        """Random keys as the numbers that they hold: not every JAX can export them."""
        return [jax.random.key_data(leaf) if k in impls else leaf for k, leaf in enumerate(leaves)]

    def flat(*leaves: Any) -> list[Any]:
        back = [jax.random.wrap_key_data(leaf, impl=impls[k]) if k in impls else leaf for k, leaf in enumerate(leaves)]
        return jax.tree.leaves(fun(*jax.tree.unflatten(tree, back)))

    values = plain(leaves)
    exported = _exported(flat, values, f"{_circumstances()}{name}{tree}{impls}{[str(jax.typeof(v)) for v in values]}")
    call = functools.update_wrapper(lambda *leaves: exported.call(*leaves), fun)
    run, structure = compiled(call, values), jax.tree.structure(like)
    return lambda *args: jax.tree.unflatten(structure, run(*plain(jax.tree.leaves(args))))


def _is_key(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _exported(flat: Callable[..., Any], values: list[Any], text: str) -> Any:
    """The program of this text in the folder, or a new one, which is written there."""
    assert folder is not None
    path = folder / hashlib.sha256(text.encode()).hexdigest()
    with contextlib.suppress(Exception):  # whatever it is, the program can be made anew
        return _read(path)
    exported = export.export(jax.jit(flat))(*values)
    with contextlib.suppress(Exception):  # a program that cannot be kept costs time, nothing else
        _write(path, exported.serialize())
    return exported


def _read(path: Path) -> Any:
    data = read_sealed(path)
    path.touch()
    return export.deserialize(bytearray(data))


def _write(path: Path, data: bytearray) -> None:
    write_sealed(path, bytes(data))
    for old in sorted(path.parent.iterdir(), key=lambda file: file.stat().st_mtime)[:-MOST]:
        old.unlink(missing_ok=True)


def setting(name: str) -> Any:
    """One of JAX's settings as it is now."""
    return getattr(jax.config, f"jax_{name}")


def _circumstances() -> str:
    """What a traced program depends on besides its function and its arguments."""
    settings = [setting(name) for name in ("enable_x64", "threefry_partitionable", "default_matmul_precision")]
    return f"{_installation()}{settings}{jax.default_backend()}{len(jax.devices())}"


@functools.cache
def _installation() -> str:
    """Our source, and the packages that it is traced with."""
    source = hashlib.sha256()
    for name in ("jaxftc", "tuning"):
        for path in sorted(Path(sys.modules[name].__path__[0]).rglob("*.py")) if name in sys.modules else ():
            source.update(path.read_bytes())
    versions = {name: importlib.metadata.version(name) for name in TRACED_WITH}
    return f"{source.hexdigest()}{versions}"
