"""Chunks of a campaign as tasks of workers: lost, repeated and out of order they give the bytes of one machine."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from arms import two_hinges

import jaxftc
from benchmarks.arms import serial
from jaxftc.campaigns import cluster, spec, store, tasks
from jaxftc.io.files import SUFFIX
from jaxftc.scenarios.preset_file import load_preset

ROWS, CHUNKS = 8, 5
PROGRAM = "from jaxftc.cli.main import main; main()"


@pytest.fixture(scope="module")
def job():
    config = jaxftc.Config(two_hinges(), engine="chain", duration=0.02)
    return spec.Job(config, jaxftc.default_gains(config), load_preset("standard"), 3)


@pytest.fixture
def begin(job, monkeypatch):
    """A campaign's folder with no rows yet, as the command leaves it."""
    monkeypatch.setattr(spec, "CHUNK", ROWS)

    def call(folder):
        folder.mkdir()
        spec.begin(folder, job, {"scheme": "cascade"}, None)
        return folder

    return call


@pytest.fixture(scope="module")
def expected(job, tmp_path_factory):
    """Every file of the campaign when one process runs it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(spec, "CHUNK", ROWS)
        folder = tmp_path_factory.mktemp("one") / "run"
        folder.mkdir()
        spec.begin(folder, job, {"scheme": "cascade"}, None)
    spec.complete(folder, job, ROWS * CHUNKS, lambda count: None)
    return files(folder)


def files(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def complete(folder, job, workers, done=lambda count: None):
    return spec.complete(folder, job, ROWS * CHUNKS, done, run=tasks.spread(workers, cached=False))


class Threads:
    """Workers of this process: the interface of a cluster, with losses that a test chooses."""

    cores = 2

    def __init__(self, runs=lambda fun, *args: fun(*args)):
        self._pool, self._runs = ThreadPoolExecutor(self.cores), runs

    @staticmethod
    def share(value):
        return lambda: value

    def submit(self, fun, /, *args):
        return self._pool.submit(self._runs, fun, *args)


@pytest.mark.thorough
def test_workers_write_what_one_process_does(job, begin, expected, tmp_path):
    told, folder = [], begin(tmp_path / "run")
    progress = complete(folder, job, Threads(), told.append)
    assert files(folder) == expected
    assert told == [ROWS] * CHUNKS and progress.run == ROWS * CHUNKS and progress.kept == 0


def test_a_task_may_run_again_at_any_time(job, begin, expected, tmp_path):
    """A worker lost after it had written, one that was only thought to be lost, and one that had begun to write."""
    folder = begin(tmp_path / "run")
    earlier = []

    def twice(fun, task, chunk):
        chunk.path.with_name(f".{chunk.path.name}.0{SUFFIX}").write_bytes(b"PAR1")
        found = [fun(task, chunk), fun(task, chunk)]
        for other in earlier:
            fun(task, other)
        earlier.append(chunk)
        assert found[0] == found[1]
        return found[0]

    complete(folder, job, Threads(twice))
    assert files(folder) == expected


class Backwards:
    """Workers that answer the last task first, and only when as many wait as may."""

    cores = 2

    def __init__(self):
        self.waiting, self.most = [], 0

    share = staticmethod(Threads.share)

    def submit(self, fun, /, *args):
        future = Future()
        self.waiting.append((future, fun, args))
        self.most = max(self.most, len(self.waiting))
        if len(self.waiting) == min(tasks.AHEAD * self.cores, self.left):
            while self.waiting:
                last, fun, args = self.waiting.pop()
                last.set_result(fun(*args))
                self.left -= 1
        return future


def test_no_more_tasks_are_given_out_than_wait_for_a_core(job, begin, expected, tmp_path):
    folder, workers = begin(tmp_path / "run"), Backwards()
    workers.left = CHUNKS
    complete(folder, job, workers)
    assert workers.most == tasks.AHEAD * workers.cores < CHUNKS
    assert files(folder) == expected


def test_what_is_there_is_kept_and_what_has_no_checksum_is_run_again(job, begin, expected, tmp_path):
    """The process that gives out the tasks was killed between a worker's file and its checksum."""
    folder, asked = begin(tmp_path / "run"), []
    first, second, *_ = store.chunks(folder, ROWS * CHUNKS, ROWS)
    store.keep(first, spec.write(job, first, lambda count: None))
    spec.write(job, second, lambda count: None)

    def listed(fun, task, chunk):
        asked.append(chunk.first)
        return fun(task, chunk)

    assert complete(folder, job, Threads(listed)).kept == ROWS
    assert sorted(asked) == [ROWS * k for k in range(1, CHUNKS)] and files(folder) == expected


