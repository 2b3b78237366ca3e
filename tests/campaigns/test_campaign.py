"""A campaign's folder and command: rows that survive, and that depend on nothing but their scenario."""

import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import duckdb
import jax
import numpy as np
import pytest

import jaxftc
from jaxftc.campaigns import spec as jobs
from jaxftc.campaigns import store
from jaxftc.campaigns.calibrate import by_joint
from jaxftc.cli import common
from jaxftc.cli.main import main
from jaxftc.evaluation import comparison, summary
from jaxftc.io.files import SUFFIX
from jaxftc.io.folder import MARK
from jaxftc.io.tables import write_parquet
from jaxftc.report import campaign as report
from jaxftc.scenarios.preset_file import load_preset
from jaxftc.variants import variants
from tests.arms import two_hinges_file

SHORT = ["--duration", "0.4", "--seed", "5", "--robot", str(two_hinges_file())]
PROGRAM = "from jaxftc.cli.main import main; main()"


def with_job(change):
    """The program with a constant of ``job`` changed."""
    return f"from jaxftc.campaigns import spec; spec.{change}; {PROGRAM}"


@pytest.fixture(scope="module")
def run(request):
    """Run the command in a fresh process; compiled programs stay in pytest's cache folder."""
    home = str(request.config.cache.mkdir("commands"))
    environment = {k: v for k, v in os.environ.items() if k != "TF_CPP_MIN_LOG_LEVEL"}  # JAX sets it where it is imported

    def call(*arguments, code=0, **more):
        command = [sys.executable, "-c", more.pop("program", PROGRAM), *map(str, arguments)]
        done = subprocess.run(
            command, capture_output=True, text=True, env=environment | {"XDG_CACHE_HOME": home}, check=False, **more
        )
        assert done.returncode == code, done.stderr
        return done

    call.home = home
    return call


@pytest.fixture
def refused(monkeypatch, capsys):
    """Run a command that must be refused, in this process, and return its one line on stderr."""
    monkeypatch.setattr(common, "prepare", lambda options, **settings: None)

    def call(*arguments):
        with pytest.raises(SystemExit) as stop, jax.enable_x64(False):
            main(list(map(str, arguments)))
        said = capsys.readouterr().err
        assert stop.value.code == 2 and len(said.strip().splitlines()) == 1, said
        return said

    return call


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory):
    """A campaign of 300 scenarios of 0.4 s."""
    out = tmp_path_factory.mktemp("campaign") / "run"
    done = run("campaign", "-n", 300, "--out", out, "--worst", 1, "--json", *SHORT)
    return out, json.loads(done.stdout)


def rows_of(folder, n=300):
    return store.read_rows(folder, n)


def assert_same_rows(one, other):
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def test_columns_read_one_by_one_are_those_of_the_rows(folder, tmp_path, monkeypatch):
    """Several chunks, the last of them cut, with room for two columns."""
    out, printed = folder
    rows = rows_of(out)
    monkeypatch.setattr(store, "KEPT", 2)
    for name in (store.GAINS, store.PRESET):
        shutil.copy(out / name, tmp_path)
    store.write_manifest(tmp_path, store.read_manifest(out) | {"chunk": 64})
    for chunk in store.chunks(tmp_path, 300, 64):
        store.keep(chunk, store.write_chunk(chunk, {name: column[chunk.ids] for name, column in rows.items()}))
    assert_same_rows(dict(store.Columns(tmp_path, 300)), rows)
    assert_same_rows(dict(store.Columns(tmp_path, 70)), {name: column[:70] for name, column in rows.items()})
    columns = store.Columns(tmp_path, 300)
    assert len(columns) == len(rows) and "nothing" not in columns
    found = summary.summarise(columns, "cascade")
    assert found == summary.summarise(rows, "cascade") == {name: printed[name] for name in found}
    with pytest.raises(ValueError, match="holds no rows; run jaxftc campaign"):
        store.Columns(tmp_path, 0)


