"""Ray as the workers of a campaign. The one file that imports it.

Each task takes one core and is run again where its worker or its node is lost. Ray's own processes of a cluster on this
machine end with the process that began it, however that ends.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import os
import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any

from jaxftc.compile.devices import cores

LOCAL = "local"
EXPLAIN = "--cluster needs the package ray; install it with: pip install 'jaxftc[cluster]'"
RETRIES = 10  # of a task whose worker is lost; one that takes every worker with it must end some time
PATIENCE = 5.0  # s to be answered at an address
JOINING = 60.0  # s to become part of a cluster
STORE = 80_000_000  # bytes of shared memory for results, which are checksums; Ray takes no less


@contextlib.contextmanager
def connect(address: str) -> Iterator[Cluster]:
    """Workers of a Ray cluster: ``local`` for this machine's cores, begun and ended here, or HOST:PORT of a head node.

    Raises:
        ValueError: ray is not installed, or no cluster answers there.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:  # names of it, as any folder called ray can be imported
        from ray import init, shutdown  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ValueError(EXPLAIN) from error
    if address != LOCAL:
        _answered(address)
    own = {"num_cpus": cores(), "include_dashboard": False, "object_store_memory": STORE} if address == LOCAL else {}
    with _no_longer_than(JOINING, address):
        try:
            init(address, log_to_driver=False, logging_level=logging.ERROR, **own)
        except (ConnectionError, RuntimeError, ValueError, OSError) as error:
            raise ValueError(f"cannot use the Ray cluster at {address}: {str(error).splitlines()[0]}") from error
    found = Cluster()
    try:
        if not found.cores:
            raise ValueError(f"the Ray cluster at {address} has no cores; start a node with: ray start --address {address}")
        yield found
    finally:
        shutdown()


def _answered(address: str) -> None:
    """Refuse an address at which nobody listens: Ray itself takes minutes to say so."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError(f"--cluster takes local, or HOST:PORT of a Ray head node such as node1:6379, got {address!r}")
    try:
        socket.create_connection((host.strip("[]"), int(port)), PATIENCE).close()
    except OSError as error:
        raise ValueError(f"no Ray cluster answers at {address} ({error}); begin one there with: ray start --head") from error


@contextlib.contextmanager
def _no_longer_than(seconds: float, address: str) -> Iterator[None]:
    """End the process with one line where something answers that is no cluster: Ray would wait for minutes and abort."""

    def end() -> None:
        os.write(2, f"jaxftc: what answers at {address} is no Ray cluster that this machine is a node of\n".encode())
        os._exit(2)

    timer = threading.Timer(seconds, end)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


class Cluster:
    """The cluster that this process is connected to."""

    def __init__(self) -> None:
        import ray  # pyright: ignore[reportMissingImports]

        self._ray, self._remote = ray, {}

    @property
    def cores(self) -> int:
        """Cores of all nodes that are there now."""
        return int(self._ray.cluster_resources().get("CPU", 0))

    @property
    def nodes(self) -> int:
        """Nodes that are there now."""
        return sum(node["Alive"] for node in self._ray.nodes())

    def share(self, value: Any) -> Callable[[], Any]:
        """A function that gives the value in any worker."""
        return functools.partial(self._ray.get, self._ray.put(value))

    def submit(self, fun: Callable[..., Any], /, *args: Any) -> Future[Any]:
        """Run a function on one core, again if its worker or its node is lost; what it raises is raised here."""
        if fun not in self._remote:
            self._remote[fun] = self._ray.remote(num_cpus=1, max_retries=RETRIES)(fun)
        future: Future[Any] = Future()
        self._remote[fun].remote(*args).future().add_done_callback(lambda done: _pass_on(done, future))
        return future


def _pass_on(done: Future[Any], future: Future[Any]) -> None:
    error = done.exception()
    if error is None:
        future.set_result(done.result())
        return
    cause = getattr(error, "cause", None)
    if not isinstance(cause, ValueError | OSError):
        said = str(cause or error).strip() or repr(cause or error)
        first = said.splitlines()[-1 if cause is None else 0]
        cause = OSError(
            f"a chunk failed, or was lost {RETRIES + 1} times: {first}; rows that "
            "are there stay, and the same command goes on"
        )
    future.set_exception(cause)
