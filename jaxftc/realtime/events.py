"""The event log: a JSON line for every change.

A line goes to the system in one call, so a process that dies leaves whole lines; what was written is on the disk when the
loop ends. A disk that is full must not stop a control loop: lines that cannot be written are counted.
"""

from __future__ import annotations

import errno
import json
import os
from collections import deque
from pathlib import Path
from typing import Any

KEPT = 1000  # events in memory; the file has all


class Events:
    """Events of one run, the last ones in memory, all of them in a file if there is one.

    Raises:
        ValueError: the file cannot be opened.
    """

    def __init__(self, path: str | Path | None = None) -> None:
        self.last: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self.lost = 0  # lines that could not be written
        self._file: int | None = None
        if path is not None:
            try:
                self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
            except OSError as error:
                raise ValueError(f"cannot write events to {path}: {error}; give another file") from error

    def add(self, t: float, event: str, **more: Any) -> None:
        """An event at t s since the start."""
        line = {"t": round(t, 6), "event": event, **more}
        self.last.append(line)
        if self._file is not None:
            text = (json.dumps(line) + "\n").encode()
            try:
                self.lost += os.write(self._file, text) != len(text)
            except OSError:
                self.lost += 1

    def close(self) -> None:
        """Have all of it on the disk."""
        if self._file is not None:
            try:
                os.fsync(self._file)
            except OSError as error:
                self.lost += error.errno != errno.EINVAL  # a pipe or a terminal has no disk
            os.close(self._file)
            self._file = None
