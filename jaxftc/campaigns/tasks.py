"""Chunks of a campaign as tasks for other processes, which write their files themselves: only checksums come back.

A task is a function of what it is given: run again, after a worker was lost or beside one that was only thought to be, it
writes the same bytes to the same place, whole or not at all. So a task may be run any number of times. Checksums, which make
a file count, are added by the one process that gives out the tasks.
"""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import jax

from jaxftc.campaigns import store
from jaxftc.campaigns.spec import Job, Runner, describe, versions, write
from jaxftc.compile import program_cache
from jaxftc.io.files import digest, sweep

AHEAD = 2  # tasks that are given out for each core: one that runs, and one that waits


class Workers(Protocol):
    """Processes elsewhere, of one core each."""

    @property
    def cores(self) -> int:
        """How many there are now."""
        ...

    def share(self, value: Any) -> Callable[[], Any]:
        """A function that gives the value where it is called, in any of them."""
        ...

    def submit(self, fun: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Run a function in one of them, again in another one if it is lost."""
        ...


class Conditions(NamedTuple):
    """What a worker's process must be like."""

    manifest: str  # SHA-256 of the one in the campaign's folder
    versions: str  # the last digits of a row depend on them, on the flags and on the precision
    flags: str  # XLA_FLAGS
    x64: bool
    cached: bool  # compiled programs are kept in the user's cache folder
    folder: str  # where a scheme of the user's is looked for, after all other places


class Task(NamedTuple):
    """What a worker has to know of a campaign, a chunk apart."""

    job: Callable[[], Job]  # to be called when the process is as it must be
    conditions: Conditions


_begun: dict[tuple[Conditions, Path], Job] = {}  # one job, so that all its chunks in a process share a program


def spread(workers: Workers, *, cached: bool) -> Runner:
    """Run chunks on workers that see the campaign's folder under the same name."""

    def run(job: Job, chunks: Iterable[store.Chunk], tell: Callable[[int], object]) -> None:
        """Keep AHEAD tasks a core running until no chunk is left; a file counts as soon as its worker is through."""
        task, folders, running = None, set[Path](), dict[Future[str], store.Chunk]()
        for chunk in chunks:
            folders.add(chunk.path.parent)
            task = task or Task(workers.share(job), _conditions(chunk.path.parent, cached))
            running[workers.submit(run_chunk, task, chunk._replace(path=chunk.path.absolute()))] = chunk
            while len(running) >= AHEAD * max(1, workers.cores):
                _keep_some(running, tell)
        while running:
            _keep_some(running, tell)
        for folder in folders:
            sweep(folder)  # what lost workers had begun to write

    return run


def _conditions(folder: Path, cached: bool) -> Conditions:
    x64 = bool(program_cache.setting("enable_x64"))
    manifest, flags = digest(folder / store.MANIFEST), os.environ.get("XLA_FLAGS", "")
    return Conditions(manifest, _versions(), flags, x64, cached, os.getcwd())


def _versions() -> str:
    every = versions() | {"duckdb": version("duckdb")}  # which writes the files
    return ", ".join(f"{name} {value}" for name, value in every.items())


def _keep_some(running: dict[Future[str], store.Chunk], tell: Callable[[int], object]) -> None:
    """Wait for a chunk, or several that end together, and have them count; then comes the error of one of them."""
    for future in sorted(wait(running, return_when=FIRST_COMPLETED).done, key=lambda done: done.exception() is not None):
        chunk = running.pop(future)
        store.keep(chunk, future.result())
        tell(chunk.rows)


def run_chunk(task: Task, chunk: store.Chunk) -> str:
    """Run a chunk on one core and write its file, whose SHA-256 it gives.

    Raises:
        ValueError: the rows would not be those of the process that asks for them.
        OSError: the file cannot be written.
    """
    folder = chunk.path.parent
    if (task.conditions, folder) not in _begun:
        _begun.clear()
        _begun[task.conditions, folder] = _begin(task, folder)
    return write(_begun[task.conditions, folder], chunk, lambda count: None, at_a_time=1)


def _begin(task: Task, folder: Path) -> Job:
    """The job, in a process that is as the one that asks."""
    asked, where = task.conditions, f"on {socket.gethostname()}"
    if asked.versions != _versions():
        raise ValueError(f"{where} there is {_versions()}, here {asked.versions}; install the same on every machine")
    if not (folder / store.MANIFEST).is_file() or digest(folder / store.MANIFEST) != asked.manifest:
        raise ValueError(f"{where} {folder} is not the folder that it is here; give --out on a disk that all machines share")
    os.environ |= {"XLA_FLAGS": asked.flags, "TF_CPP_MIN_LOG_LEVEL": "3"}
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_enable_x64", asked.x64)
    if asked.cached:
        program_cache.keep()
    sys.path += [path for path in (asked.folder,) if path not in sys.path]
    job = task.job()
    if store.read_manifest(folder)["config"] != describe(job.config):
        raise ValueError(f"{where} scheme {job.scheme!r} is other code than here; copy its file to every machine")
    return job