def test_json_is_the_summary_with_every_promised_key(folder):
    out, printed = folder
    assert printed == json.loads((out / "summary.json").read_text())
    promised = {"n", "scheme", "false_alarm_runs", "detection", "isolation_kind", "isolation_joint", "delay_median_s"}
    assert promised | {"by_kind", "confusion", "scenario_steps_per_s"} <= printed.keys()
    assert printed["n"] == 300 and printed["scheme"] == "cascade" and np.sum(printed["confusion"]) == 300
    assert set(printed["delay_median_s"]) == {"actuator", "sensor", "both"}


def test_parquet_has_every_promised_column_and_one_row_a_scenario(folder):
    out, _ = folder
    promised = """scenario_id, kind, joint_tau, joint_q, onset_s, clear_s, magnitude, unit, detected, delay_s, false_alarm,
    kind_hat, joint_hat, fault_tau_rmse_nm, fault_q_rmse_deg, tracking_rmse_deg, chattering, effort"""
    found = duckdb.sql(f"select {promised} from '{out}/chunk-*.parquet'").fetchnumpy()
    np.testing.assert_array_equal(np.sort(found["scenario_id"]), np.arange(300))
    assert set(found["kind"]) == {"normal", "actuator", "sensor", "both"}


def test_nothing_but_whole_files_is_left(folder):
    out, _ = folder
    rows = {"manifest.toml", "gains.toml", "preset.toml", "SHA256SUMS", "chunk-000000.parquet"}
    assert {path.name for path in out.iterdir()} == {".jaxftc", "summary.json", "report.html"} | rows


def test_the_summary_counts_what_the_rows_say(folder):
    out, printed = folder
    rows = rows_of(out)
    faulty = rows["kind"] != "normal"
    assert printed["detection"] == rows["detected"][faulty].mean()
    assert printed["false_alarm_runs"] == rows["false_alarm"][~faulty].mean()
    detected = faulty & rows["detected"]
    assert printed["isolation_kind"] == (rows["kind"] == rows["kind_hat"])[detected].mean()
    for kind in ("actuator", "sensor", "both"):
        middle = np.median(rows["delay_s"][rows["kind"] == kind])
        assert printed["delay_median_s"][kind] == (middle if np.isfinite(middle) else None)
        for said in ("normal", "actuator", "sensor", "both"):
            where = [["normal", "actuator", "sensor", "both"].index(name) for name in (kind, said)]
            count = ((rows["kind"] == kind) & (rows["kind_hat"] == said)).sum()
            assert printed["confusion"][where[0]][where[1]] == count
    quiet = faulty & ~rows["false_alarm"]  # an alarm that is up from before the onset crosses nothing after it
    np.testing.assert_array_equal(rows["delay_at_1.000_s"][quiet], rows["delay_s"][quiet])
    at_one = printed["roc"]["scale"].index(1.0)
    crossed = np.isfinite(rows["delay_at_1.000_s"])[rows["kind"] == "actuator"]
    assert printed["roc"]["detection"]["actuator"][at_one] == crossed.mean()
    share = [x for x in printed["roc"]["false_alarm_runs"] if x is not None]
    assert share == sorted(share, reverse=True), "higher thresholds, fewer alarms"
    assert sum(part["n_faults"] for part in printed["by_kind"].values()) == faulty.sum()


@pytest.mark.thorough
@pytest.mark.parametrize("option", [("--decision", "learned"), ("--contact", "1")], ids=["decision", "contact"])
def test_a_replay_has_the_campaign_s_own_decision(option, run, tmp_path):
    run("campaign", "-n", 3, "--worst", 0, "--out", tmp_path / "run", *option, *SHORT)
    done = run("simulate", "--from", tmp_path / "run", "--id", 2, "--out", tmp_path / "again", "--json")
    assert json.loads(done.stdout)["same_as_stored"] is True
    manifest = store.read_manifest(tmp_path / "run")
    name = option[0].removeprefix("--")
    assert str(manifest["request"][name]) == str(manifest["config"][name]) == option[1]


