"""Files and folders: a path is a path, a changed bit is seen, nothing of anybody else's is replaced."""

import json
import os
import random
import re
import shutil
import stat
from pathlib import Path

import numpy as np
import pytest

import jaxftc
from jaxftc import logs
from jaxftc.campaigns import spec, store
from jaxftc.cli import common, record, results
from jaxftc.cli.main import main, parse
from jaxftc.io import checksums, files, tables
from jaxftc.io.folder import MARK, taken
from jaxftc.io.toml import read_toml
from jaxftc.scenarios.preset_file import load_preset
from tests.arms import three_hinges
from tuning import checkpoint

NAMES = ["a[1]", "a*", "a?", "kind=sensor", "~", "~root", "{a,b}", "$x", "a'b\"", "two\nlines", "%41", "s3:", "**", "ü"]


@pytest.fixture
def refused(monkeypatch, capsys):
    """Run a command that must be refused before JAX is set up; its one line on stderr."""
    monkeypatch.setattr(common, "prepare", lambda options, **settings: None)

    def call(*arguments):
        with pytest.raises(SystemExit) as stop:
            main([str(word) for word in arguments])
        out, err = capsys.readouterr()
        assert stop.value.code == 2 and err.count("\n") == 1 and not out, err
        return err

    return call


# Paths are paths.


@pytest.mark.parametrize("name", NAMES)
def test_a_path_is_no_pattern(name, tmp_path, monkeypatch):
    """Neither for DuckDB nor for a shell; absolute or not, as a folder and as a file."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for folder in ("a1", "ab", "home", name):
        Path(folder).mkdir(exist_ok=True)
        tables.write_parquet(Path(folder) / "x.parquet", {"kind": np.array([folder])})
        tables.write_parquet(Path(f"{folder}.parquet"), {"kind": np.array([folder])})
        Path(f"{folder}.csv").write_text("kind,b\n{},1\n".format('"' + folder.replace('"', '""') + '"'))
    for path in (Path(name) / "x.parquet", tmp_path / name / "x.parquet", Path(f"{name}.parquet"), Path(f"{name}.csv")):
        assert tables.read(path)["kind"].tolist() == [name]
    assert not list(Path("home").glob("*[!x].parquet"))


def test_a_log_is_the_file_that_was_named(tmp_path):
    config = jaxftc.Config(three_hinges())
    for name, angle in (("a1.csv", 1.0), ("a[1].csv", 0.5)):
        head = ",".join(["t", *(f"q{j}" for j in (1, 2, 3)), *(f"tau{j}" for j in (1, 2, 3))])
        lines = [f"{k / 1000},{angle},0,0,0,0,0" for k in range(200)]
        (tmp_path / name).write_text("\n".join([head, *lines]))
    assert logs.read(tmp_path / "a[1].csv", config).q[0, 0] == 0.5


@pytest.fixture
def campaign(tmp_path):
    """A campaign's folder, made without running one: two chunks of ten rows."""
    config = jaxftc.Config(three_hinges(), engine="chain")
    return filled(tmp_path / "campaign", config), config


def filled(folder, config, kind="normal"):
    folder.mkdir()
    job = spec.Job(config, jaxftc.default_gains(config), load_preset("standard"), 3)
    _, manifest = spec.begin(folder, job, {"scheme": "cascade", "seed": 3}, None)
    store.write_manifest(folder, manifest | {"chunk": 10})
    for chunk in store.chunks(folder, 20, 10):
        store.keep(
            chunk,
            store.write_chunk(chunk, {"scenario_id": chunk.ids, "kind": np.array([kind] * 10), "delay_s": chunk.ids / 7}),
        )
    return folder


def test_rows_are_those_of_the_folder_that_was_named(tmp_path):
    config = jaxftc.Config(three_hinges(), engine="chain")
    for name in ("kind=sensor", "run1", "run[1]"):
        filled(tmp_path / name, config, kind=name)
    for name in ("kind=sensor", "run1", "run[1]"):
        assert set(store.Columns(tmp_path / name, 20)["kind"]) == set(store.read_rows(tmp_path / name, 20)["kind"]) == {name}


# Bit rot.


def flipped(path, chance):
    """One bit of the file the other way round."""
    data = bytearray(path.read_bytes())
    bit = chance.randrange(8 * len(data))
    data[bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)


