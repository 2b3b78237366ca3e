"""The README's Python runs as printed, and what it names exists."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
DOCS = {path.name: path.read_text() for path in sorted((ROOT / "docs").glob("*.md"))}
TEXT = "\n".join([README, *DOCS.values()])
IN_BASH = [line for block in re.findall(r"```bash\n(.*?)```", TEXT, re.DOTALL) for line in block.splitlines()]
COMMANDS = {line for line in IN_BASH if line.startswith("jaxftc ")} | set(re.findall(r"`(jaxftc [a-z]+[^`]*)`", TEXT))


def test_python_blocks_run(capsys):
    blocks = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert blocks
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})
    assert "[3 3 3 3 3 3]" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("name", DOCS)
def test_python_blocks_of_the_docs_run(name, capsys):
    blocks = re.findall(r"```python\n(.*?)```", DOCS[name], re.DOTALL)
    for block in blocks:
        exec(compile(block, name, "exec"), {})
    assert blocks and capsys.readouterr().out.startswith("all steps done")


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_commands_parse(command):
    from jaxftc.cli.main import parse

    assert parse(command.split()[1:])


def test_files_named_exist():
    for name in re.findall(r"`((?:jaxftc|tests)/[\w/.]+|[A-Z]+\.(?:md|cff))`", README):
        assert (ROOT / name).exists(), name
    for name in re.findall(r"`(\w+\.py|\w+/)`", README):
        assert (ROOT / "jaxftc" / name).exists() or (ROOT / name).exists(), name


def test_set_up_is_two_commands():
    assert re.findall(r"```bash\n(.*?)\n```", README) == [
        "pip install -e . && jaxftc demo",
        "pip install -e '.[test]' && pytest",
    ]