def test_a_replay_reproduces_the_row_to_the_last_bit(folder, run, refused, tmp_path):
    out, _ = folder
    done = run("simulate", "--from", out, "--id", 123, "--out", tmp_path, "--json")
    result = json.loads(done.stdout)
    assert result["same_as_stored"] is True and result["row"]["scenario_id"] == 123
    assert len(result["joints"]) == 2 and (tmp_path / "trace.parquet").exists()
    later = json.loads(run("simulate", "--from", out, "--id", 100000, "--out", tmp_path, "--force", "--json").stdout)
    assert later["same_as_stored"] is None, "not run yet, but no less defined"
    assert "--observer does nothing with --from" in refused("simulate", "--from", out, "--id", 1, "--observer", "pi")


def test_a_stopped_campaign_goes_on_and_a_longer_one_too(folder, run, tmp_path, monkeypatch):
    """In small chunks, on another number of devices: a torn, a missing and a short file are run again, nothing else."""
    out, _ = folder
    whole = rows_of(out)
    program = with_job("CHUNK = 100")
    command = ["campaign", "--out", tmp_path, "--worst", 0, *SHORT]
    one_core = (
        "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}); " if hasattr(os, "sched_setaffinity") else ""
    )
    run(*command, "-n", 250, program=one_core + program)
    assert_same_rows(rows_of(tmp_path, 250), {name: column[:250] for name, column in whole.items()})
    (tmp_path / "chunk-000000.parquet").unlink()
    torn = tmp_path / "chunk-000001.parquet"
    torn.write_bytes(torn.read_bytes()[:-100])
    (tmp_path / f".chunk-000001.parquet.0{SUFFIX}").write_bytes(b"half a file")
    done = run(*command, "-n", 300, program=program)
    assert re.search(r"chunk-000001.parquet .*checksum.*run again", done.stdout)
    assert re.search(r"chunk-000002.parquet .*shorter", done.stdout)
    assert_same_rows(rows_of(tmp_path), whole)
    assert not list(tmp_path.glob(f"*{SUFFIX}"))
    kept = {path: path.read_bytes() for path in tmp_path.glob("chunk-*")}
    run(*command, "-n", 120, program=program)
    assert kept == {path: path.read_bytes() for path in tmp_path.glob("chunk-*")}, "fewer scenarios lose no row"


def test_a_campaign_does_not_go_on_from_gains_that_were_changed(folder, refused, tmp_path):
    """Its rows would be those of two sets of gains."""
    out, _ = folder
    changed = tmp_path / "changed"
    shutil.copytree(out, changed)
    gains = changed / store.GAINS
    gains.write_text(gains.read_text() + "# another\n")
    words = "gains.toml is not the file that this campaign began with; put it back"
    assert words in refused("campaign", "-n", 300, "--out", changed, *SHORT)
    assert words in refused("simulate", "--from", changed, "--id", 7)


