"""Bad options, closed streams and signals: one line, at once, whatever the command is doing."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from jaxftc.cli import common
from jaxftc.cli.main import main

PROGRAM = "from jaxftc.cli.main import main; main()"
HUGE = "99999999999999999999"


@pytest.fixture
def refused(monkeypatch, capsys, tmp_path):
    """Run a command that must be refused before anything runs; its one line on stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(common, "prepare", lambda options, **settings: None)

    def call(*arguments):
        with pytest.raises(SystemExit) as stop:
            main(list(arguments))
        out, err = capsys.readouterr()
        assert stop.value.code == 2 and err.count("\n") == 1 and not out, err
        assert not list(tmp_path.iterdir()), "nothing was made"
        return err

    return call


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["tune", "--held-out-seed", HUGE], f"--held-out-seed must lie in 0 to 2^63 - 1, got {HUGE}"),
        (["tune", "--seed", HUGE], "--seed must lie in 0 to 2^63 - 1"),
        (["simulate", "--seed", HUGE], "--seed must lie in 0 to 2^63 - 1"),
        (
            ["simulate", "--duration", "1e12"],
            "duration must be at most 10000 s, 10000000 ticks of 0.001 s, got 1000000000000.0",
        ),
        (["simulate", "--t-final", "1e308"], "t_final must be at most 10000 s"),
        (["campaign", "--duration", "1e12"], "duration must be at most 10000 s"),
        (["campaign", "-n", "3000000000"], "-n must be an integer of at most 2147483647, got 3000000000"),
        (["campaign", "--worst", HUGE], "--worst must be an integer of at most"),
        (["calibrate", "--runs", HUGE], "--runs must be an integer of at most 1000000"),
        (["tune", "--steps", "1000000", "--batch", "1000000"], "steps x batch must be at most 10000000 training scenarios"),
        (["tune", "--held-out", HUGE], "--held-out must be an integer of at most 1000000"),
        (["calibrate", "--logs"], "--logs was given without an entry; name at least one, or leave it out"),
        (["tune", "--only"], "--only was given without an entry"),
        (["tune", "--freeze", "--shared", "control"], "--freeze was given without an entry"),
        (["tune", "--weight"], "--weight was given without an entry"),
        (["bench", "--sections"], "--sections was given without an entry"),
        (["bench", "tuning", "--methods"], "--methods was given without an entry"),
        (["simulate", "--out", "runs/\udcff"], "names of files must be UTF-8, got b'runs/\\xff'"),
    ],
)
def test_options_that_cannot_be_are_refused_before_anything_runs(refused, arguments, words):
    assert words in refused(*arguments)


@pytest.fixture
def process(tmp_path):
    """Start a program; a shell in the background has its children ignore Ctrl-C, which here they must hear."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    with contextlib.ExitStack() as started:

        def start(program):
            pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
            running = subprocess.Popen([sys.executable, "-c", program], cwd=tmp_path, text=True, **pipes)
            started.enter_context(running)
            started.callback(running.kill)
            return running

        yield start
    signal.signal(signal.SIGINT, before)


BUSY = {  # what the process does when the signal comes; it says so before
    "native code": "import hashlib; print('now', flush=True); hashlib.pbkdf2_hmac('sha256', b'', b'', 10**9)",
    "a query": "from jaxftc.io import tables; print('now', flush=True)\n"
    "    tables.connect().execute('select count(*) from range(10000000) a, range(10000000) b').fetchall()",
    "an import": "import importlib.util\n"
    "    class Swallow:\n"
    "        def find_spec(self, *a):\n"
    "            print('now', flush=True)\n"
    "            import time\n"
    "            for _ in range(600):\n"
    "                try: time.sleep(0.1)\n"
    "                except BaseException: pass\n"
    "    sys.meta_path.insert(0, Swallow()); import nowhere",
    "writing": "from pathlib import Path; from jaxftc.io.files import atomic_path; import time\n"
    "    with atomic_path(Path('file')) as temporary:\n"
    "        temporary.write_text('half'); print('now', flush=True); time.sleep(60)",
}


@pytest.mark.parametrize("what", BUSY)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_command_at_once(process, tmp_path, what, number):
    program = f"import sys; from jaxftc.cli.stop import at_once\nwith at_once():\n    {BUSY[what]}\nprint('went on')"
    running = process(program)
    assert running.stdout and running.stdout.readline() == "now\n"
    running.send_signal(number)
    began = time.monotonic()
    out, err = running.communicate(timeout=30)
    assert time.monotonic() - began < 10 and running.returncode == 128 + number
    assert err == "\njaxftc: stopped; the files that are there are complete\n" and out == ""
    assert not list(tmp_path.iterdir()), "what was half written is gone"


def test_a_signal_that_was_to_be_ignored_is(process):
    program = "import os, signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\nfrom jaxftc.cli.stop import at_once\n"
    program += "with at_once(): os.kill(os.getpid(), signal.SIGINT)\nprint('went on')"
    assert process(program).communicate(timeout=30) == ("went on\n", "")


def test_nothing_heavy_is_loaded_before_somebody_answers_signals(process):
    program = (
        "import sys, jaxftc.cli.main; print({'tyro', 'numpy', 'jax', 'duckdb', 'importlib.metadata'} & set(sys.modules))"
    )
    assert process(program).communicate(timeout=30)[0] == "set()\n"


@pytest.mark.parametrize("closed", [(1,), (2,), (0, 1, 2), (0, 2)])
def test_a_closed_stream_leads_nowhere(tmp_path, closed):
    """Neither what is printed nor what a library prints may reach a file that got the stream's number."""
    program = f"""
import os, sys
for number in {closed}: os.close(number)
script = '''
import os
from jaxftc.cli.main import main
try: main(["simulate", "--torque", "nan", "--engine", "chain"])
except SystemExit as stop: code = stop.code
with open("file", "w") as file:
    assert file.fileno() > 2
    os.write(2, b"a library's warning")
open("code", "w").write(str(code))
'''
os.execv(sys.executable, [sys.executable, "-c", script])
"""
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=False, capture_output=True, timeout=60)
    assert Path(tmp_path / "code").read_text() == "2" and Path(tmp_path / "file").read_text() == ""


def test_a_reader_that_has_gone_is_no_traceback(tmp_path):
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, "--help"],
        stdout=writer,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    os.close(writer)
    assert "Traceback" not in done.stderr