def test_an_error_of_a_worker_is_the_campaigns_and_what_is_there_stays(job, begin, tmp_path):
    folder = begin(tmp_path / "run")

    def full(fun, task, chunk):
        if chunk.first == 3 * ROWS:
            raise OSError("the disk is full")
        return fun(task, chunk)

    with pytest.raises(OSError, match="the disk is full"):
        complete(folder, job, Threads(full))
    assert complete(folder, job, Threads()).kept >= ROWS


def test_a_machine_that_would_write_other_rows_is_refused(job, begin, tmp_path, monkeypatch):
    folder = begin(tmp_path / "run")
    chunk = next(store.chunks(folder, ROWS, ROWS))
    asked = tasks._conditions(folder, cached=False)
    task = tasks.Task(lambda: job, asked)
    with pytest.raises(ValueError, match=r"here jaxftc 0, jax 1.*install the same"):
        tasks.run_chunk(task._replace(conditions=asked._replace(versions="jaxftc 0, jax 1")), chunk)
    elsewhere = chunk._replace(path=tmp_path / "elsewhere" / chunk.path.name)
    with pytest.raises(ValueError, match=r"elsewhere.*not the folder.*--out"):
        tasks.run_chunk(task, elsewhere)
    monkeypatch.setattr(tasks, "describe", lambda config: {"scheme_source": "edited"})
    with pytest.raises(ValueError, match=r"scheme 'cascade' is other code than here"):
        tasks.run_chunk(task._replace(conditions=asked._replace(folder=str(tmp_path))), chunk)
    assert not list(tmp_path.rglob("*.parquet"))


def refused(address):
    with pytest.raises(ValueError) as error, cluster.connect(address):
        pass
    assert "\n" not in str(error.value)
    return str(error.value)


def test_without_ray_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert "pip install 'jaxftc[cluster]'" in refused("local")


@pytest.mark.parametrize("error", [RuntimeError(), RuntimeError("lost\nits node"), MemoryError()])
def test_whatever_ends_a_task_ends_the_wait_for_it(error):
    """Also an error that says nothing: a chunk that is never answered would hold up the campaign for ever."""
    done, future = Future(), Future()
    done.set_exception(error)
    cluster._pass_on(done, future)
    said = str(future.exception(timeout=0))
    assert "chunk failed" in said and (str(error).splitlines() or [type(error).__name__])[-1] in said


def test_an_address_without_a_cluster_is_refused_at_once(monkeypatch):
    ray = type(sys)("ray")
    ray.init = ray.shutdown = None
    monkeypatch.setitem(sys.modules, "ray", ray)
    for wrong in ("loca", "node1", "node1:", ":6379", "node1:6379x", "node1:70000", "ray://node1:10001x"):
        assert f"HOST:PORT of a Ray head node such as node1:6379, got {wrong!r}" in refused(wrong)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        began, port = time.monotonic(), free.getsockname()[1]
        assert f"no Ray cluster answers at 127.0.0.1:{port}" in refused(f"127.0.0.1:{port}")
    assert time.monotonic() - began < 2 * cluster.PATIENCE


# Ray itself.


def of_ray(test):
    """Slow, and without warnings of what Ray does: it forks, beside JAX's threads, and leaves files open."""
    for warning in ("ignore:os.fork:RuntimeWarning", "ignore::pytest.PytestUnraisableExceptionWarning"):
        test = pytest.mark.filterwarnings(warning)(test)
    return pytest.mark.slow(test)


MANY = 24  # chunks, of some seconds each: Ray takes a while to miss a node
LENGTH = ["-n", str(MANY * spec.CHUNK), "--duration", "2", "--seed", "5", "--worst", "1"]