def test_rows_without_a_manifest_are_nobodys(refused, tmp_path):
    write_parquet(tmp_path / "chunk-000000.parquet", {"scenario_id": np.arange(10)})
    assert "holds files that are no result of jaxftc's" in refused("campaign", "-n", 10, "--out", tmp_path, *SHORT)
    (tmp_path / MARK).write_text(json.dumps({"command": "campaign", "request": {}}))
    assert "holds chunks but no manifest.toml" in refused("campaign", "-n", 10, "--out", tmp_path, *SHORT)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (["--seed", "6"], "--seed 5, asked for 6"),
        (["--scheme", "momentum"], "--scheme 'cascade', asked for 'momentum'"),
        (["--preset", "hard"], "--preset standard of content "),
        (["--compare", "pi,eso"], "holds the campaign of one scheme"),
        (["--no-coulomb"], "--coulomb True, asked for False"),
        (["--false-alarms", "0.02"], "--false-alarms left out, asked for 0.02"),
    ],
)
def test_another_campaign_in_the_same_folder_is_refused(folder, refused, change, words):
    out, _ = folder
    before = {path: path.read_bytes() for path in out.iterdir()}
    said = refused("campaign", "-n", 300, "--out", out, *SHORT, *change)
    assert words in said and "another --out" in said
    assert before == {path: path.read_bytes() for path in out.iterdir()}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-n", "0"], "-n must be an integer of at least 1, got 0"),
        (["--preset", "standart"], "did you mean 'standard'?"),
        (["--compare", "cascade,ekv"], "did you mean 'ekf'?"),
        (["--compare", "cascade"], "--compare takes two or more different schemes"),
        (["--false-alarms", "2"], "false_alarms must lie in (0, 1), got 2.0"),
        (["--gains", "nothing.toml"], "cannot read gains from nothing.toml"),
        (["--out", "/proc/nothing"], "cannot write results"),
        (["--seed", "-1"], "--seed must lie in 0"),
        (["--duration", "0.05"], "no fault of preset 'standard' begins within 0.05 s; the first onset is at 0.1 s"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(refused, tmp_path, arguments, words):
    assert words in refused("campaign", *arguments, *(() if "--out" in arguments else ("--out", tmp_path)))


def test_a_folder_without_a_campaign_is_refused(refused, tmp_path):
    assert "holds no campaign" in refused("simulate", "--from", tmp_path, "--id", 1)
    assert "go together" in refused("simulate", "--id", 1)


def test_a_full_disk_is_told_and_leaves_whole_files(tmp_path):
    """Limited file size stands in for a full disk: the write fails half way."""
    program = f"""
import pathlib, resource, signal, numpy as np
from jaxftc.io.tables import write_parquet
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
folder = pathlib.Path({str(tmp_path)!r})
write_parquet(folder / "chunk-000000.parquet", {{"x": np.zeros(10)}})
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
try:
    write_parquet(folder / "chunk-000001.parquet", {{"x": np.random.default_rng(0).random(100000)}})
except OSError as error:
    print(error)
"""
    assert resource.RLIMIT_FSIZE and signal.SIGXFSZ
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"cannot write {tmp_path}/chunk-000001.parquet")
    assert [path.name for path in tmp_path.iterdir()] == ["chunk-000000.parquet"]


def test_what_keeps_a_chunk_from_being_used(tmp_path):
    chunk = store.Chunk(tmp_path / "chunk-000002.parquet", 20, 10)
    assert store.fault_of(chunk) == store.ABSENT
    for ids, fault in ((np.arange(20, 30), None), (np.arange(20, 40), None), (np.arange(20, 29), store.SHORTER)):
        store.keep(chunk, store.write_chunk(chunk, {"scenario_id": ids}))
        assert store.fault_of(chunk) == fault
    write_parquet(chunk.path, {"scenario_id": np.arange(20, 30)})
    assert store.fault_of(chunk) == store.DAMAGED, "whose is it?"


def test_the_manifest_says_what_the_rows_depend_on(folder):
    out, _ = folder
    manifest = tomllib.loads((out / "manifest.toml").read_text())
    assert manifest["request"]["seed"] == 5 and manifest["request"]["scheme"] == "cascade"
    assert manifest["config"]["dt"] == 1e-3 and manifest["config"]["duration"] == 0.4
    assert manifest["made_with"].keys() == {"jaxftc", "jax", "mujoco"}
    assert load_preset(out / "preset.toml") == load_preset("standard")


def test_every_scheme_has_one_name_everywhere():
    text = (Path(jaxftc.__file__).parents[1] / "docs" / "campaigns.md").read_text()
    assert all(f"`{name}`" in text for name in variants())


def test_scenarios_of_a_campaign_are_its_own(puma):
    """The same number as a seed for tuning and for calibration draws other scenarios there."""
    config = jaxftc.Config(puma, engine="chain")
    job = jobs.Job(config, jaxftc.default_gains(config), load_preset("standard"), 0)
    keys = [*job.keys, *jax.random.split(jax.random.key(0), 3)]
    assert len({tuple(np.asarray(jax.random.key_data(k)).tolist()) for k in keys}) == len(keys)


