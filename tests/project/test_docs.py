"""README and docs: what they print runs and prints that, what they name exists, and the site builds without a warning."""

import math
import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import NamedTuple

import pytest

import jaxftc
import tuning
from jaxftc.gains import BLOCKS, Spec, specs

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = {"README.md": (ROOT / "README.md").read_text()}
PAGES |= {
    path.relative_to(DOCS).as_posix(): path.read_text() for path in sorted(DOCS.rglob("*.md")) if "_build" not in path.parts
}
# They compile campaigns, loops, or a gradient for all gains.
SLOW_PAGES = {"campaigns.md", "performance.md", "tuning.md", "robot.md", "own-scheme.md"}
THOROUGH_PAGES = {"start.md", "own-arm.md", "export.md", "recordings.md"}
REDUCED = {  # options added to the printed commands before they run here: their own sizes take minutes to hours
    "demo": "--engine chain",
    "simulate": "",
    "tune": "--steps 2 --batch 4 --validation 4 --held-out 4 --duration 0.2",
    "campaign": "-n 16",
    "calibrate": "--runs 600 --duration 0.2",
    "identify": "",
    "diagnose": "",
    "bench": "--quick",
    "view": "",
    "inspect": "",
    "export": "--ticks 20",
}
NOT_RUN = {  # lines that do not run here, and why
    "pip install": "the environment that runs this is what they make",
    "pytest": "this is part of it",
    "jaxftc campaign -n 100000 --cluster local": "it needs ray: test_cluster",
    "jaxftc campaign -n 1000000 --cluster node1": "it needs two machines",
    "python docs/tutorial.py": "test_the_tutorial_runs",
    "python -m benchmarks.chart": "it draws over the committed chart, which test_benchmarks holds against the results",
    "jaxftc bench --gate": "it refuses small sizes: a comparison with the committed baseline is a quarter of an hour",
    "jaxftc bench --update-baseline": "it writes the committed baseline",
}


class Block(NamedTuple):
    """A fenced block of a page."""

    language: str
    text: str


def blocks(page: str) -> list[Block]:
    """The fenced blocks of a page, in order."""
    found = re.finditer(r"^( *)```(\S+)\n(.*?)^\1```$", PAGES[page], re.DOTALL | re.MULTILINE)
    return [Block(match[2], textwrap.dedent(match[3])) for match in found]


def lines(page: str) -> list[str]:
    """Every command in the bash blocks of a page."""
    printed = [line for block in blocks(page) if block.language == "bash" for line in block.text.splitlines()]
    return [part.strip() for line in printed for part in line.split("&&") if part.strip()]


def own_files(page: str, folder: Path) -> None:
    """The files that a page tells its reader to save."""
    for name in re.findall(r"^```\{literalinclude\} (schemes/\S+)$", PAGES[page], re.MULTILINE):
        (folder / Path(name).name).write_text((DOCS / name).read_text())


def python(page: str) -> list[tuple[str, str | None]]:
    """The Python blocks of a page, each with the output that the page prints right behind it."""
    found = [*blocks(page), Block("", "")]
    behind = [then.text if then.language == "text" else None for then in found[1:]]
    return [(block.text, text) for block, text in zip(found, behind, strict=False) if block.language == "python"]


COMMANDS = {line for page in PAGES for line in lines(page) if line.startswith("jaxftc ")}
INLINE = {" ".join(command.split()) for text in PAGES.values() for command in re.findall(r"`(jaxftc [a-z]+[^`]*)`", text)}


