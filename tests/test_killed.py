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
from jaxftc.campaigns import store
from jaxftc.io import tables
from jaxftc.io.files import SUFFIX

pytestmark = pytest.mark.slow
MOMENTS = int(os.environ.get("JAXFTC_MOMENTS", "30"))  # of each command and signal
PROGRAM = "from jaxftc.cli.main import main; main()"
SHARED = ["--robot", "arm.xml", "--engine", "chain", "--seed", "5", "--out", "run"]
COMMANDS = {
    "simulate": ["--duration", "0.3"],
    "calibrate": ["--runs", "600", "--false-alarms", "0.05", "--duration", "0.2"],
    "campaign": ["-n", "12288", "--duration", "0.3", "--worst", "1"],
    "tune": ["--observer", "pi", "--control", "smc", "--steps", "15", "--batch", "2", "--validation", "2", "--held-out", "4",
             "--held-out-seed", "1", "--duration", "0.2"],
}  # fmt: skip
TIMES = ("seconds", "scenario_steps_per_s", "rows_kept")  # of a result, which are the machine's


@pytest.fixture(scope="module")
def alone(request, tmp_path_factory):
    """Every command left alone, with its programs in the cache; how long it takes then."""
    home = tmp_path_factory.mktemp("cache")
    environment = os.environ | {"XDG_CACHE_HOME": str(home), "PYTHONPATH": str(Path(__file__).parents[1])}
    done = {}

    def call(command):
        if command not in done:
            for name in ("first", "alone"):
                folder = tmp_path_factory.mktemp(f"{command}-{name}")
                (folder / "arm.xml").write_text(arms.serial(2))
                began = time.monotonic()
                subprocess.run(words(command), cwd=folder, env=environment, check=True, capture_output=True)
            done[command] = result(folder / "run"), time.monotonic() - began
        return done[command]

    call.environment = environment
    return call


def words(command):
    return [sys.executable, "-c", PROGRAM, command, *SHARED, *COMMANDS[command]]


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


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT], ids=lambda number: number.name)
@pytest.mark.parametrize("command", COMMANDS)
def test_stopped_at_random_moments(command, number, alone, tmp_path):
    (expected, seconds), chance = alone(command), random.Random(f"{command} {number}")
    (tmp_path / "arm.xml").write_text(arms.serial(2))
    environment, stopped, ends = alone.environment, 0, 0
    folder = tmp_path / "run"
    while stopped < MOMENTS:
        running = subprocess.Popen(
            words(command), cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        try:
            running.wait(chance.uniform(0.05, seconds))
        except subprocess.TimeoutExpired:
            running.send_signal(number)
            stopped += 1
        said = running.communicate(timeout=60)[1]
        assert running.returncode in (0, -number, 128 + number), said
        assert "Traceback" not in said and "KeyboardInterrupt" not in said
        if running.returncode == 0:  # it came to its end: the same bits, and from the beginning again
            assert result(folder) == expected
            folder.rename(tmp_path / f"end-{ends}")
            ends += 1
        elif command == "campaign" and folder.is_dir():
            assert all(store.fault_of(c) in (None, store.ABSENT, store.DAMAGED) for c in store.chunks(folder, 12288, 4096))
    subprocess.run(words(command), cwd=tmp_path, env=environment, check=True, capture_output=True)
    assert result(folder) == expected
