"""Anything for an input: it is refused in one line, or taken as it was said. Thousands of cases, none compiles anything."""

import copy
import dataclasses
import json
import math
import tomllib

import numpy as np
import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import jaxftc
from jaxftc import logs
from jaxftc.campaigns import spec, store
from jaxftc.cli import common, results
from jaxftc.cli.main import COMMANDS, main, parse
from jaxftc.gains import specs
from jaxftc.io.folder import MARK, taken
from jaxftc.scenarios.preset_file import as_dict, load_preset
from jaxftc.scenarios.presets import PRESET_NAMES
from tests.arms import two_hinges
from tuning import checkpoint

CASES = {"options": 300, "gains": 600, "presets": 600, "logs": 300, "files": 300}
assert sum(CASES.values()) >= 2000

ODD = (
    st.sampled_from(
        [0, -1, 1, 0.5, 2.0, 2**31, 2**63, -(2**63), 10**22, 0.0, -0.0, 1e-320, 1e300, -1e300, math.inf, math.nan]
    )
    | st.sampled_from([True, False, "", "nan", "1e3", "a\nb", "\x00", "ü", [], [[]], {}, [1, 2], ["a"], {"a": 1}])
    | st.integers(-100, 100)
    | st.floats()
    | st.text(max_size=8)
    | st.lists(st.floats(-10, 10), max_size=7)
).map(copy.deepcopy)  # a list that went into a table may get entries there


def many(what):
    slow = [HealthCheck.too_slow, HealthCheck.function_scoped_fixture, HealthCheck.data_too_large]
    return settings(max_examples=CASES[what], suppress_health_check=slow)


def one_line(error: BaseException, *where: object) -> None:
    text = str(error)
    assert text.strip() and len(text) < 100_000
    assert all(str(place) in text for place in where), text


@pytest.fixture(scope="module")
def config():
    return jaxftc.Config(two_hinges(), engine="chain")


# Options.

WORDS = ["0", "-1", "1", "7", "1e3", "nan", "inf", "-inf", "1e308", "1e12", "0.05", "0.5", "9" * 20, "9" * 5000, "", " "]
WORDS += ["standard", "paper", "hard", "pi", "afesmc", "cascade,ekf", "cascade,", "no.toml", "no.xml", ".", "/", "a\nb", "ü"]
WORDS += ["--", "-", "lam", "control.lam", "control", "delay=3", "delay=nan", "delay=", "=", "None"]
WORD = st.sampled_from(WORDS) | st.text(max_size=6)


class Reached(Exception):
    """The options were taken: what follows would simulate."""


def option_names():
    """Every option of every command and its default, by command."""
    found = {}
    for command in [*COMMANDS, "tune"]:
        words = [command, "run"] if command == "view" else [command]
        found[command] = [("--" + name.replace("_", "-"), default) for name, default in results.given(parse(words))]
    return found


OPTIONS = option_names()


@st.composite
def lines(draw):
    """A command and up to three of its options, mostly with as many words as they take."""
    command = draw(st.sampled_from(sorted(OPTIONS)))
    words = [command, "run"] if command == "view" else [command]
    for name, default in draw(st.lists(st.sampled_from(OPTIONS[command]), max_size=3)):
        count = draw(st.sampled_from([0] * 5 + [1] if isinstance(default, bool) else [1] * 8 + [0, 2]))
        usual = st.just(str(default)) if isinstance(default, str) else st.sampled_from(["1", "0.5", "300"])
        words += [name, *draw(st.lists(usual | WORD, min_size=count, max_size=count))]
    return words