def test_schemes_are_compared_scenario_by_scenario():
    """Hand-made rows: a scheme that is late by a factor, and as often early as late."""
    kind = np.array(["actuator"] * 40 + ["normal"] * 5)
    delay = np.where(kind == "normal", np.nan, 0.010)
    base = {name: np.full(45, 1.0) for name in comparison.ERRORS} | {"kind": kind, "delay_s": delay}
    slow = base | {"delay_s": delay * 2, "tracking_rmse_deg": np.full(45, 0.5)}
    blind = base | {"delay_s": np.where(kind == "normal", np.nan, np.inf)}
    (pair, other) = comparison.against({"ours": base, "slow": slow, "blind": blind})
    assert (pair["earlier"], pair["later"], pair["same"], pair["delay"]) == (40, 0, 0, "wins")
    assert pair["tracking_rmse_deg"]["value"] == 2.0 and pair["tracking_rmse_deg"]["word"] == "loses"
    assert pair["chattering"]["word"] == "ties" and other["delay"] == "wins"
    text = comparison.pairs_as_text([pair])
    assert "wins delay; loses tracking (2.00); ties" in text


def test_the_best_of_each_column_carries_a_star():
    def result(detection, delay):
        errors = dict.fromkeys(comparison.ERRORS, 1.0)
        shares = dict.fromkeys(("false_alarm_runs", "isolation_kind", "isolation_joint"), 0.5)
        return shares | {
            "calibration": None,
            "n_by_kind": dict.fromkeys(summary.FAULTY, 1),
            "detection": detection,
            "delay_median_s": dict.fromkeys(summary.FAULTY, delay),
            "errors": errors,
        }

    one, other = comparison.cells({"one": result(0.9, 0.010), "other": result(0.8, None)})
    assert one[2] == "90.00*" and other[2] == "80.00" and one[5] == "10*" and other[5] == "missed"
    assert "*" not in one[1], "a calibrated share of false alarms is no merit"


@pytest.mark.thorough
def test_schemes_run_on_the_same_scenarios_at_the_same_false_alarms(run, tmp_path):
    program = with_job("HEALTHY = 300")
    command = ["campaign", "-n", 60, "--compare", "momentum,computed_torque", "--false-alarms", 0.05, "--out", tmp_path]
    done = run(*command, "--worst", 0, "--json", *SHORT, program=program)
    printed = json.loads(done.stdout)
    assert printed == json.loads((tmp_path / "summary.json").read_text())
    momentum, blind = (printed["schemes"][name] for name in ("momentum", "computed_torque"))
    assert momentum["calibration"]["false_alarm_runs_95"][0] <= 0.05 and blind["calibration"] is None
    assert momentum["detection"] > 0.5 and blind["detection"] == 0 and blind["delay_median_s"]["actuator"] is None
    rows = [rows_of(tmp_path / name, 60) for name in ("momentum", "computed_torque")]
    for name in ("kind", "magnitude_tau", "onset_s"):
        np.testing.assert_array_equal(rows[0][name], rows[1][name])
    assert {pair["kind"] for pair in printed["pairs"]} == {"actuator", "sensor", "both"}
    assert all(pair["delay"] == "wins" for pair in printed["pairs"] if pair["kind"] == "actuator")
    page = (tmp_path / "report.html").read_text()
    assert page.count("<figure") == 3 and "momentum against computed_torque" in page
    before = {path: path.read_bytes() for path in tmp_path.rglob("chunk-*")}
    again = json.loads(run(*command, "--worst", 0, "--json", *SHORT, program=program).stdout)
    assert again["schemes"]["momentum"]["calibration"] == momentum["calibration"], "thresholds are set once"
    assert before == {path: path.read_bytes() for path in tmp_path.rglob("chunk-*")}


@pytest.mark.thorough
def test_calibrate_writes_gains_that_a_campaign_takes(run, refused, tmp_path):
    command = ["calibrate", "--scheme", "momentum", "--runs", 300, "--false-alarms", 0.05, "--out", tmp_path, "--json"]
    printed = json.loads(run(*command, *SHORT).stdout)
    assert printed == json.loads((tmp_path / "result.json").read_text())
    assert printed["false_alarm_runs_95"][0] <= 0.05 and printed["runs"] == printed["fresh_runs"] == 150
    config = jaxftc.Config(jaxftc.load_robot(two_hinges_file()), engine="chain", duration=0.4)
    with jax.enable_x64(False):
        gains = jaxftc.load_gains(printed["gains"], config)
    np.testing.assert_allclose(gains.diagnosis.alpha_tau, list(printed["alpha_tau_nm"].values()), rtol=1e-6)
    assert (gains.diagnosis.lead == 0).all()
    assert "has no diagnosis" in refused("calibrate", "--scheme", "computed_torque", "--out", tmp_path)
    said = run("calibrate", "--runs", 100, "--out", tmp_path, "--force", code=2).stderr  # in a process of its own
    assert "too few" in said.splitlines()[-1] and "Traceback" not in said
    assert "diagnosis.lead must lie in [0, inf) 1/s^2" in refused("calibrate", "--lead", -1, "--out", tmp_path)


