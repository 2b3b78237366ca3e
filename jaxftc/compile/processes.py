"""Several processes that run one program, each on its own devices: ``jax.distributed``, and an end for all when one ends.

A process that is lost would leave the others waiting for what it had to add, for as long as JAX's heartbeat allows, and JAX
would end them with a page of addresses. So each keeps a connection to the first, from before JAX begins. It breaks when
either process ends, however that was; whoever sees it break tells the others in one line and ends.
"""

from __future__ import annotations

import atexit
import contextlib
import dataclasses
import os
import re
import selectors
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import numpy as np
from jax.experimental import multihost_utils

from jaxftc.io.files import drop_unfinished

RANKS = (  # how launchers tell a process its number and how many there are
    ("JAX_PROCESS_ID", "JAX_NUM_PROCESSES"),
    ("SLURM_PROCID", "SLURM_NTASKS"),
    ("OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"),
    ("PMI_RANK", "PMI_SIZE"),
)
SLURM_PORTS = range(61440, 65536)  # by a job's number, so that two jobs on a node rarely meet
JOINING = 120.0  # s, for all processes to be there
GRACE = 30.0  # s, for the news of a lost process, after a program that it had a part in has failed
SILENCE = (5, 5, 4)  # s of silence before a connection is probed, between probes, and how many may be lost
HELLO, GOODBYE = b"jaxftc", b"."
BY_HAND = "--coordinator HOST:PORT --processes N --process I"


@dataclasses.dataclass(frozen=True)
class Place:
    """Where a process stands among all."""

    host: str  # of the first
    port: int
    count: int
    index: int


def place(coordinator: str | None, count: int | None, index: int | None, told: Mapping[str, str] = os.environ) -> Place:
    """What was asked for, and for what was not, what the launcher says in the environment.

    Raises:
        ValueError: something is missing, or no such process can be.
    """
    coordinator = coordinator or told.get("JAX_COORDINATOR_ADDRESS") or _of_slurm(told)
    if coordinator is None:
        raise ValueError(f"--distributed needs the address of the first process; start it by srun, or give {BY_HAND}")
    host, _, port = coordinator.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError(f"--coordinator takes HOST:PORT, such as node1:6000, got {coordinator!r}")
    for own, every in RANKS:
        if (count, index) == (None, None) and told.get(own, "").isdecimal() and told.get(every, "").isdecimal():
            index, count = int(told[own]), int(told[every])
    if count is None or index is None:
        raise ValueError(f"neither options nor a launcher say which of how many processes this is; give {BY_HAND}")
    if not 0 <= index < count:
        raise ValueError(f"--process must be from 0 to one less than --processes, got {index} of {count}")
    return Place(host.strip("[]"), int(port), count, index)


def _of_slurm(told: Mapping[str, str]) -> str | None:
    """The first node of a step, such as node3 of ``node[3-7,9],login``, and a port."""
    nodes = re.match(r"([^,\[]+)(?:\[(\d+))?", told.get("SLURM_STEP_NODELIST", ""))
    if nodes is None or not told.get("SLURM_JOB_ID", "").isdecimal():
        return None
    return f"{nodes[1]}{nodes[2] or ''}:{SLURM_PORTS[int(told['SLURM_JOB_ID']) % len(SLURM_PORTS)]}"


def first() -> bool:
    """Whether this is the process that writes: the only one, or the first of several."""
    return jax.process_index() == 0


def from_first(data: bytes) -> bytes:
    """What the first process has, in all of them; each must call it."""
    if jax.process_count() == 1:
        return data
    size = int(multihost_utils.broadcast_one_to_all(np.array(len(data), np.int32)))
    array = np.frombuffer(data, np.uint8) if first() else np.zeros(size, np.uint8)
    return np.asarray(multihost_utils.broadcast_one_to_all(array)).tobytes()


def begin(where: Place) -> Line:
    """Find the other processes; before anything runs in JAX.

    Raises:
        ValueError: they are not there.
    """
    line = Line(where)
    sys.stdout, out = os.fdopen(os.dup(1), "w"), sys.stdout
    out.flush()
    os.dup2(2, 1)  # what Gloo prints is not ours
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    address, term = f"{where.host}:{line.port}", signal.getsignal(signal.SIGTERM)
    try:
        jax.distributed.initialize(address, where.count, where.index, cluster_detection_method="deactivate")
    except (RuntimeError, OSError) as error:
        raise ValueError(f"JAX cannot begin at {address}: {str(error).splitlines()[0]}") from error
    signal.signal(signal.SIGTERM, term)  # JAX keeps it for itself
    return line


