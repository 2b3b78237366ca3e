"""One tuning run on several processes: the gains of one process, one line where one of them is lost, and a rerun goes on."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from benchmarks.arms import serial
from jaxftc.compile import devices, processes
from jaxftc.compile.processes import Place, place
from jaxftc.io.toml import read_toml

# Where a process stands.


@pytest.mark.parametrize(
    ("given", "told", "found"),
    [
        (("node1:6000", 4, 3), {}, Place("node1", 6000, 4, 3)),
        (("[::1]:6000", 1, 0), {}, Place("::1", 6000, 1, 0)),
        ((None, None, None), {"JAX_COORDINATOR_ADDRESS": "a:1", "JAX_NUM_PROCESSES": "2", "JAX_PROCESS_ID": "1"},
         Place("a", 1, 2, 1)),
        (("n:9", None, None), {"OMPI_COMM_WORLD_RANK": "5", "OMPI_COMM_WORLD_SIZE": "8"}, Place("n", 9, 8, 5)),
        (("n:9", None, None), {"PMI_RANK": "0", "PMI_SIZE": "2"}, Place("n", 9, 2, 0)),
        (("n:9", 2, 1), {"SLURM_PROCID": "7", "SLURM_NTASKS": "8"}, Place("n", 9, 2, 1)),
        ((None, None, None),
         {"SLURM_STEP_NODELIST": "gpu-[007-012,30],login", "SLURM_JOB_ID": "4097", "SLURM_PROCID": "2", "SLURM_NTASKS": "6"},
         Place("gpu-007", 61441, 6, 2)),
        ((None, None, None),
         {"SLURM_STEP_NODELIST": "c1,c2", "SLURM_JOB_ID": "5", "SLURM_PROCID": "0", "SLURM_NTASKS": "2"},
         Place("c1", 61445, 2, 0)),
    ],
)  # fmt: skip
def test_options_come_before_the_launchers_words(given, told, found):
    assert place(*given, told) == found


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ((None, None, None), "needs the address of the first process; start it by srun, or give --coordinator"),
        ((None, 2, 0), "needs the address of the first process"),
        (("node1", 2, 0), "takes HOST:PORT, such as node1:6000, got 'node1'"),
        (("node1:99999", 2, 0), "takes HOST:PORT"),
        (("node1:6000", None, None), "neither options nor a launcher say which of how many processes this is"),
        (("node1:6000", 2, None), "neither options nor a launcher"),
        (("node1:6000", 2, 2), "from 0 to one less than --processes, got 2 of 2"),
        (("node1:6000", 0, 0), "got 0 of 0"),
    ],
)
def test_what_is_missing_is_said(given, why):
    with pytest.raises(ValueError, match=why):
        place(*given, {})


# The connection between them, without JAX.

PROGRAM = """
import sys, threading
from jaxftc.compile import processes
host, port, count, index, joining = sys.argv[1:]
processes.JOINING = float(joining)
try:
    line = processes.Line(processes.Place(host, int(port), int(count), int(index)))
except ValueError as error:
    sys.exit(str(error))
print("there", line.port, flush=True)
word = sys.stdin.readline().strip()
if word == "end":
    line.hang_up(processes.GOODBYE)
    threading.Event().wait(0.5)
elif word == "fail":
    line.hang_up(b"")
    threading.Event().wait(5)
else:
    threading.Event().wait(30)
