"""The command line as a user meets it: help is quick, JSON is clean, refusals are one line and exit code 2."""

import ast
import json
import os
import re
import signal
import subprocess
import sys
from importlib.metadata import EntryPoint
from itertools import pairwise
from pathlib import Path

import duckdb
import numpy as np
import pytest

import jaxftc
from jaxftc.cli import common, results
from jaxftc.cli.main import commands, main, parse
from jaxftc.io.files import SUFFIX

QUICK = ["--engine", "chain", "--no-compilation-cache", "--duration", "0.3"]


def run(arguments, folder, **environment):
    command = [sys.executable, "-c", "from jaxftc.cli.main import main; main()", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, env=os.environ | environment, check=False)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulate")
    return folder, run(["simulate", "--scenario", "both", "--json", *QUICK], folder)


def test_json_is_the_only_thing_on_stdout(simulated):
    folder, done = simulated
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result == json.loads((folder / "runs" / "simulate-1" / "result.json").read_text())
    assert len(result["joints"]) == 6 and result["isolated"] is True and result["delay_s"] == 0.0


def test_trace_file_holds_every_signal(simulated):
    folder, _ = simulated
    rows = duckdb.sql(f"select * from '{folder / 'runs' / 'simulate-1' / 'trace.parquet'}'").fetchnumpy()
    assert len(rows["t"]) == 300
    for name in ("q", "qd", "y", "q_ref", "tau_applied", "fault_tau", "fault_q", "contact_tau", *jaxftc.Output._fields):
        assert name in rows or all(f"{name}_joint{j}" in rows for j in range(1, 7)), name
    fault = rows["fault_tau_joint3"]
    np.testing.assert_allclose(fault[(rows["t"] > 0.101) & (rows["t"] < 0.249)], 5.0, rtol=1e-4)
    np.testing.assert_array_equal(fault[rows["t"] < 0.099], 0.0)