@pytest.fixture(scope="module")
def ray():
    return pytest.importorskip("ray", reason="pip install 'jaxftc[cluster]' brings it")


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    """Begin a campaign in a folder of its own; compiled programs stay in a cache of the module's own."""
    home = tmp_path_factory.mktemp("home")
    (home / "arm.xml").write_text(serial(2))
    environment = {k: v for k, v in os.environ.items() if not k.startswith("TF_")}  # JAX sets one where it is imported
    environment |= {"XDG_CACHE_HOME": str(home), "PYTHONPATH": str(Path(__file__).parents[2])}

    def call(out, *words):
        every = [
            sys.executable,
            "-c",
            PROGRAM,
            "campaign",
            "--robot",
            str(home / "arm.xml"),
            *LENGTH,
            "--out",
            str(out),
            *words,
        ]
        return subprocess.Popen(every, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)

    return call


@pytest.fixture(scope="module")
def nodes(ray, command):
    """Two nodes of one core each on this machine, and the address of the first."""
    cluster_utils = pytest.importorskip("ray.cluster_utils")
    size = {"num_cpus": 1, "object_store_memory": cluster.STORE}
    both = cluster_utils.Cluster(initialize_head=True, head_node_args=size | {"include_dashboard": False})
    try:
        yield both, both.head_node, both.add_node(**size)
    finally:
        both.shutdown()


def finish(running):
    said = running.communicate(timeout=900)[1]
    assert running.returncode == 0, said
    return said


def workers_of(node):
    """Process ids of the workers of a node that run, or ran, a chunk."""
    (raylet,) = (info.process.pid for info in node.all_processes["raylet"])
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == raylet and (path / "cmdline").read_bytes().startswith(b"ray::run_chunk"):
                found.append(int(path.name))
        except OSError:
            continue  # it has ended meanwhile
    return found


@of_ray
def test_a_worker_and_then_a_node_are_killed(nodes, command, tmp_path):
    """No row is lost, none is there twice, and every file is that of one process, to the last byte."""
    both, head, second = nodes
    finish(command(tmp_path / "one"))
    out = tmp_path / "run"
    running = command(out, "--cluster", both.address)

    def until(found):
        while not found() and running.poll() is None:
            time.sleep(0.02)
        assert running.poll() is None, "it ended before anything was killed"

    def there():
        return len(list(out.glob("chunk-*.parquet")))

    until(lambda: there() >= 2 and workers_of(head))
    for pid in workers_of(head):
        os.kill(pid, signal.SIGKILL)
    killed_at = there()
    until(lambda: there() >= killed_at + 2 and workers_of(second))
    both.remove_node(second, allow_graceful=False)
    assert there() < MANY / 2, "there is time to see that the node is gone"
    said = finish(running)
    assert "nodes 1, cores 1" in said and "Traceback" not in said

    one, run = files(tmp_path / "one"), files(out)
    times = {"summary.json", "report.html"}
    assert one.keys() == run.keys()
    assert {name for name in one if one[name] != run[name]} <= times
    np.testing.assert_array_equal(store.read_rows(out, MANY * spec.CHUNK)["scenario_id"], np.arange(MANY * spec.CHUNK))
    found = [json.loads(each["summary.json"]) for each in (one, run)]
    for each in found:
        for name in ("scenario_steps_per_s", "provenance"):
            del each[name]
    assert found[0] == found[1]


@of_ray
def test_what_answers_but_is_no_cluster_ends_in_one_line(ray, command, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as server:
        running = command(tmp_path / "run", "--cluster", f"127.0.0.1:{server.getsockname()[1]}")
        said = running.communicate(timeout=300)[1]
    assert running.returncode == 2 and "is no Ray cluster that this machine is a node of" in said.splitlines()[-1]


@of_ray
def test_a_cluster_of_this_machine_begins_and_ends_with_the_command(ray, command, tmp_path):
    before = set(Path("/proc").glob("[0-9]*"))
    out = tmp_path / "run"
    finish(command(out, "--cluster", "local", "-n", "300"))
    assert len(store.read_rows(out, 300)["scenario_id"]) == 300
    left = [path for path in set(Path("/proc").glob("[0-9]*")) - before if is_ours(path)]
    assert not left, "processes of the cluster that outlived it"


def is_ours(process):
    try:
        return b"ray" in (process / "cmdline").read_bytes() and b"pytest" not in (process / "cmdline").read_bytes()
    except OSError:
        return False
