"""Whole commands in processes of their own: campaigns end to end, and how long each command takes to start."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from benchmarks.machine import peak
from benchmarks.results import Results, Setup, Table
from benchmarks.worker import Failed, environment
from jaxftc.cli import common

MAIN = "from jaxftc.cli.main import main; main()"
# On Linux a process tells its own peak at its end: what the system counts for it begins with its parent's.
TELL = """
import atexit, pathlib, sys
status = pathlib.Path("/proc/self/status")
if status.exists():
    atexit.register(lambda: print(status.read_text(), file=sys.stderr))
"""


class Ran(NamedTuple):
    """A process that ended well."""

    seconds: float  # from its start to its exit
    peak_bytes: int  # resident
    text: str  # stdout


def python(arguments: list[str], folder: Path, cache: Path) -> Ran:
    """Run Python in a folder, with a cache folder of its own.

    Raises:
        Failed: it ended with another code than 0.
    """
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        began = time.perf_counter()
        child = subprocess.Popen([sys.executable, *arguments], cwd=folder, env=environment(cache), stdout=out, stderr=err)
        _, status, usage = os.wait4(child.pid, 0)
        seconds = time.perf_counter() - began
        child.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        if child.returncode:
            raise Failed(f"python {' '.join(arguments)} ended with code {child.returncode}: {err.read()[-500:]}")
        told = re.findall(r"VmHWM:\s+(\d+) kB", err.read())
        return Ran(seconds, int(told[-1]) * 1024 if told else peak(usage), out.read())


def _command(setup: Setup, words: list[str], cache: Path) -> Ran:
    """One command of ours on the suite's arm, in a folder that is new."""
    folder = Path(tempfile.mkdtemp(dir=setup.folder))
    task = setup.task("loop")
    shared = common.arm_words(setup.options)
    shared += ["--gains", task.gains] if task.gains is not None else []
    return python(["-c", TELL + MAIN, *words, *(shared if words[0][0] != "-" else [])], folder, cache)


def _campaign(setup: Setup, n: int, out: str, cache: Path) -> tuple[Ran, float | None]:
    """``jaxftc campaign -n``, and its own figure of scenario-steps/s."""
    import duckdb

    folder = setup.folder / out
    words = ["campaign", "-n", str(n), "--out", str(folder), "--json"]
    words += [] if setup.sizes.duration is None else ["--duration", str(setup.sizes.duration)]
    ran = _command(setup, words, cache)
    with duckdb.connect() as connection:
        found = connection.execute(
            "select count(distinct scenario_id) from read_parquet($path)", {"path": str(folder / "chunk-*.parquet")}
        ).fetchone()
    rows = found[0] if found else 0
    if rows != n or json.loads(ran.text)["n"] != n:
        raise Failed(f"a campaign of {n} stored {rows} rows and says {json.loads(ran.text)['n']}")
    return ran, json.loads(ran.text)["scenario_steps_per_s"]


def campaign(setup: Setup, results: Results) -> None:
    """Campaigns of several sizes, storage included, from a filled cache: time, memory, and whether cost is linear."""
    sizes, cache = setup.sizes, setup.folder / "campaign"
    _campaign(setup, 2, "filling", cache)
    best: dict[int, tuple[Ran, float | None]] = {}
    for n in sorted({sizes.campaign, *sizes.campaigns}):
        tries = range(2 if sizes.everything and n <= sizes.campaign else 1)
        best[n] = min((_campaign(setup, n, f"{n}-{k}", cache) for k in tries), key=lambda each: each[0].seconds)
    ran, rate = best[sizes.campaign]
    results.metrics["campaign_10k_s"] = ran.seconds
    if rate is not None:  # a campaign of one chunk counts none: its first holds the compilation
        results.metrics["campaign_steps_per_s"] = rate
    if sizes.campaigns:
        counts, times = list(best), [each.seconds for each, _ in best.values()]
        cost = [(times[k + 1] - times[k]) / (counts[k + 1] - counts[k]) for k in (0, 1)]
        peaks = [each.peak_bytes for each, _ in best.values()]
        results.metrics |= {"campaign_linearity": cost[1] / cost[0], "campaign_memory_growth": peaks[2] / peaks[0]}
    rows = [(n, each.seconds, each.peak_bytes / 2**30, own or "-") for n, (each, own) in best.items()]
    columns = ("scenarios", "s from start to exit", "peak GiB", "scenario-steps/s by its own count")
    results.tables["campaigns"] = Table("Campaigns with storage", columns, rows)


def starts(setup: Setup, results: Results) -> None:
    """Every command twice in fresh processes: from an empty cache of compiled programs, and from the one it left."""
    commands = {
        "import jaxftc": ["-c", "import jaxftc"],
        "import jaxftc; jaxftc.step": ["-c", "import jaxftc; jaxftc.step"],
        "jaxftc --help": ["-c", MAIN, "--help"],
    }
    whole = ["simulate", "campaign -n 128", "demo", "tune --steps 5", "calibrate --runs 1024 --false-alarms 0.05"]
    rows = [
        (name, *(python(words, setup.folder, setup.folder / "none").seconds for _ in range(2)))
        for name, words in commands.items()
    ]
    for text in whole if setup.sizes.everything else ():
        cache = Path(tempfile.mkdtemp(dir=setup.folder))
        rows.append((f"jaxftc {text}", *(_command(setup, text.split(), cache).seconds for _ in range(2))))
    results.tables["starts"] = Table("From start to exit, fresh processes", ("command", "cold s", "warm s"), rows)