@pytest.mark.parametrize("name", ["chunk-000001.parquet", "manifest.toml", "gains.toml", "preset.toml", "SHA256SUMS"])
def test_one_flipped_bit_is_seen(campaign, name):
    """Of the checksums a flip may also leave nothing out: a line's end is no part of a name."""
    folder, _ = campaign
    rows, path, chance, seen = store.read_rows(folder, 20), folder / name, random.Random(1), 0
    whole = path.read_bytes()
    for _ in range(200):
        flipped(path, chance)
        faults = [store.fault_of(chunk) for chunk in store.chunks(folder, 20, 10)]
        try:
            store.check_inputs_unchanged(folder)
            found = store.read_rows(folder, 20)
        except ValueError as error:
            assert str(folder) in str(error) and "\n" not in str(error)
            found = None
        if name.startswith("chunk"):
            assert faults == [None, store.DAMAGED] and found is None, "run again on resume, named by a replay"
        else:
            assert found is None or all(np.array_equal(found[key], rows[key]) for key in rows)
            assert found is None or name == "SHA256SUMS"
        seen += found is None or store.DAMAGED in faults
        path.write_bytes(whole)
    assert seen == 200


def test_one_flipped_bit_of_a_checkpoint_is_seen(tmp_path):
    path, chance = tmp_path / checkpoint.NAME, random.Random(2)
    checkpoint.write(path, {"version": "1"}, {"x": np.arange(50.0)})
    assert checkpoint.read(path, {"version": "1"})["x"][7] == 7
    with np.load(path) as file:
        assert file["x"][7] == 7, "and it is still an npz"
    whole = path.read_bytes()
    for _ in range(200):
        flipped(path, chance)
        with pytest.raises(ValueError, match=r"checkpoint.*damaged.*remove it"):
            checkpoint.read(path, {"version": "1"})
        path.write_bytes(whole)
    for cut in (0, 1, 40, len(whole) - 1):
        path.write_bytes(whole[:cut])
        with pytest.raises(ValueError, match="is no checkpoint"):
            checkpoint.read(path, {"version": "1"})


@pytest.mark.parametrize("text", ["", "[", "chunk = 'x'", "files = 3", "[request]\nscheme = 7"])
def test_a_manifest_that_was_edited_is_named(campaign, text, refused):
    folder, _ = campaign
    (folder / store.MANIFEST).write_text(text)
    assert "manifest.toml is not the file that this campaign began with" in refused("simulate", "--from", folder, "--id", 1)


def test_checksums_are_those_of_sha256sum(campaign):
    folder, _ = campaign
    lines = (folder / checksums.NAME).read_text().splitlines()
    assert [line.split("  ")[1] for line in lines] == sorted(
        path.name for path in folder.iterdir() if path.name != "SHA256SUMS"
    )
    assert all(re.fullmatch(r"[0-9a-f]{64}  [\w.-]+", line) for line in lines)
    (folder / checksums.NAME).unlink()
    with pytest.raises(ValueError, match="is not the file that this campaign began with"):
        store.read_manifest(folder)


# Nothing of anybody else's is replaced.


def test_a_link_under_a_temporary_name_is_not_followed(tmp_path):
    target = tmp_path / "precious"
    target.write_text("mine")
    for name in ("report.html.tmp", "report.html"):
        (tmp_path / name).symlink_to(target)
    files.write_text(tmp_path / "report.html", "page")
    assert target.read_text() == "mine" and (tmp_path / "report.html.tmp").is_symlink()
    assert not (tmp_path / "report.html").is_symlink() and (tmp_path / "report.html").read_text() == "page"


def test_files_have_the_mode_that_the_user_asks_for(tmp_path):
    before = os.umask(0o027)
    try:
        files.write_text(tmp_path / "a", "text")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640


def test_what_a_killed_process_left_is_swept_away(tmp_path):
    left = tmp_path / f".report.html.00{files.SUFFIX}"
    left.write_text("half a pa")
    with taken(tmp_path, "demo", {}):
        assert not left.exists()


def options(out, **more):
    return common.Options(out=out, **more)


def test_one_folder_one_command_one_result_one_process(tmp_path):
    out = tmp_path / "new" / "run"
    refused = pytest.raises
    with results.folder(options(out), "simulate") as folder:
        (folder / "result.json").write_text("{}")
        with refused(ValueError, match="another jaxftc command writes to"), results.folder(options(out), "simulate"):
            pass
    with results.folder(options(out), "simulate"):
        pass  # the same again, which a run that was killed needs
    with refused(ValueError, match="holds what jaxftc simulate made; give another"), results.folder(options(out), "demo"):
        pass
    with (
        refused(ValueError, match=r"another result: --seed 0, asked for 1"),
        results.folder(options(out, seed=1), "simulate"),
    ):
        pass
    assert (out / "result.json").read_text() == "{}"
    with results.folder(options(out, seed=1, force=True), "demo"):
        pass
    with results.folder(options(out, seed=1), "demo"):
        pass