@pytest.fixture(scope="module")
def run(request):
    """Run Python in a folder, as a reader would, and return what it printed; compiled programs stay in pytest's cache."""
    kept = str(request.config.cache.mkdir("docs"))
    environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": kept, "XDG_CACHE_HOME": kept, "TMPDIR": kept}
    environment |= {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.5"}

    def call(folder: Path, *arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{' '.join(arguments)}\n{done.stdout}{done.stderr}"
        return done.stdout

    return call


def run_python(run, folder: Path, page: str) -> str:
    """Run the Python blocks of a page in one process; what each prints must be what the page says."""
    own_files(page, folder)
    end = "-- end of block --"
    source = f"\nprint({end!r})\n".join(text for text, _ in python(page))
    (folder / "page.py").write_text(source)
    printed = run(folder, "page.py")
    for got, (_, expected) in zip(printed.split(f"{end}\n"), python(page), strict=True):
        assert expected is None or alike(got, expected), f"{page} prints\n{expected}\nand the block\n{got}"
    return printed


NUMBER = re.compile(r"-?\d+(?:\.\d*)?(?:e-?\d+)?")


def alike(got: str, expected: str) -> bool:
    """Whether two outputs are the same but for space and, within 5 % or one in the last digit, numbers: machines round.

    Integers in brackets are verdicts, which have no such leave.
    """
    words = ["".join(NUMBER.sub("#", text).split()) for text in (got, expected)]
    numbers = [NUMBER.findall(text) for text in (got, expected)]
    if words[0] != words[1]:
        return False
    return all(_near(a, b) for a, b in zip(*numbers, strict=True)) and _verdicts(got) == _verdicts(expected)


def _near(got: str, expected: str) -> bool:
    digit = 10.0 ** -len(expected.partition(".")[2])
    return math.isclose(float(got), float(expected), rel_tol=0.05, abs_tol=1.001 * digit)


def _verdicts(text: str) -> list[str]:
    return re.findall(r"\[[0-3](?: [0-3])*\]", text)


def test_outputs_are_compared():
    assert alike("rms  0.159 deg [1 0]\n", "rms 0.160 deg [1 0]")
    assert alike("[1.48 0.1  0.08]", "[1.47 0.1 0.09]")
    assert not alike("rms 0.19 deg", "rms 0.16 deg")
    assert not alike("verdict [1 0]", "verdict [2 0]")
    assert not alike("found 3", "missed 3")


def pages_with_python() -> list:
    names = [name for name in PAGES if python(name)]
    marks = dict.fromkeys(SLOW_PAGES, pytest.mark.slow) | dict.fromkeys(THOROUGH_PAGES, pytest.mark.thorough)
    return [pytest.param(name, marks=marks.get(name, ())) for name in names]


@pytest.mark.parametrize("page", pages_with_python())
def test_python_runs_and_prints_what_the_page_says(page, run, tmp_path):
    printed = run_python(run, tmp_path, page)
    if page == "README.md":
        assert "[3 3 3 3 3 3]" in printed  # its comment says so


@pytest.mark.slow
def test_the_tutorial_runs(run, tmp_path):
    (expected,) = (block.text for block in blocks("tutorial.md") if block.language == "text")
    printed = run(tmp_path, str(ROOT / "docs" / "tutorial.py"))
    assert alike(printed, expected), printed


@pytest.mark.parametrize("command", sorted(COMMANDS | INLINE))
def test_commands_parse(command):
    from jaxftc.cli.main import parse

    assert parse(command.split()[1:])


def test_every_printed_command_is_one_of_ours_or_said_not_to_run():
    strays = [line for page in PAGES for line in lines(page) if line not in COMMANDS and not line.startswith(tuple(NOT_RUN))]
    assert not strays
    assert all(any(line.startswith(known) for page in PAGES for line in lines(page)) for known in NOT_RUN)
    assert {command.split()[1] for command in COMMANDS} <= set(REDUCED)


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if any(line in COMMANDS for line in lines(page))])
def test_commands_run(page, run, tmp_path):
    """One after the other in one folder, as the page has them, with less to do each."""
    own_files(page, tmp_path)
    if page in ("own-arm.md", "recordings.md"):
        run_python(run, tmp_path, page)  # it writes the robot file, and logs
    done = set()
    for line in lines(page):
        if line.startswith(tuple(NOT_RUN)):
            continue
        command = f"{line} {REDUCED[line.split()[1]]}"
        if command not in done:
            run(tmp_path, "-c", "from jaxftc.cli.main import main; main()", *command.split()[1:])
        done.add(command)


@pytest.mark.parametrize("page", PAGES)
def test_files_named_exist(page):
    named = re.findall(r"`((?:jaxftc|tests|docs|benchmarks)/[\w/.]+|[A-Z]+\.(?:md|cff)|[\w/]+\.py|[a-z_]+/)`", PAGES[page])
    for name in named:
        assert any((folder / name).exists() for folder in (ROOT, ROOT / "jaxftc")), name


