"""Commands that are stopped at random moments, by every signal: resumed or run again they give the same bits."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from benchmarks import arms
from jaxftc.io import tables
from jaxftc.io.files import SUFFIX

pytestmark = pytest.mark.slow
MOMENTS = 30  # of each command, the signals in turn
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
PROGRAM = "from jaxftc.cli.main import main; print(flush=True); main()"  # it says that Python has got as far as us
COMMANDS = {
    "simulate": ["--duration", "0.3"],
    "calibrate": ["--runs", "600", "--false-alarms", "0.05", "--duration", "0.2"],
    "campaign": ["-n", "12288", "--duration", "0.3", "--worst", "1"],
    "tune": ["--observer", "pi", "--control", "smc", "--steps", "15", "--batch", "2", "--validation", "2", "--held-out", "4",
             "--held-out-seed", "1", "--duration", "0.2"],
}  # fmt: skip
TIMES = ("seconds", "scenario_steps_per_s", "rows_kept")  # of a result, which are the machine's


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    """A command by its name: run it in a folder, ``run`` in it; compiled programs stay in a cache of the module's own."""
    home = tmp_path_factory.mktemp("home")
    (home / "arm.xml").write_text(arms.serial(2))
    environment = os.environ | {"XDG_CACHE_HOME": str(home), "PYTHONPATH": str(Path(__file__).parents[2])}
    shared = ["--robot", str(home / "arm.xml"), "--engine", "chain", "--seed", "5", "--out", "run"]

    def begin(name, folder):
        words = [sys.executable, "-c", PROGRAM, name, *shared, *COMMANDS[name]]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        running = subprocess.Popen(words, cwd=folder, env=environment, **pipes)
        running.stdout.readline()
        return running

    return begin


def result(folder):
    """All that a command leaves, as far as it is the arithmetic's: every column to the last bit."""
    found = {}
    for path in sorted(folder.rglob("*")):
        assert SUFFIX not in path.name, "what was half written is swept away"
        if path.suffix == ".parquet":
            columns = tables.read(path)
            found[path.name] = {k: np.ma.filled(v, -1).tolist() for k, v in columns.items() if k not in TIMES}
        elif path.name in ("gains.toml", "preset.toml", "manifest.toml", "SHA256SUMS"):
            found[path.name] = path.read_bytes()
        elif path.suffix == ".json":
            found[path.name] = {k: v for k, v in json.loads(path.read_text()).items() if k not in TIMES}
    return json.dumps(found, default=str)


def finish(running):
    said = running.communicate()[1]
    assert running.returncode == 0, said


@pytest.mark.parametrize("name", COMMANDS)
def test_stopped_at_random_moments(name, command, tmp_path):
    for folder in ("first", "alone", "stopped"):
        (tmp_path / folder).mkdir()
        began = time.monotonic()
        if folder != "stopped":
            finish(command(name, tmp_path / folder))
            seconds = time.monotonic() - began  # in the end, with programs from the cache
    expected, chance, stops, ends = result(tmp_path / "alone" / "run"), random.Random(name), 0, 0
    folder = tmp_path / "stopped" / "run"
    while stops < MOMENTS:
        running, number = command(name, tmp_path / "stopped"), SIGNALS[stops % len(SIGNALS)]
        try:
            running.wait(chance.uniform(0.0, seconds))
        except subprocess.TimeoutExpired:
            running.send_signal(number)
            stops += 1
        said = running.communicate(timeout=60)[1]
        assert running.returncode in (0, -number, 128 + number), said
        assert "Traceback" not in said and "KeyboardInterrupt" not in said
        if running.returncode == 0:  # it came to its end: the same bits, and from the beginning again
            assert result(folder) == expected
            folder.rename(tmp_path / f"end-{ends}")
            ends += 1
    finish(command(name, tmp_path / "stopped"))
    assert result(folder) == expected
    print(f"{name}: {stops} stops, {ends + 1} ends of the same bits")