@pytest.mark.thorough
def test_a_folder_of_others_is_not_filled(tmp_path, refused):
    (tmp_path / "thesis.tex").write_text("")
    for command in (["simulate"], ["demo"], ["campaign"], ["calibrate"], ["tune"]):
        assert "holds files that are no result of jaxftc's" in refused(*command, "--out", tmp_path)
    assert os.listdir(tmp_path) == ["thesis.tex"]
    (tmp_path / "thesis.tex").rename(tmp_path / ".hidden")
    with results.folder(options(tmp_path), "simulate"):
        pass


@pytest.mark.parametrize("force", [[], ["--force"]])
def test_an_input_is_never_in_the_folder_for_results(tmp_path, monkeypatch, refused, force):
    monkeypatch.chdir(tmp_path)
    config = jaxftc.Config(jaxftc.puma560(), engine="chain")
    jaxftc.save_gains("gains.toml", jaxftc.default_gains(config), config)
    before = Path("gains.toml").read_bytes()
    said = refused("calibrate", "--gains", "gains.toml", "--out", ".", *force)
    assert "gains.toml" in said and "folder for results" in said
    assert Path("gains.toml").read_bytes() == before and os.listdir() == ["gains.toml"]


@pytest.mark.parametrize(
    "text", ["", "campaign\n", "[" * 100_000, '{"command": "campaign"}', '{"command": 1, "request": 2}']
)
def test_a_mark_that_is_none_of_ours_marks_nothing(tmp_path, text):
    (tmp_path / MARK).write_text(text)
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="no result of jaxftc's"), taken(tmp_path, "campaign", {}):
        pass


def test_force_begins_a_campaign_anew(campaign):
    folder, _ = campaign
    store.clear(folder)
    assert set(os.listdir(folder)) == {"gains.toml", "preset.toml"}


# TOML as editors leave it.


def test_a_byte_order_mark_is_no_part_of_a_file(tmp_path):
    config = jaxftc.Config(three_hinges())
    gains = jaxftc.default_gains(config)
    jaxftc.save_gains(tmp_path / "gains.toml", gains, config)
    (tmp_path / "preset.toml").write_text('base = "hard"\n')
    for path in tmp_path.iterdir():
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert np.array_equal(jaxftc.load_gains(tmp_path / "gains.toml", config).control.lam, gains.control.lam)
    assert load_preset(tmp_path / "preset.toml") == load_preset("hard")


@pytest.mark.parametrize("brackets", [500, 5000, 100_000])
def test_nested_brackets_are_refused_in_a_line(tmp_path, brackets):
    path = tmp_path / "deep.toml"
    path.write_text("x = " + "[" * brackets + "]" * brackets)
    with pytest.raises(ValueError, match=r"deep.toml: brackets.*deep"):
        read_toml(path, "gains")


# What ran.


def test_what_ran_is_said_in_full(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = jaxftc.Config(three_hinges(), engine="chain")
    jaxftc.save_gains("g.toml", jaxftc.default_gains(config), config)
    Path("mine.toml").write_text('base = "hard"\n[encoder]\nnoise_rad = 1e-5\n')
    words = ["campaign", "--gains", "g.toml", "--preset", "mine.toml", "--seed", "7", "--out", "two words"]
    ran = record.of(parse(words), config)
    assert ran["command"] == "jaxftc campaign --gains g.toml --preset mine.toml --seed 7 --out 'two words'"
    assert ran["robot"] == {"name": "three hinges", "fingerprint": config.robot.fingerprint}
    assert ran["preset"] == {"name": "mine.toml", "base": "hard", "changes": {"encoder": {"noise_rad": 1e-5}}}
    assert ran["seed"] == 7 and ran["config"]["engine"] == "chain" and ran["config"]["dt"] == 0.001
    assert ran["gains"] == {"file": "g.toml", "sha256": files.digest(Path("g.toml"))}
    assert ran["options"]["n"] == 1000 and ran["options"]["coulomb"] is True and "out" not in ran["options"]
    assert ran["versions"].keys() == {"jaxftc", "jax", "mujoco"}
    assert json.loads(json.dumps(ran, allow_nan=False)) == ran
    default = record.of(parse(["simulate"]), config)
    assert default["gains"] is default["preset"] is None


def test_copies_of_a_campaign_are_campaigns(campaign, tmp_path):
    folder, _ = campaign
    shutil.copytree(folder, tmp_path / "copy")
    assert store.read_rows(tmp_path / "copy", 20).keys() == {"scenario_id", "kind", "delay_s"}
