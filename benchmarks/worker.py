"""A workload in a process of its own: fresh caches, its own devices and cores, its own peak memory.

The other end is ``child``. The parent starts it and asks; the child answers with one line of JSON on stdout for its start
and for every call.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import IO, Any, Literal


@dataclasses.dataclass(frozen=True)
class Task:
    """What the child is to time."""

    what: Literal["loop", "gradient", "mjx", "tick"]
    robot: str = "puma560"
    tip: str | None = None
    lock: tuple[str, ...] = ()
    coulomb: bool = True
    gains: str | None = None
    engine: Literal["mjx", "chain"] = "chain"
    duration: float | None = None  # s
    batch: int = 128  # scenarios; of ticks, calls
    cores: int | None = None  # it may use; all if None


class Failed(RuntimeError):
    """A workload did not run, or its results are wrong: figures would mean nothing."""


class Worker:
    """The parent's end; ``first`` is what the first call took, compilation included, ``value`` what it gave."""

    def __init__(self, task: Task, cache: Path) -> None:
        self.task = task
        text = json.dumps(dataclasses.asdict(task))
        self._child = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.child", text],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment(cache),
            text=True,
        )
        try:
            answer = self._answer()
        except BaseException:
            self.close()
            raise
        self.first, self.value = answer["seconds"], answer["value"]

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __call__(self) -> dict[str, Any]:
        """One call: seconds, value, and the peak resident memory of the process so far, bytes."""
        return self._ask("run")

    def memory(self) -> int:
        """Bytes that the largest program of the process sets aside."""
        return self._ask("memory")["bytes"]

    def kernels(self) -> list[list[Any]]:
        """What the largest program of the process does in each turn of its loops, see ``kernels.Turn``."""
        return self._ask("kernels")["turns"]

    def _ask(self, word: str) -> dict[str, Any]:
        _pipe(self._child.stdin).write(word + "\n")
        _pipe(self._child.stdin).flush()
        return self._answer()

    def best(self, rounds: int) -> float:
        """The least seconds of some calls."""
        return min(self()["seconds"] for _ in range(rounds))

    def _answer(self) -> dict[str, Any]:
        line = _pipe(self._child.stdout).readline()
        if not line:
            raise Failed(f"the process of {self.task} ended with code {self._child.wait()}; its error is above")
        return json.loads(line)

    def close(self) -> None:
        """End the child; it leaves when there is nothing more to read."""
        _pipe(self._child.stdin).close()
        self._child.wait()
        _pipe(self._child.stdout).close()


def environment(cache: Path) -> dict[str, str]:
    """For a process of its own, with a cache of its own; it sets the flags that commands set itself, or goes without."""
    from jaxftc.compile.xla import FLAGS, without_flag

    flags = functools.reduce(without_flag, FLAGS, os.environ.get("XLA_FLAGS", ""))
    return os.environ | {"XDG_CACHE_HOME": str(cache), "TF_CPP_MIN_LOG_LEVEL": "3", "XLA_FLAGS": flags}


def compiling(worker: Worker, rounds: int = 2) -> float:
    """Seconds that compiling took: the first call less a warm one."""
    return worker.first - worker.best(rounds)


def _pipe(pipe: IO[str] | None) -> IO[str]:
    if pipe is None:
        raise Failed("the worker has no pipe")
    return pipe