def test_rows_say_whose_they_are(folder):
    rows = rows_of(folder[0])
    assert set(rows["scheme"]) == {"cascade"} and set(rows["seed"]) == {5}


def test_everything_that_ran_is_said(folder):
    out, printed = folder
    ran = printed["provenance"]
    assert ran["command"] == f"jaxftc campaign -n 300 --out {out} --worst 1 --json {' '.join(SHORT)}"
    assert ran["robot"]["name"] == "two" and ran["config"]["duration"] == 0.4 and ran["seed"] == 5
    assert ran["preset"] == {"name": "standard", "base": "standard", "changes": {}} and ran["gains"] is None
    assert ran["gains_that_ran"]["sha256"] in (out / "SHA256SUMS").read_text()
    page = (out / "report.html").read_text()
    for text in (ran["command"], ran["robot"]["fingerprint"], ran["versions"]["jax"], ran["gains_that_ran"]["sha256"]):
        assert text in page
    assert printed["thresholds"]["alpha_tau_nm"]["joint1"] == 2.0 and "joint1 2" in page


def test_a_damaged_chunk_is_named_by_a_replay(folder, refused, tmp_path):
    shutil.copytree(folder[0], tmp_path / "copy")
    chunk = tmp_path / "copy" / "chunk-000000.parquet"
    chunk.write_bytes(chunk.read_bytes() + b"x")
    said = refused("simulate", "--from", tmp_path / "copy", "--id", 1, "--out", tmp_path / "replay")
    assert f"{chunk} is not what its checksum says; the command that made the campaign runs its rows again" in said
    assert not (tmp_path / "replay").exists()


FLAGS = ("diverged", "false_alarm", "unsure", "unsure_settled")


def table_of(**columns):
    """Rows of a summary, made by hand; what is not given is 1 throughout."""
    count = len(columns["kind"])
    names = {*summary.ERRORS, *summary.MORE, *summary.CROSSINGS, "isolated_s", "recovery_s", "healthy_ratio", "delay_s"}
    names |= {"visible_s", "complete_s"}
    rest = dict.fromkeys(names, np.ones(count)) | {name: np.zeros(count, bool) for name in FLAGS}
    parts = [
        f"{part}_{word}{when}" for part in summary.ISOLATION for word in ("right", "visible") for when in ("", "_settled")
    ]
    right = {name: np.ones(count, bool) for name in (*parts, "detected")}
    return rest | right | {"onset_s": np.full(count, 0.1)} | columns


def test_alarms_that_have_gone_are_no_misses():
    """Two actuator faults said to be normal: one was missed, of the other the alarm was over."""
    kind = np.array(["actuator"] * 4 + ["normal"])
    said = np.array(["actuator", "actuator", "normal", "normal", "normal"])
    rows = table_of(kind=kind, kind_hat=said, fault=kind, detected=np.array([True, True, True, False, False]))
    found = summary.summarise(rows, "cascade")
    assert found["confusion"][1] == [2, 2, 0, 0] and found["alarm_gone"] == [0, 1, 0, 0]
    figure = report.confusion(found)
    assert "1 ended" in figure.data[0].text[1][0] and "ended" not in figure.data[0].text[0][0]
    assert "ended" in figure.layout.meta["note"]


def test_the_trade_off_does_not_bend_back():
    """Thresholds so low that alarms are up before the fault find less: the curve ends before."""
    share = [0.2, 0.6, 0.9, 0.9, 0.5]
    roc = {"scale": [0.25, 0.5, 1.0, 2.0, 4.0], "false_alarm_runs": [1.0, 1.0, 0.3, 0.1, 0.0]}
    roc |= {"detection": dict.fromkeys(summary.FAULTY, share), "delay_median_s": dict.fromkeys(summary.FAULTY, share)}
    drawn = report.trade_off({"cascade": {"roc": roc, "n_healthy": 10}}).data[0]
    assert list(drawn.x) == [30.0, 10.0, 5.0] and list(drawn.y) == [90.0, 90.0, 50.0]
    assert list(drawn.customdata) == [1.0, 2.0, 4.0]