"""


@pytest.fixture
def port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@pytest.fixture
def member(port):
    """Begin a process that is one of several; what is left of them is killed in the end."""
    running = []

    def call(index, count=3, joining=20):
        words = [sys.executable, "-c", PROGRAM, "127.0.0.1", str(port), str(count), str(index), str(joining)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
        running.append(subprocess.Popen(words, env=environment, **pipes))
        return running[-1]

    yield call
    for each in running:
        each.kill()
        each.communicate()


def ended(process, word=""):
    """Exit code, and what it said."""
    said = process.communicate(word, timeout=30)[1]
    return process.returncode, said.strip()


@pytest.mark.parametrize("lost", [0, 2])
@pytest.mark.parametrize("how", ["killed", "fail"])
def test_the_end_of_one_is_the_end_of_all(lost, how, member):
    """Also of those that are connected through the first alone; begun in any order."""
    every = [member(index) for index in (2, 1, 0)][::-1]
    ports = {each.stdout.readline() for each in every}
    assert len(ports) == 1 and ports.pop().startswith("there ")
    if how == "killed":
        every[lost].kill()
    else:
        every[lost].stdin.write("fail\n")
        every[lost].stdin.flush()
    why = f"jaxftc: process {lost} has ended, so all end; the same command goes on from the last checkpoint"
    for index in {0, 1, 2} - {lost}:
        assert ended(every[index]) == (2, why)


def test_all_may_come_to_their_end(member):
    every = [member(index) for index in range(3)]
    for each in every:
        each.stdout.readline()
    assert [ended(each, "end\n") for each in every] == [(0, "")] * 3


def test_processes_that_do_not_come_are_named(member):
    every = [member(index, count=4, joining=3) for index in (0, 2)]
    code, said = ended(every[0])
    assert (code, said) == (1, "of 4 processes only 0, 2 came within 3 s")
    assert ended(every[1]) == (1, "process 0 has ended; it says why")
    code, said = ended(member(1, joining=1))
    assert code == 1 and said.startswith("no process 0 at 127.0.0.1:")


def test_a_number_that_is_there_twice_is_refused(member):
    every = [member(0), member(1), member(1)]
    assert ended(every[0]) == (1, "process 1 of 3 came to process 0 of 3, or came twice")


def test_a_stranger_is_not_listened_to(member, port):
    server, said = member(0, count=2), b""
    for words in (b"GET / HTTP/1.1", processes.HELLO + (1).to_bytes(4) + (2).to_bytes(4)):
        with called(port) as peer:
            peer.sendall(words)
            said = peer.recv(2)
            if said:
                assert server.stdout.readline() == f"there {int.from_bytes(said)}\n"
                peer.sendall(processes.GOODBYE)
                assert ended(server, "end\n") == (0, "")
    assert said


def called(port):
    """A connection to a process that may not be there yet."""
    while True:
        try:
            return socket.create_connection(("127.0.0.1", port))
        except ConnectionRefusedError:
            time.sleep(0.05)


# Devices of several processes.


class Device:
    """What ``mesh_for`` asks of a device."""

    def __init__(self, process_index):
        self.process_index = process_index


@pytest.mark.parametrize(
    ("owners", "count", "used"),
    [([0, 0, 0], 6, 3), ([0, 0, 0], 4, 2), ([0, 0, 0], 7, 1), ([0, 0, 1, 1], 8, 4), ([0, 0, 1, 1], 6, 2), ([0, 1, 1], 8, 2)],
)
def test_each_process_gives_as_many_devices(owners, count, used, monkeypatch):
    monkeypatch.setattr(devices.jax, "devices", lambda: [Device(owner) for owner in owners])
    monkeypatch.setattr(devices, "Mesh", lambda array, names: array)
    mesh = devices.mesh_for(count)
    _, each = np.unique([device.process_index for device in mesh], return_counts=True)
    assert len(mesh) == used and set(each) == {used // len(set(owners))}


def test_a_batch_that_cannot_be_shared_is_refused(monkeypatch):
    monkeypatch.setattr(devices.jax, "devices", lambda: [Device(owner) for owner in range(3)])
    with pytest.raises(ValueError, match=r"batch.*multiple.* 3, got 64"):
        devices.mesh_for(64)


# The command.

COMMAND = "from jaxftc.cli.main import main; main()"
TUNE = ["tune", "--engine", "chain", "--observer", "pi", "--control", "smc", "--steps", "15", "--batch", "8", "--validation",
        "4", "--held-out", "8", "--held-out-seed", "1", "--duration", "0.2", "--seed", "5", "--json"]  # fmt: skip


@pytest.fixture(scope="module")
def tune(tmp_path_factory):
    """Begin the command on some cores; compiled programs stay in a cache of the module's own."""
    home = tmp_path_factory.mktemp("home")
    (home / "arm.xml").write_text(serial(2))
    told = ("JAX_", "SLURM_", "OMPI_", "TF_")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(told)}
    environment |= {"XDG_CACHE_HOME": str(home), "PYTHONPATH": str(Path(__file__).parents[2]), "JAX_PLATFORMS": "cpu"}

    def call(out, own, *words):
        every = [sys.executable, "-c", COMMAND, *TUNE, "--robot", str(home / "arm.xml"), "--out", str(out), *words]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        process = subprocess.Popen(every, env=environment, **pipes)
        os.sched_setaffinity(process.pid, own)  # it has yet to import JAX, which counts its cores
        return process

    return call


