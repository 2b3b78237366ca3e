"""The prose of README and docs: short sentences, and the field's word instead of one of our own."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MEAN, LONGEST = 20, 35  # words a sentence
OLD = {  # words of our own, and what to say instead
    r"second look": "sensor check",
    r"\bkick": "velocity transient",
    r"\bdoors?\b": "interface",
    r"\bdoubt": "sensor status",
    r"\bdice\b": "uniform numbers",
    r"\baside\b": "atomic write",
}


def load():
    """``docs/sentences.py``, which is a script and no package's."""
    spec = importlib.util.spec_from_file_location("sentences", ROOT / "docs" / "sentences.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SCRIPT = load()
ALL = [*SCRIPT.pages(), ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs" / "dev").glob("*.md"))]


def test_sentences_are_counted_as_a_reader_counts_them():
    text = """# A heading

One, two `three four` [five six](there.md) and $a + b$ (Eqs. (1), (2)). Eight is 3.5 m; so it goes
on over a line.

| a table | is |
|---|---|

- **Lead.** An item without a stop
- Another one:

```python
none = "Of this. Counts."
```

$$
x = y
$$
"""
    assert [SCRIPT.length(sentence) for sentence in SCRIPT.sentences(text)] == [10, 11, 5, 2]


def test_a_long_sentence_is_seen():
    mean, longest, count, which = SCRIPT.figures("Short one. " + "Word " * 39 + "end.")
    assert (mean, longest, count) == (21, 40, 2) and which.startswith("Word")


@pytest.mark.parametrize("path", ALL, ids=lambda path: str(path.relative_to(ROOT)))
def test_sentences_are_short(path):
    mean, longest, _, which = SCRIPT.figures(path.read_text())
    assert mean <= MEAN, f"{mean:.1f} words a sentence"
    assert longest <= LONGEST, f"{longest} words: {which}"


@pytest.mark.parametrize("path", ALL, ids=lambda path: str(path.relative_to(ROOT)))
def test_words_are_those_of_the_field(path):
    text = re.sub(r"^( *)```.*?^\1```$|`[^`]+`", "", path.read_text(), flags=re.DOTALL | re.MULTILINE)
    found = {old: new for old, new in OLD.items() if re.search(old, text, re.IGNORECASE)}
    assert not found, f"say {found} instead"


def test_the_script_prints_a_line_a_page(capsys):
    SCRIPT.main([])
    assert len(capsys.readouterr().out.splitlines()) == 1 + len(SCRIPT.pages())