@pytest.fixture
def stubbed(monkeypatch, tmp_path):
    """Commands up to where they would simulate, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(common, "prepare", lambda options, **more: None)

    def reached(options, *rest, **more):
        raise Reached(options)

    monkeypatch.setattr(results, "folder", reached)
    monkeypatch.setattr("jaxftc.sample_scenarios", lambda *args, **more: None)
    monkeypatch.setattr("jaxftc.view.window.show", reached)
    monkeypatch.setattr("jaxftc.cli.common.load_arm", lambda options: ARM)
    return tmp_path


ARM = jaxftc.puma560()


@many("options")
@given(lines())
def test_options(stubbed, capsys, words):
    try:
        main(words)
    except Reached as reached:
        for name, value in results.given(reached.args[0]):
            option = "--" + name.replace("_", "-")
            assert not isinstance(value, float) or math.isfinite(value)
            if option in words and isinstance(value, int | float) and not isinstance(value, bool):
                last = max(at for at, word in enumerate(words) if word == option)
                assert float(words[last + 1]) == value, "as it was said"
    except SystemExit as stop:
        err = capsys.readouterr().err
        assert stop.code in (0, 2)
        assert stop.code == 0 or (err.strip() and "Traceback" not in err)
        assert not err.startswith("jaxftc: ") or err.count("\n") == 1
    assert not list(stubbed.iterdir())


# Gains.


@pytest.fixture(scope="module")
def gains_table(config, tmp_path_factory):
    path = tmp_path_factory.mktemp("gains") / "gains.toml"
    jaxftc.save_gains(path, jaxftc.default_gains(config), config)
    return tomllib.loads(path.read_text())


PLACES = st.sampled_from([(block, name) for block, name, _ in specs()])


@many("gains")
@given(data=st.data())
def test_gains(config, gains_table, tmp_path, data):
    """One to three entries of a good file changed, dropped or added."""
    table = json.loads(json.dumps(gains_table))
    for _ in range(data.draw(st.integers(1, 3))):
        block, name = data.draw(PLACES)
        entry = table[block].get(name)
        match data.draw(st.sampled_from([*["scale"] * 5, "value", "element", "unit", "entry", "drop", "stray"])):
            case "scale" if isinstance(entry, dict) and isinstance(entry.get("value"), list | float):
                entry["value"] = scaled(entry["value"], data.draw(st.floats(0.3, 3)))
            case "value" if isinstance(entry, dict):
                entry["value"] = data.draw(ODD)
            case "element" if isinstance(entry, dict) and isinstance(entry.get("value"), list) and entry["value"]:
                entry["value"][0] = data.draw(ODD)
            case "unit" if isinstance(entry, dict):
                entry["unit"] = data.draw(ODD)
            case "entry":
                table[block][name] = data.draw(ODD)
            case "drop":
                table[block].pop(name, None)
            case _:
                table[block][data.draw(st.text("abc_", min_size=1, max_size=5))] = data.draw(ODD)
    path = tmp_path / "gains.toml"
    path.write_text(toml(table), encoding="utf-8")
    try:
        gains = jaxftc.load_gains(path, config)
    except ValueError as error:
        one_line(error, path)
        return
    for block, name, _ in specs():
        value = np.asarray(getattr(getattr(gains, block), name))
        assert np.isfinite(value).all()
        asked = np.asarray(table[block][name]["value"], float)
        np.testing.assert_allclose(value, np.broadcast_to(asked, value.shape), rtol=1e-6)


def scaled(value, factor):
    """Every number of nested lists times a factor; what is no number as it is."""
    if isinstance(value, list):
        return [scaled(one, factor) for one in value]
    return value * factor if isinstance(value, float) else value


def toml(table):
    try:
        return tomli_w.dumps(table)
    except (TypeError, ValueError):
        return ""


# Presets.

LEAVES = [
    ("shares", "healthy"), ("shares", "both"), ("motion", "start_deg"), ("motion", "travel_deg"), ("encoder", "noise_rad"),
    ("joints", "at_once"), ("joints", "allowed"), ("times", "onset_s"), ("times", "permanent"), ("times", "lasting_s"),
    ("times", "incipient"), ("times", "intermittent"), ("plant", "mass"), ("plant", "payload_kg"), ("actuator", "bias"),
    ("actuator", "loss"), ("sensor", "drift"), ("sensor", "noise"), ("sensor_in_both", "bias"), ("nothing", "at_all"),
]  # fmt: skip
LAWS = (
    ODD
    | st.lists(ODD, max_size=3).map(lambda x: {"uniform": x})
    | st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)).map(lambda x: {"uniform": list(x)})
    | st.lists(st.floats(-5, 5), min_size=2, max_size=2).map(lambda x: {"normal": x, "within": [-1.0, 1.0]})
    | st.lists(ODD, max_size=3).map(lambda x: {"choice": x})
    | st.lists(ODD, max_size=3).map(lambda x: {"size": {"choice": x}, "unit": "N m"})
    | st.floats(allow_nan=False).map(lambda x: {"size": x, "unit": "deg"})
    | st.integers().map(lambda x: {"share": x, "rise_s": x})
)


SMALL = st.floats(0.01, 0.4)
LAW = (
    SMALL
    | st.tuples(SMALL, st.floats(0.5, 0.9)).map(lambda x: {"uniform": list(x)})
    | st.lists(SMALL, min_size=1, max_size=3).map(lambda x: {"choice": x})
    | SMALL.map(lambda x: {"normal": [x, 0.1], "within": [0.005, 0.9]})
)
GOOD = {  # where a law is not what belongs there
    "healthy": st.just(0.2), "both": st.just(0.2), "permanent": SMALL, "at_once": st.integers(1, 3),
    "allowed": st.lists(st.integers(1, 3), min_size=1, max_size=3, unique=True),
    "incipient": st.builds(lambda share, law: {"share": share, "rise_s": law}, SMALL, LAW),
    "intermittent": st.builds(lambda share, law: {"share": share, "period_s": law, "duty": 0.5}, SMALL, LAW),
    "bias": LAW.map(lambda law: {"size": law}), "loss": LAW.map(lambda law: {"size": law}),
    "drift": LAW.map(lambda law: {"size": law}), "noise": LAW.map(lambda law: {"size": law}),
}  # fmt: skip


@many("presets")
@given(data=st.data())
def test_presets(config, tmp_path, data):
    """What is taken is what was written, key by key, and can be drawn from by this arm or is refused for it."""
    table = {"base": data.draw(st.sampled_from([*PRESET_NAMES, *["standard", "hard"] * 5, 3, "harder"]))}
    for block, name in data.draw(st.lists(st.sampled_from(LEAVES), min_size=1, max_size=3)):
        if data.draw(st.integers(0, 9)) == 0:
            table[block] = data.draw(ODD)
        elif isinstance(table.setdefault(block, {}), dict):
            table[block][name] = data.draw(GOOD.get(name, LAW) if data.draw(st.integers(0, 2)) else LAWS)
    path = tmp_path / "preset.toml"
    path.write_text(toml(table), encoding="utf-8")
    try:
        preset = load_preset(path)
    except ValueError as error:
        one_line(error, path)
        assert "\n" not in str(error)
        return
    back = as_dict(preset)
    path.write_text(tomli_w.dumps(back), encoding="utf-8")
    assert load_preset(path) == preset, "written and read again it is the same"
    for value in numbers(back):
        assert math.isfinite(value) and abs(np.float32(value)) < np.inf
    for block, entries in tomllib.loads(toml(table)).items():
        for name, value in entries.items() if isinstance(entries, dict) else ():
            assert said(back[block][name], value), f"{block}.{name} was changed"


def numbers(value):
    if isinstance(value, dict | list):
        for one in value.values() if isinstance(value, dict) else value:
            yield from numbers(one)
    elif isinstance(value, float | int) and not isinstance(value, bool):
        yield value


def said(got, asked):
    """Whether what is there is what was asked for, defaults apart."""
    if isinstance(asked, dict):
        return isinstance(got, dict) and all(said(got[key], value) for key, value in asked.items())
    return got == asked


# Logs.

CELLS = [
    "0",
    "0.001",
    "-1",
    "nan",
    "inf",
    "-inf",
    "1e300",
    "",
    " ",
    "x",
    "0,5",
    "true",
    "2020-01-01",
    '"',
    "'",
    "1e-320",
    "NULL",
]
HEADS = ["t", "q1", "q2", "q3", "tau1", "tau2", "tau3", "y_joint1", "q1", "T", "", "time"]


@many("logs")
@given(data=st.data())
def test_logs(config, tmp_path, data):
    """A log of rest with cells, columns and rows out of order: finite, or refused with its file's name."""
    heads = HEADS[:7]
    t = np.arange(150) * data.draw(st.sampled_from([1e-3, 1e-3, 1e-3, 2e-3, 1e-2]))
    rows = [[f"{x:.4f}", "0", "0.1", "0.2", "1", "2", "3"] for x in t]
    for _ in range(data.draw(st.integers(0, 3))):
        match data.draw(st.sampled_from(["cell", "head", "drop", "swap", "cut", "noise"])):
            case "cell":
                rows[data.draw(st.integers(0, len(rows) - 1))][data.draw(st.integers(0, 6))] = data.draw(
                    st.sampled_from(CELLS)
                )
            case "head":
                heads = [*heads[:2], data.draw(st.sampled_from(HEADS)), *heads[3:]]
            case "drop":
                del rows[data.draw(st.integers(0, len(rows) - 1))]
            case "swap":
                rows[3], rows[7] = rows[7], rows[3]
            case "cut":
                rows = rows[: data.draw(st.integers(8, len(rows)))]
            case _:
                heads = [data.draw(st.text(max_size=3)), *heads[1:]]
    path = tmp_path / "log.csv"
    path.write_bytes("\n".join(",".join(row) for row in [heads, *rows]).encode("utf-8", "replace"))
    try:
        log = logs.read(path, config)
    except ValueError as error:
        one_line(error, path)
        return
    assert np.isfinite(log.q).all() and np.isfinite(log.tau).all() and log.q.shape == log.tau.shape
    assert np.abs(log.q).max() < 1e6


