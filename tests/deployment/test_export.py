"""The exported tick: C code and StableHLO that do what ``jaxftc.step`` does, and say what they are."""

import hashlib
import json
import re
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxftc
from benchmarks import arms
from jaxftc.cli import common
from jaxftc.cli.main import main
from jaxftc.compile import c99, native
from jaxftc.compile.scalars import scalars
from jaxftc.diagnosis import threshold
from jaxftc.export import check, stablehlo
from jaxftc.export.artifact import Native, StableHLO
from jaxftc.export.tick import precision
from jaxftc.export.tick import tick as make_tick
from jaxftc.variants import variants
from tests.arms import two_hinges
from tests.backends import needs_c

STRICT = ("-Wall", "-Wextra", "-Werror", "-pedantic")
SANITIZED = ("-fsanitize=undefined,address", "-fno-sanitize-recover=all", "-O0")


def config(scheme="cascade", robot=None, **settings):
    changed = variants()[scheme] | settings
    return jaxftc.Config(robot or two_hinges(), engine="chain", **changed)


def written(folder, settings, **options):
    with precision("double"):
        gains = jaxftc.default_gains(settings)
        gains = gains.replace(dict(zip(threshold.GAINS, (0.3, 0.02, 0.5, 0.1, 0.4), strict=True)))  # thresholds that move
    return jaxftc.export.write(settings, gains, folder, **options)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Folders by kind: constants in double precision, and gains at run time in single precision."""
    folders = {"double": tmp_path_factory.mktemp("double"), "float": tmp_path_factory.mktemp("float")}
    return {
        real: (folder, written(folder, config(), real=real, gains_at_run_time=real == "float"))
        for real, folder in folders.items()
    }


class Off:
    """An artifact that is off by a little in one signal, or says another verdict once."""

    def __init__(self, artifact, tick, *, verdict):
        self.artifact, self.verdict = artifact, verdict
        self.at = [leaf.name for leaf in tick.leaves()["out"]].index("verdict" if verdict else "tau")
        self.init = artifact.init

    def step(self, state, signals):
        after, out = self.artifact.step(state, signals)
        out[self.at] = out[self.at].copy()
        if not self.verdict:
            out[self.at] *= 1.001
        elif np.abs(signals[3][0] - signals[0][0]).max() > 0:
            out[self.at][0, 0] += 1
        return after, out


def assert_met(found, ticks):
    assert found.met and found.ticks >= ticks, found
    assert set(found.error) == set(check.KINDS) and found.alarms > 100


@pytest.mark.thorough
@needs_c
def test_the_files_do_what_step_does_under_every_fault(exported):
    folder, tick = exported["double"]
    code = Native(folder, tick)
    artifacts = {"C": code, "StableHLO": StableHLO(folder, tick)}
    artifacts |= {"off": Off(code, tick, verdict=False), "other": Off(code, tick, verdict=True)}
    found = check.compare(tick, artifacts, ticks=1000, run=250)
    assert_met(found["C"], 1000)
    assert_met(found["StableHLO"], 1000)
    assert not found["off"].met and found["off"].verdicts == 0 and found["off"].worst == "out.tau"
    assert not found["other"].met and found["other"].verdicts > 0


@pytest.mark.thorough
@needs_c
def test_single_precision_with_gains_at_run_time_too(exported):
    folder, tick = exported["float"]
    assert_met(check.compare(tick, {"C": Native(folder, tick)}, ticks=1000, run=250)["C"], 1000)


@pytest.mark.slow
@needs_c
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("scheme", sorted(variants()))
def test_every_scheme_on_the_built_in_arm(scheme, real, tmp_path):
    tick = written(tmp_path, config(scheme, jaxftc.puma560()), real=real)
    found = check.compare(tick, {"C": Native(tmp_path, tick)})["C"]
    assert found.met and found.ticks == check.TICKS, found


@pytest.mark.slow
@needs_c
def test_no_code_in_single_precision_can_agree_better_on_what_is_learned(tmp_path):
    """One count of the arithmetic in the readings moves the learned numbers by more than other signals may differ."""
    tick = written(tmp_path, config("adaptive", jaxftc.puma560()), real="float")
    code = Native(tmp_path, tick)
    learned = [i for i, leaf in enumerate(tick.leaves()["state"]) if f"state.{leaf.name}".startswith(check.LEARNED)]
    moved, size = np.zeros(len(learned)), np.zeros(len(learned))
    with precision("float"):
        for before, signals, _, _ in check._reference(tick, list(check.KINDS), 200, 0):
            near = [*signals[:3], np.nextafter(signals[3], np.float32(10)), *signals[4:]]
            (here, _), (there, _) = (code.step(before, told) for told in (signals, near))
            moved = np.maximum(moved, [np.abs(here[i] - there[i]).max() for i in learned])
            size = np.maximum(size, [np.abs(here[i]).max() for i in learned])
    assert len(learned) == 3 and (moved / size).max() > check.TOLERANCE["float"]


@pytest.mark.parametrize("scheme", sorted(variants()))
def test_every_scheme_becomes_code(scheme):
    settings = config(scheme, sign="hard")
    with precision("double"):
        tick = make_tick(settings, jaxftc.default_gains(settings))
        program = scalars(tick.step, *tick.step_arguments)
    assert 200 < len(program.operations) < 3000  # the extended Kalman filter's grow with the cube of the joints
    assert len(program.results) == len(tick.leaves()["state"]) + len(jaxftc.Output._fields)


@needs_c
@pytest.mark.parametrize("real", ["double", "float"])
def test_compilers_have_nothing_to_say(exported, real, tmp_path):
    folder, _ = exported[real]
    native.build([folder / "ftc_step.c"], tmp_path / "ftc_step.o", "-c", *STRICT)
    source = (folder / "ftc_step.c").read_text()
    assert not re.search(r"\b(for|while|goto|malloc)\b|\bstatic [^i]", source), "no loop, no memory"
    assert set(re.findall(r"#include [<\"]([\w.]+)", source)) == {"ftc_step.h", "math.h"}
    names = {"cos", "sin", "tanh", "exp", "expm1", "sqrt", "fabs", "rint", "floor"}  # of math.h
    called = set(re.findall(r"\b(?!ftc_)([a-z]\w*)\(", re.sub(r"/\*.*?\*/", "", source)))
    assert called <= names | {f"{name}f" for name in names} | {"isfinite"}, called


@needs_c
@pytest.mark.parametrize("real", ["double", "float"])
def test_the_example_runs_clean(exported, real, tmp_path):
    folder, _ = exported[real]
    assert len((folder / "example.c").read_text().splitlines()) <= 80
    (tmp_path / "empty.c").write_text("int main(void) { return 0; }\n")
    try:
        native.build([tmp_path / "empty.c"], tmp_path / "empty", *SANITIZED)
    except ValueError as error:
        pytest.skip(f"this compiler has no sanitizers: {error}")
    native.build([folder / "example.c", folder / "ftc_step.c"], tmp_path / "example", *STRICT, *SANITIZED)
    done = subprocess.run([tmp_path / "example"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    assert done.stdout == "0.2 s joint1: sensor\n400 ticks\n"


@pytest.mark.parametrize("real", ["double", "float"])
def test_the_header_says_what_it_is(exported, real):
    folder, tick = exported[real]
    header, gains = (folder / "ftc_step.h").read_text(), (folder / "gains.toml").read_bytes()
    sha256 = hashlib.sha256(gains).hexdigest()
    defined = {"GAINS_SHA256": f'"{sha256}"', "SAMPLE_TIME": "0.001", "JOINT_NAMES": '{"joint1", "joint2"}'}
    defined |= {"TORQUE_LIMITS": "{80.0, 40.0}", "JOINTS": "2"}
    for name, value in defined.items():
        assert f"#define FTC_{name} {value}" in header, name
    assert f"typedef {real} ftc_real;" in header
    out = header.partition("What the tick says.")[2].partition("} ftc_out;")[0]
    for leaf in tick.leaves()["out"]:
        assert re.search(rf"\b{leaf.name}(\[2\])?; /\* .+ \*/", out), leaf.name
    assert ("ftc_default_gains" in header) == (real == "float")
    metadata = json.loads((folder / "ftc.json").read_text())
    assert {"scheme": "cascade", "adaptive": False, "decision": "rule"}.items() <= metadata.items()
    assert re.search(r"decision +rule", header) and "FTC_UNKNOWN, FTC_CONTACT = 8" in header and "``" not in header
    assert metadata["gains_sha256"] == sha256 and metadata["robot_fingerprint"] == two_hinges().fingerprint


def test_the_code_shows_the_papers_boxes_in_their_order(exported):
    folder, _ = exported["double"]
    step = (folder / "ftc_step.c").read_text().partition("void ftc_step")[2]
    found = [int(number) for number in re.findall(r"/\* Block (\d)", step)]
    assert set(found) == set(range(2, 10)) | {1}
    first = {number: found.index(number) for number in found}
    assert first[1] < first[2] < first[3] < first[5] < first[8] < first[9] and first[6] < first[7]


def test_boxes_leave_no_mark_in_programs_that_are_not_exported():
    settings = config("computed_torque")
    gains, zero = jaxftc.default_gains(settings), jnp.zeros(2)
    state = jaxftc.init(settings, gains, zero)
    signals = jaxftc.Reference(zero, zero, zero), jaxftc.Measurement(zero, zero)
    text = str(jax.make_jaxpr(lambda s: jaxftc.step(settings, gains, s, *signals))(state))
    assert "box" not in text


NASTY = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 0.5, -2.5, 3.7, -1e10])


def nasty(x, y, k):
    """Where C's own answer is another than XLA's, or there is none."""
    most = np.iinfo(np.int32).max
    return {
        "max": jnp.maximum(x, y),
        "min": jnp.minimum(x, y),
        "clip": jnp.clip(x, -1.0, y),
        "sign": jnp.sign(x),
        "round": jnp.round(x),
        "away": jax.lax.round(x, jax.lax.RoundingMethod.AWAY_FROM_ZERO),
        "where": jnp.where(x > y, x, jnp.where(jnp.isfinite(x), y, 0.0)),
        "ordered": (x == y) | ~(x < y) ^ (x >= 0),
        "integer": x.astype(jnp.int32),
        "wrapped": k + jnp.int32(most) - 3 * k,
        "bits": (k & 12) | ~k,
        "counted": (x > 0).astype(jnp.int32) + (y > 0),
        "true": jnp.where(x.astype(bool), 1.0, 2.0),
        "power": x**3 + x**-2,
        "logistic": jax.nn.sigmoid(y),
        "sums": jnp.stack([x, y]).sum(0) + x.max() + jnp.flip(y)[:1],
        "any": (x > 1e5).any(),
        "same": jnp.eye(3)[1] * 2.0 - jnp.arange(3),
    }


@pytest.mark.thorough
@needs_c
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_the_table_means_what_xla_means(dtype):
    with np.errstate(over="ignore"):
        x, y = (part.ravel().astype(dtype) for part in np.meshgrid(NASTY, NASTY))
    k = np.arange(len(x), dtype=np.int32) - 5
    theirs = jax.jit(nasty)(x, y, k)
    ours = native.function(lambda *args: [nasty(*args)[name] for name in theirs], x, y, k)(x, y, k)
    for (name, want), have in zip(theirs.items(), ours, strict=True):
        assert have.dtype == want.dtype, name
        np.testing.assert_allclose(have, want, rtol=4 * np.finfo(dtype).eps, err_msg=name)


def test_constants_are_folded_repeats_done_once_and_the_unused_left_out():
    def fun(x):
        a, b = jnp.sin(x) * (2.0 + jnp.exp(1.0)), jnp.sin(x) + 0.0 * 3.0
        jnp.tan(x)
        return a + b * 1.0, -jnp.negative(x)

    made = [op for op in scalars(fun, 1.0).operations if op.name not in ("input", "constant")]
    assert [op.name for op in made] == ["sin", "mul", "add"]


@pytest.mark.parametrize(
    ("fun", "name"),
    [(jnp.sort, "sort"), (lambda x: jax.lax.fori_loop(0, 3, lambda _, y: 2 * y, x), "(scan|while)"), (jnp.cumsum, "cumsum")],
)
def test_what_single_numbers_cannot_do_is_refused_by_name(fun, name):
    with pytest.raises(ValueError, match=rf"^{name} of \w+ has no row in the table of operations .*: add it"):
        scalars(fun, np.zeros(3))


@pytest.mark.parametrize("value", [0.1, -2.5e-300, 1e300, np.inf, -np.inf, np.float32(0.1), np.int32(-3), True])
def test_literals_are_the_number_to_the_last_bit(value):
    number = np.asarray(value)[()]
    text = c99.literal(number).replace("(double)", "").replace("INFINITY", "inf").strip("()")
    text = text.removesuffix("f") if number.dtype == np.float32 and "inf" not in text else text
    assert number.dtype.type({"true": True}.get(text, text)) == number


@needs_c
def test_stablehlo_is_loaded_with_its_metadata_and_its_gains_can_change(exported):
    folder, tick = exported["float"]
    loaded, code = jaxftc.export.load(folder), Native(folder, tick)
    at, none = np.full(2, 0.1), np.zeros(2)
    signals = jaxftc.Reference(at, none, none), jaxftc.Measurement(at + 0.2, none)
    state, out = loaded.step(loaded.init(at), *signals)
    theirs = code.step(code.init(at[None]), [part[None] for signal in signals for part in signal])
    for have, want in zip((*state, *out), (*theirs[0], *theirs[1]), strict=True):
        np.testing.assert_allclose(have, want[0], rtol=1e-4, atol=1e-4)
    assert loaded.metadata["joint_names"] == ["joint1", "joint2"] and loaded.metadata["dt"] == 1e-3
    names = [leaf["name"] for leaf in loaded.metadata["signals"]["gains"]]
    loaded.gains[names.index("diagnosis_alpha_tau")] *= 2
    np.testing.assert_allclose(loaded.step(state, *signals)[1].threshold_tau, 2 * np.asarray(out.threshold_tau))


def test_the_loaded_tick_checks_what_it_is_given(exported):
    loaded = jaxftc.export.load(exported["double"][0])
    at, none = np.full(2, 0.1), np.zeros(2)
    state, still = loaded.init(at), jaxftc.Reference(at, none, none)
    unknown, nan = (loaded.step(state, still, jaxftc.Measurement(at, tau))[1].tau for tau in (None, none + np.nan))
    np.testing.assert_array_equal(unknown, nan)
    for words, use in {
        r"q must have shape \[2\]": lambda: loaded.init(np.zeros(3)),
        "q must be finite": lambda: loaded.init(none + np.nan),
        r"measurement.q must have shape \[2\].*got \[3\]": lambda: loaded.step(
            state, still, jaxftc.Measurement(np.zeros(3))
        ),
        "reference must be a Reference": lambda: loaded.step(state, at, jaxftc.Measurement(at)),
        "state must be the list of": lambda: loaded.step(state[1:], still, jaxftc.Measurement(at)),
        r"number 0, \w+, has shape .*, got \[1, ": lambda: loaded.step(
            [x[None] for x in state], still, jaxftc.Measurement(at)
        ),
    }.items():
        with pytest.raises(ValueError, match=words):
            use()


def test_a_folder_that_is_not_as_it_was_written_is_refused(exported, tmp_path):
    with pytest.raises(ValueError, match=r"no exported tick in .*; write one with jaxftc export"):
        jaxftc.export.load(tmp_path)
    for file in (*stablehlo.FILES, stablehlo.METADATA):
        (tmp_path / file).write_bytes((exported["double"][0] / file).read_bytes())
    (tmp_path / stablehlo.FILES[1]).write_bytes(b"")
    with pytest.raises(ValueError, match=r"ftc_step.stablehlo.*export again"):
        jaxftc.export.load(tmp_path)


def test_a_missing_compiler_is_one_line(monkeypatch, tmp_path):
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(ValueError, match=r"no C compiler.*'no-such-compiler'.*gcc"):
        native.build([tmp_path / "a.c"], tmp_path / "a")


@pytest.mark.parametrize("met", [True, False])
def test_the_command_checks_and_says_so(met, tmp_path, monkeypatch, capsys):
    robot = tmp_path / "arm.xml"
    robot.write_text(arms.serial(1))
    found = check.Compared(10, {"healthy": 0.0 if met else 1.0}, "out.tau", 0, 5, 1e-9)
    monkeypatch.setattr(common, "prepare", lambda options, **settings: None)
    monkeypatch.setattr(check, "compare", lambda tick, artifacts, **settings: dict.fromkeys(artifacts, found))
    monkeypatch.setenv("CC", "no-such-compiler")
    arguments = [
        "export",
        "--robot",
        str(robot),
        "--scheme",
        "computed_torque",
        "--check",
        "--json",
        "--out",
        str(tmp_path / "out"),
    ]
    if met:
        main(arguments)
    else:
        with pytest.raises(SystemExit) as stop:
            main(arguments)
        assert stop.value.code == 1
    said = capsys.readouterr()
    assert json.loads(said.out)["check"]["StableHLO"]["met"] is met
    assert "no C compiler" in said.err and ("StableHLO differ from jaxftc.step" in said.err) is not met
    assert (tmp_path / "out" / "ftc_step.c").is_file()


def test_gains_of_single_precision_are_taken_for_their_decimals():
    settings = config("computed_torque")
    with precision("float"):
        gains = jaxftc.default_gains(settings)
    tick = make_tick(settings, gains)
    assert tick.gains.baseline.speed_weight.tolist() == [0.15] * 2