def two(tune, port, out, cores, *words):
    shared = ["--distributed", "--coordinator", f"127.0.0.1:{port}", "--processes", "2", *words]
    return [tune(out, {core}, *shared, "--process", str(k)) for k, core in enumerate(cores)]


def finish(process):
    printed, said = process.communicate(timeout=900)
    assert process.returncode == 0 and "Machine type" not in said, said  # which XLA says of its own cached programs
    return printed


def gains(folder):
    table = read_toml(folder / "gains.toml", "gains")
    del table["made_with"]
    return {f"{block}.{name}": np.array(gain["value"]) for block, found in table.items() for name, gain in found.items()}


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs a system that pins processes to cores")
def test_two_processes_tune_to_the_gains_of_one(tune, port, tmp_path):
    """One of them lost on the way, each in turn; the rerun goes on from the checkpoint."""
    cores = sorted(os.sched_getaffinity(0))[:2]
    if len(cores) < 2:
        pytest.skip("needs two cores: one for each process, and both for the one that they are held against")
    one = json.loads(finish(tune(tmp_path / "one", set(cores))))
    for lost, number in ((0, signal.SIGKILL), (1, signal.SIGTERM)):
        out = tmp_path / f"lost-{lost}-{number}"
        both = two(tune, port, out, cores)
        while not (out / "checkpoint.npz").exists() and both[0].poll() is None:
            time.sleep(0.02)
        both[lost].send_signal(number)
        began = time.monotonic()
        said = both[1 - lost].communicate(timeout=60)[1]
        assert time.monotonic() - began < 10 and both[1 - lost].returncode == 2
        last = f"jaxftc: process {lost} has ended, so all end; the same command goes on from the last checkpoint"
        assert said.strip().splitlines()[-1] == last
        both[lost].communicate(timeout=60)
        assert (out / "checkpoint.npz").exists() and not (out / "gains.toml").exists()
        first, second = two(tune, port, out, cores)
        found = json.loads(finish(first))
        assert finish(second) == ""
        assert found["steps"] == one["steps"] and found["best_step"] == one["best_step"]
        for name, value in gains(tmp_path / "one").items():
            np.testing.assert_allclose(gains(out)[name], value, rtol=1e-6, atol=1e-9, err_msg=name)
        assert found["held_out"]["standard"]["after"] == pytest.approx(one["held_out"]["standard"]["after"], rel=1e-6)
    assert one["best_step"] > 0, "gains that tuning has moved"


@pytest.mark.slow
def test_processes_that_were_begun_differently_are_refused(tune, port, tmp_path):
    cores = sorted(os.sched_getaffinity(0))
    first = tune(tmp_path / "run", set(cores), "--distributed", "--coordinator", f"127.0.0.1:{port}", "--processes", "2",
                 "--process", "0")  # fmt: skip
    second = tune(tmp_path / "run", set(cores), "--distributed", "--coordinator", f"127.0.0.1:{port}", "--processes", "2",
                  "--process", "1", "--weight", "delay=3")  # fmt: skip
    said = [each.communicate(timeout=300)[1].strip().splitlines()[-1] for each in (first, second)]
    assert (first.returncode, second.returncode) == (2, 2)
    assert "another objective" in said[1] and "same options" in said[1]
    assert said[0].startswith("jaxftc: process 1 has ended")
    assert not list((tmp_path / "run").glob("*.npz"))


@pytest.mark.slow
def test_a_batch_that_two_cannot_share_is_refused(tune, port, tmp_path):
    cores = sorted(os.sched_getaffinity(0))
    both = two(tune, port, tmp_path / "run", [cores[0], cores[-1]], "--batch", "7")
    said = [each.communicate(timeout=300)[1] for each in both]
    assert any("jaxftc: batch must be a multiple of the number of processes, 2, got 7" in text for text in said)
    assert {each.returncode for each in both} == {2} and "Traceback" not in "".join(said)