def test_figures_open_offline(simulated):
    folder, _ = simulated
    page = (folder / "runs" / "simulate-1" / "figures.html").read_text()
    assert "<script src=" not in page and "torque residual, N m" in page
    assert not list((folder / "runs").rglob(f"*{SUFFIX}"))


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (
            ["simulate", "--t-final", "0.0155"],
            "jaxftc: t_final must be a multiple of dt = 0.001 s, got 0.0155 s; the nearest is 0.016 s",
        ),
        (
            ["simulate", "--robot", "no.xml"],
            "jaxftc: no robot file at no.xml; give an MJCF or URDF file, or 'puma560' for the",
        ),
        (["simulate", "--gains", "no.toml"], "jaxftc: cannot read gains from no.toml: "),
        (["simulate", "--torque", "nan"], "jaxftc: --torque must be a finite number, got nan"),
        (["simulate", "--out", "/proc/none"], "jaxftc: cannot write results: "),
        (["tune", "--only", "control.lamb"], "jaxftc: gain must be one of "),
        (
            ["tune", "--freeze", "observer", "control", "diagnosis"],
            "jaxftc: every gain is frozen, so there is nothing",
        ),
        (["tune", "--only", "control.alpha_sm"], "jaxftc: gain 'control.alpha_sm' does nothing with observer 'ts' and"),
        (["tune", "--gains", "broken.toml"], "jaxftc: broken.toml: observer.alpha_i must be finite, got [nan, "),
        (["tune", "--gains", "other.toml"], "jaxftc: other.toml holds gains for another robot 'puma560 without"),
        (["tune", "--gains", "orders.toml"], "jaxftc: orders.toml holds gains for another order_a 4, here 3; "),
        (["tune", "--batch", "0"], "jaxftc: batch must be an integer of at least 1, got 0; 64 suit two cores"),
        (["tune", "--anneal", "1", "0"], "jaxftc: anneal must be two positive factors"),
        (["bench", "--patience", "2"], "jaxftc: patience must be a share of the steps, at most 1, got 2.0"),
        (["tune", "--held-out", "1"], "jaxftc: --held-out must be an integer of at least 2, got 1"),
        (["bench", "ranking", "--held-out", "8"], "jaxftc: --held-out must be an integer of at least 32, got 8"),
    ],
)
def test_refusals_are_one_line(arguments, line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(common, "prepare", lambda options, **settings: None)
    if "tune" in arguments:
        gains_files()
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    err = capsys.readouterr().err
    assert stop.value.code == 2 and err.startswith(line) and err.count("\n") == 1
    assert not list(tmp_path.rglob("*.parquet"))


def gains_files():
    """Gains with a NaN, of an arm without dry friction, and of another order, in the working folder."""
    config = jaxftc.Config(jaxftc.puma560())
    jaxftc.save_gains("broken.toml", jaxftc.default_gains(config), config)
    text = Path("broken.toml").read_text()
    assert "680.0" in text
    Path("broken.toml").write_text(text.replace("680.0", "nan", 1))
    for name, other in (("other", jaxftc.puma560(coulomb=False)), ("orders", config.robot)):
        changed = jaxftc.Config(other, order_a=4 if name == "orders" else 3)
        jaxftc.save_gains(f"{name}.toml", jaxftc.default_gains(changed), changed)


UNKNOWN = [["tune", "--method", "cma"], ["simulate", "--engine", "bullet"], ["simulate", "--sped", "1"], ["fly"], []]


@pytest.mark.parametrize("arguments", UNKNOWN)
def test_unknown_options_exit_with_2(arguments, capsys):
    with pytest.raises(SystemExit) as stop:
        parse(arguments)
    assert stop.value.code == 2
    assert capsys.readouterr().err


def test_help_needs_no_jax(tmp_path):
    script = (
        "import sys\nfrom jaxftc.cli.main import main\n"
        "for words in ([], ['demo'], ['simulate'], ['tune'], ['bench']):\n"
        "    try: main([*words, '--help'])\n    except SystemExit as stop: assert stop.code == 0\n"
        "assert not {'jax', 'mujoco', 'numpy'} & set(sys.modules), 'help imported the heavy packages'"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "demo" in done.stdout and "--scenario" in done.stdout


def test_words_on_an_option_are_one_line():
    """The help keeps a line break of an option's own words, wherever that falls."""
    root, broken = Path(jaxftc.__file__).parents[1], []
    for path in (*root.glob("jaxftc/cli/*.py"), root / "tuning" / "cli.py", root / "benchmarks" / "cli.py"):
        for cls in (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ClassDef)):
            for field, words in pairwise(cls.body):
                if (
                    isinstance(field, ast.AnnAssign)
                    and isinstance(words, ast.Expr)
                    and "\n" in ast.literal_eval(words.value)
                ):
                    broken.append(f"{path.name}: {ast.unparse(field)}")
    assert not broken


@pytest.mark.parametrize("name", sorted(commands()))
def test_help_shows_no_none_and_no_markup(name, capsys):
    with pytest.raises(SystemExit):
        parse([name, "--help"])
    text = capsys.readouterr().out
    assert "--json" in text
    assert not [word for word in ("{None}", "(default: None)", "(default: )", "``") if word in text]


def test_help_lists_every_command_in_a_line(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    with pytest.raises(SystemExit):
        parse(["--help"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("•")[1].split()[0] for line in lines if "•" in line] == list(commands())
    assert len(lines) < len(commands()) + 16  # a first line each


def test_a_robot_file_needs_no_word_about_friction(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    body = "<body><joint axis='0 0 1'/><geom size='.1'/></body>"
    Path("arm.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    for command in (["simulate"], ["tune"], ["bench", "ranking"]):
        assert common.load_arm(parse([*command, "--robot", "arm.xml"])).n == 1
    assert common.load_arm(parse(["tune"])) == jaxftc.puma560()
    assert common.load_arm(parse(["tune", "--no-coulomb"])) == jaxftc.puma560(coulomb=False)
    with pytest.raises(ValueError, match="--coulomb is for the built-in arm"):
        common.load_arm(parse(["simulate", "--robot", "arm.xml", "--coulomb"]))


def test_run_folders_are_numbered(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = []
    for _ in range(3):
        with results.folder(parse(["simulate"]), "simulate") as folder:
            names.append(folder.name)
    assert names == ["simulate-1", "simulate-2", "simulate-3"]


@pytest.mark.slow
def test_demo_from_end_to_end(tmp_path):
    """The whole demo: schema of its JSON, one row a combination, a claim for each of the paper's, a report that opens."""
    done = run(["demo", "--engine", "chain", "--json", "--no-compilation-cache"], tmp_path)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert len(result["rows"]) == 4 * 3 * 3
    fixed = {"condition", "observer", "controller", "fault_tau_rms_nm", "fault_q_rms_deg", "delay_s", "isolated"}
    assert fixed | {"tracking_rms_deg", "chattering"} <= set(result["rows"][0])
    assert all({"id", "claim", "value", "unit", "met"} <= set(claim) for claim in result["claims"])
    page = (tmp_path / "runs" / "demo-1" / "report.html").read_text()
    assert all(claim["id"] and f"{claim['value']:.4g}" in page for claim in result["claims"])


def test_a_command_whose_package_is_missing_says_so(monkeypatch, capsys):
    """The wheel has no benchmarks, but their entry point."""
    entry = EntryPoint("bench", "no_such_package.cli:Bench", "jaxftc.commands")
    monkeypatch.setattr("jaxftc.cli.main.installed", lambda: [entry])
    with pytest.raises(SystemExit) as stop:
        main(["bench", "tuning"])
    assert stop.value.code == 2
    assert re.search(r"bench is not installed .*'no_such_package'", capsys.readouterr().err)


TINY = ["tune", "--observer", "pi", "--control", "smc", "--steps", "15", "--batch", "2", "--validation", "2"]  # three rounds
TINY += ["--held-out", "4", "--duration", "0.2", "--out", "run", "--json"]


@pytest.mark.slow
def test_tune_killed_and_resumed_is_tune_left_alone(tmp_path):
    """Kill -9 as soon as there is a checkpoint, then the same command again: the same gains file."""
    alone, killed = tmp_path / "alone", tmp_path / "killed"
    for folder in (alone, killed):
        folder.mkdir()
    done = run(TINY, alone)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert set(result["held_out"]) == {"standard", "hard"} and result["held_out"]["hard"].keys() >= {"before", "after"}
    assert {"steps", "simulations", "seconds", "gains"} <= result.keys() and result["steps"] == 15
    files = {path.name for path in (alone / "run").iterdir()}
    assert files == {".jaxftc", "checkpoint.npz", "gains.toml", "history.parquet", "report.html", "result.json"}
    rows = duckdb.sql(f"select * from '{alone / 'run' / 'history.parquet'}'").fetchnumpy()
    assert rows["step"].tolist() == [5, 10, 15] and "term_tracking" in rows
    page = (alone / "run" / "report.html").read_text()
    assert "<script src=" not in page and "Gain after over before" in page

    command = [sys.executable, "-c", "from jaxftc.cli.main import main; main()", *TINY]
    victim = subprocess.Popen(command, cwd=killed, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while not (killed / "run" / "checkpoint.npz").exists():
        assert victim.poll() is None, "it ended before it could be killed"
    victim.kill()
    assert victim.wait() == -signal.SIGKILL
    assert not (killed / "run" / "gains.toml").exists()
    done = run(TINY, killed)
    assert done.returncode == 0 and "Resuming from run/checkpoint.npz; --force" in done.stderr, done.stderr
    assert (killed / "run" / "gains.toml").read_bytes() == (alone / "run" / "gains.toml").read_bytes()
    done = run([*TINY, "--learning-rate", "0.05"], killed)
    assert done.returncode == 2 and "learning_rate 0.1, here 0.05" in done.stderr