@contextlib.contextmanager
def together(line: Line) -> Iterator[None]:
    """Be one of several processes that have begun, until all have come to the end or one has not."""
    try:
        yield
        multihost_utils.sync_global_devices("end")
    except BaseException as error:
        if isinstance(error, jax.errors.JaxRuntimeError):
            time.sleep(GRACE)  # most likely a process is lost: whoever has seen that ends this one
        line.hang_up(b"")
        atexit.register(_leave)  # before JAX's own end, which would wait for the others
        raise
    line.hang_up(GOODBYE)


def _leave() -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(2)


class Line:
    """The connection of a process to the first, or of the first to all others, and a thread that watches it.

    Raises:
        ValueError: not all are there in time.
    """

    def __init__(self, where: Place) -> None:
        self._peers: dict[socket.socket, int] = {}
        self._over = False
        try:
            if where.index == 0:
                self._accept(where)
            else:
                self._call(where)
        except OSError as error:
            raise ValueError(f"the processes do not meet at {where.host}:{where.port}: {error}") from error
        for peer in self._peers:
            _probe(peer)
        threading.Thread(target=self._watch, daemon=True).start()

    def _accept(self, where: Place) -> None:
        """Wait for all others, then tell them at which port JAX will be."""
        deadline = time.monotonic() + JOINING
        with socket.create_server(("", where.port)) as server, socket.create_server(("", 0)) as free:
            self.port = free.getsockname()[1]
            while len(self._peers) < where.count - 1:
                server.settimeout(max(0.01, deadline - time.monotonic()))
                try:
                    peer, _ = server.accept()
                except TimeoutError as error:
                    there = ", ".join(map(str, sorted((0, *self._peers.values()))))
                    raise ValueError(f"of {where.count} processes only {there} came within {JOINING:.0f} s") from error
                peer.settimeout(5.0)
                said = _heard(peer, len(HELLO) + 8, socket.MSG_WAITALL)
                index, count = (int.from_bytes(said[k : k + 4]) for k in (len(HELLO), len(HELLO) + 4))
                if not said.startswith(HELLO):
                    peer.close()
                    continue
                if count != where.count or index in (0, *self._peers.values()):
                    raise ValueError(f"process {index} of {count} came to process 0 of {where.count}, or came twice")
                self._peers[peer] = index
        for peer in self._peers:
            peer.sendall(self.port.to_bytes(2))

    def _call(self, where: Place) -> None:
        """Call the first until it answers."""
        deadline = time.monotonic() + JOINING
        while True:
            try:
                peer = socket.create_connection((where.host, where.port), 5.0)
                break
            except OSError as error:
                if time.monotonic() > deadline or isinstance(error, socket.gaierror):
                    raise ValueError(f"no process 0 at {where.host}:{where.port} ({error})") from error
                time.sleep(0.1)
        peer.settimeout(2 * JOINING)
        peer.sendall(HELLO + where.index.to_bytes(4) + where.count.to_bytes(4))
        self.port = int.from_bytes(_heard(peer, 2, socket.MSG_WAITALL))
        if not self.port:
            raise ValueError("process 0 has ended; it says why")
        self._peers[peer] = 0

    def _watch(self) -> None:
        """End this process when another has ended, and tell all others why."""
        with selectors.DefaultSelector() as ready:
            for peer in self._peers:
                peer.settimeout(None)
                ready.register(peer, selectors.EVENT_READ)
            while ready.get_map():
                for key, _ in ready.select():
                    peer: Any = key.fileobj
                    said = _heard(peer)
                    if said == GOODBYE or self._over:
                        ready.unregister(peer)
                    else:
                        self._end(said.decode() or f"process {self._peers[peer]} has ended")

    def _end(self, why: str) -> None:
        drop_unfinished()
        with contextlib.suppress(OSError):
            os.write(2, f"\njaxftc: {why}, so all end; the same command goes on from the last checkpoint\n".encode())
        for peer in self._peers:
            with contextlib.suppress(OSError):
                peer.sendall(why.encode())
        os._exit(2)

    def hang_up(self, word: bytes) -> None:
        """Say that this process is about to end: ``GOODBYE`` if it has come to its end, nothing if it has failed."""
        self._over = True
        for peer in self._peers:
            with contextlib.suppress(OSError):
                peer.sendall(word)
                peer.shutdown(socket.SHUT_WR)


def _heard(peer: socket.socket, size: int = 1000, flags: int = 0) -> bytes:
    """What the other end says; nothing if it is gone, or silent for longer than is waited."""
    try:
        return peer.recv(size, flags)
    except OSError:
        return b""


def _probe(peer: socket.socket) -> None:
    """Have the system notice when the other machine is gone."""
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in zip(("TCP_KEEPIDLE", "TCP_KEEPINTVL", "TCP_KEEPCNT"), SILENCE, strict=True):
        if hasattr(socket, name):
            peer.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
