"""Ctrl-C and ``kill``, answered at once, whatever the process is doing."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
from collections.abc import Iterator

from jaxftc.io.files import drop_unfinished

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextlib.contextmanager
def at_once() -> Iterator[None]:
    """Let a signal end the process with one line, as ``kill -9`` would: every file is whole or not there.

    An exception would come when the compiler or a query returns, and whoever catches too much would swallow it. Here a
    thread of its own waits for the signal. One that the process was started to ignore stays ignored.
    """
    heard = [number for number in SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    if threading.current_thread() is not threading.main_thread() or not heard:
        yield
        return
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    threading.Thread(target=_wait, args=(reader,), daemon=True).start()
    woken = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    before = {number: signal.signal(number, lambda number, frame: None) for number in heard}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(woken)
        writer.close()


def _wait(reader: socket.socket) -> None:
    """End the process at a signal, the thread when nobody will tell of one any more."""
    with reader:
        told = reader.recv(1)
    if told:
        drop_unfinished()
        with contextlib.suppress(OSError):
            os.write(2, b"\njaxftc: stopped; the files that are there are complete\n")
        os._exit(128 + told[0])