def test_faults_below_the_thresholds_are_told(puma):
    config = jaxftc.Config(puma)
    gains = jaxftc.default_gains(config)  # 2 N m and 1 deg on every joint
    rows = {"fault_tau": np.array(["bias"] * 4 + ["loss"]), "joint_tau": np.array([1, 2, 3, 6, 1])}
    rows |= {"magnitude_tau": np.array([-1.0, 1.9, 0.5, 2.1, 0.1]), "fault_q": np.array([""] * 5)}
    found = summary.small(rows, gains)
    assert found == {"actuator bias": 0.75}
    lines = comparison.thresholds({"thresholds": by_joint(config, gains), "small_faults": found})
    assert "joint1 2, joint2 2" in lines[0] and lines[1].startswith("Thresholds, deg of the encoder: joint1 1,")
    assert lines[2].startswith("75 % OF THE ACTUATOR BIAS FAULTS ARE SMALLER than their joint's threshold")
    assert len(comparison.thresholds({"thresholds": {}, "small_faults": {"actuator bias": 0.4}})) == 0


def test_the_report_shows_what_the_summary_says(folder):
    out, printed = folder
    page = (out / "report.html").read_text()
    assert page.count("<figure") == 4, "confusion, delays, trade-off, and the worst scenario"
    assert f"{100 * printed['detection']:.2f}" in page and "jaxftc simulate --from" in page
    for fault in printed["by_kind"]:
        assert fault in page


@pytest.mark.slow
def test_both_engines_give_the_same_verdicts(puma):
    """200 scenarios of `standard` in single precision: every verdict the same, errors to 1 % for 95 % of them."""
    with jax.enable_x64(False):
        rows = []
        for engine in ("chain", "mjx"):
            config = jaxftc.Config(puma, engine=engine)
            scenarios = jaxftc.sample_scenarios(jax.random.key(8), 200, config=config)
            rows.append(jaxftc.campaign(config, jaxftc.default_gains(config), scenarios, jax.random.key(9)))
    chain, mjx = rows
    for name in ("detected", "kind_hat", "joint_hat"):
        assert (chain[name] == mjx[name]).mean() >= 0.99, name
    for name in ("fault_tau_rmse_nm", "tracking_rmse_deg", "chattering"):
        assert np.quantile(np.abs(mjx[name] / chain[name] - 1), 0.95) < 0.01


@pytest.mark.slow
def test_a_campaign_killed_twenty_times_loses_nothing(folder, run, tmp_path):
    """Kill -9 at random moments, the same command again each time: the rows are those of a campaign left alone."""
    out, _ = folder
    program = with_job("CHUNK = 20")
    rows_at, warm = tmp_path / "run", tmp_path / "warm"
    command = [sys.executable, "-c", program, "campaign", "-n", "300", "--out", str(rows_at), "--worst", "0", *SHORT]
    environment = os.environ | {"XDG_CACHE_HOME": run.home}
    chance, killed = random.Random(1), 0
    subprocess.run([*command[:4], "-n", "1", "--out", str(warm), *SHORT], env=environment, check=True, capture_output=True)
    while killed < 20:
        process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + chance.uniform(0.5, 6.0)
        while process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)
        if process.poll() is None:
            process.kill()
            killed += 1
        process.wait()
        assert process.returncode in (0, -signal.SIGKILL)
        if process.returncode == 0:  # it came to its end: start over, with the files it has but for a few
            for path in chance.sample(sorted(rows_at.glob("chunk-*.parquet")), 10):
                path.unlink()
    subprocess.run(command, env=environment, check=True, capture_output=True)
    assert_same_rows(rows_of(rows_at), rows_of(out))
    assert len(rows_of(rows_at)["scenario_id"]) == 300