# Files of ours.


@pytest.fixture(scope="module")
def state(config, tmp_path_factory):
    folder = tmp_path_factory.mktemp("state")
    job = spec.Job(config, jaxftc.default_gains(config), load_preset("standard"), 3)
    _, manifest = spec.begin(folder, job, {"scheme": "cascade", "seed": 3}, None)
    store.write_manifest(folder, manifest | {"chunk": 10})
    for chunk in store.chunks(folder, 20, 10):
        store.keep(chunk, store.write_chunk(chunk, {"scenario_id": chunk.ids, "delay_s": chunk.ids / 7}))
    checkpoint.write(folder / checkpoint.NAME, {"a": 1}, {"x": np.arange(9.0)})
    (folder / MARK).write_text(json.dumps({"command": "campaign", "request": {"seed": 3}}))
    names = [path.name for path in folder.iterdir()]
    return folder, {name: (folder / name).read_bytes() for name in sorted(names)}


@many("files")
@given(data=st.data())
def test_files_of_ours(config, state, data):
    """Cut, replaced, flipped, taken from one another: every number that is read is the one that was written."""
    folder, whole = state
    name = data.draw(st.sampled_from(sorted(whole)))
    text = whole[name]
    match data.draw(st.sampled_from(["cut", "flip", "other", "random", "insert", "gone"])):
        case "cut":
            text = text[: data.draw(st.integers(0, len(text)))]
        case "flip":
            at = data.draw(st.integers(0, len(text) - 1))
            text = text[:at] + bytes([text[at] ^ data.draw(st.integers(1, 255))]) + text[at + 1 :]
        case "other":
            text = whole[data.draw(st.sampled_from(sorted(whole)))]
        case "random":
            text = data.draw(st.binary(max_size=100))
        case "insert":
            at = data.draw(st.integers(0, len(text)))
            text = text[:at] + data.draw(st.binary(min_size=1, max_size=8)) + text[at:]
        case _:
            text = None
    path = folder / name
    try:
        path.unlink() if text is None else path.write_bytes(text)
        checked(lambda: read_campaign(folder, config))
        checked(lambda: read_checkpoint(folder))
        checked(lambda: mark(folder))
    finally:
        path.write_bytes(whole[name])
        for extra in {file.name for file in folder.iterdir()} - whole.keys():
            (folder / extra).unlink()
        (folder / MARK).write_bytes(whole[MARK])


def checked(read):
    try:
        read()
    except ValueError as error:
        one_line(error)
        assert "\n" not in str(error)


def read_campaign(folder, config):
    base = dataclasses.replace(config)
    assert spec.load(folder, base).seed == 3
    rows = store.read_rows(folder, 20)
    np.testing.assert_array_equal(rows["delay_s"], rows["scenario_id"] / 7)


def read_checkpoint(folder):
    found = checkpoint.read(folder / checkpoint.NAME, {"a": 1})
    assert found is None or np.array_equal(found["x"], np.arange(9.0))


def mark(folder):
    with taken(folder, "campaign", {"seed": 3}):
        pass