def test_set_up_is_two_commands():
    assert [block.text.strip() for block in blocks("README.md") if block.language == "bash"] == [
        "pip install -e . && jaxftc demo",
        "pip install -e '.[test]' && pytest",
    ]


def test_the_table_of_gains_is_that_of_the_code():
    found = re.findall(r"^\| (`\w+`) \| (.+?) \| (.+?) \| (.+?) \| (.+?) \| (.+) \|$", PAGES["gains.md"], re.MULTILINE)
    assert [row[:5] for row in found] == [cells(name, spec) for _, name, spec in specs()]
    assert all(row[5] for row in found)
    assert re.findall(r"^## (\w+):", PAGES["gains.md"], re.MULTILINE) == list(BLOCKS)


def cells(name: str, spec: Spec) -> tuple[str, ...]:
    """The columns of a gain's row that follow from its spec."""
    axes = {"n": "joint", "a": "function", "b": "function", "u": "input", "1": "arm"}
    per = ", ".join(axes.get(axis, f"{axis} sets") for axis in spec.axes)
    opening = "(" if spec.open_low else "["
    closing = ")" if math.isinf(spec.high) or (spec.low, spec.high) == (-1, 1) else "]"
    allowed = "any" if math.isinf(spec.low) else f"{opening}{spec.low:g}, {spec.high:g}{closing}"
    return f"`{name}`", per, spec.unit, allowed, default(spec)


def default(spec: Spec) -> str:
    """A gain's default, as short as can be."""
    if spec.default is None:
        return "exact model"
    if not isinstance(spec.default, tuple):
        degrees = f" ({math.degrees(spec.default):g} deg)" if spec.unit == "rad" and spec.default > 0.01 else ""
        return f"{spec.default:.4g}{degrees}"
    values = [f"{value:.4g}" for value in spec.default]
    if len(set(values)) == 1:
        return f"{values[0]} each"
    return ", ".join(values) if len(values) < 4 else f"{values[0]} to {values[-1]}, evenly"


def test_the_api_has_every_public_name():
    text = PAGES["api.md"].partition("currentmodule:: tuning")
    for module, part in ((jaxftc, text[0]), (tuning, text[2])):
        names = set(dir(module)) - set(getattr(module, "_MODULES", ()))
        missing = [name for name in names if name[0] != "_" and not re.search(rf":: {name}$", part, re.MULTILINE)]
        assert not missing


def test_every_page_is_in_the_table_of_contents():
    names = set(re.findall(r"^[\w/-]+$", PAGES["index.md"], re.MULTILINE))
    assert names == {page.removesuffix(".md") for page in PAGES} - {"README", "index"}
    assert all(f"]({name}.md)" in PAGES["index.md"] for name in names)


def test_links_of_the_readme_lead_somewhere():
    for path, anchor in re.findall(r"\]\((docs/[^)#]+)#?([^)]*)\)", PAGES["README.md"]):
        assert (ROOT / path).exists(), path
        headings = re.findall(r"^#+ (.+)$", (ROOT / path).read_text(), re.MULTILINE) if anchor else []
        assert not anchor or anchor in {heading.lower().replace(" ", "-") for heading in headings}, f"{path}#{anchor}"


@pytest.mark.thorough
def test_the_site_builds_without_a_warning(tmp_path):
    for package in ("sphinx", "myst_parser", "furo", "latex2mathml"):
        pytest.importorskip(package, reason="pip install -e '.[docs]' builds the site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", str(ROOT / "docs"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    pages = {page: (tmp_path / page).with_suffix(".html").read_text() for page in PAGES if page != "README.md"}
    assert "<math" in pages["theory.md"] and "as printed the fault is doubled" in pages["paper.md"]
    assert 'id="jaxftc.simulate"' in pages["api.md"] and "torque command within the limits" in pages["api.md"]
    assert "A healthy run" in pages["tutorial.md"]
    assert not re.search(r'<script[^>]+src="https?:', "".join(pages.values())), "pages open offline"
