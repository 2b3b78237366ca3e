"""How long the sentences of README and docs are: ``python docs/sentences.py`` prints a line a page, in words.

Code blocks, tables, headings, pictures and displayed formulas are left out. A code span, a formula in a line and the text of
a link count as the reader meets them: the first two as one word each, the link by its text. A sentence ends at a full stop,
a question mark, a colon in front of a block, or the end of its paragraph or list item; a semicolon does not end it.
Names of files as arguments print those instead: ``python docs/sentences.py old.md``.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
LEFT_OUT = [
    r"^( *)(```|~~~).*?^\1\2 *$",  # code blocks, with what directives hold
    r"^\$\$.*?^\$\$.*?$",  # displayed formulas
    r"^ *\|.*?$",  # rows of a table
    r"^#+ .*?$",  # headings
    r"^\s*(?:[-*] |\d+\. )?\*\*[^*\n]+\.\*\*",  # headings in bold at the start of a paragraph or an item
    r"!\[[^\]]*\]\([^)]*\)",  # pictures
    r"<!--.*?-->",
]
ABBREVIATIONS = r"\b(Eqs?|Figs?|vs|e\.g|i\.e|cf|al)\."
ITEM = re.compile(r"^ *(?:[-*>] |\d+\. )", re.MULTILINE)
END = re.compile(r"""(?<=[.!?])[)"'*]*\s+(?=["'(*\[]*[A-Z0-9`$])""")
WORD = re.compile(r"\S*[^\W_]\S*")


def pages() -> list[Path]:
    """README and the pages for users; notebooks in ``docs/dev`` are not among them."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def prose(text: str) -> str:
    """A page's text without what is no sentence, code spans and formulas as one word each."""
    for pattern in LEFT_OUT:
        text = re.sub(pattern, "\n\n" if pattern[0] == "^" else "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"``.+?``|`[^`]+`", "CODE", text, flags=re.DOTALL)
    text = re.sub(r"\$[^$]+\$", "FORMULA", text)
    return re.sub(r"\[([^\]]+)\]\([^)\s]*\)", r"\1", text)


def sentences(text: str) -> Iterator[str]:
    """The sentences of a page, in order."""
    text = re.sub(ABBREVIATIONS, r"\1", prose(text))
    for paragraph in re.split(r"\n\s*\n", ITEM.sub("\n\n", text)):
        for sentence in END.split(" ".join(paragraph.split())):
            if WORD.search(sentence):
                yield sentence


def length(sentence: str) -> int:
    """Words in a sentence: what has a letter or a digit in it."""
    return len(WORD.findall(sentence))


def figures(text: str) -> tuple[float, int, int, str]:
    """Mean words a sentence, words in the longest, number of sentences, and the longest itself."""
    found = list(sentences(text))
    lengths = [length(sentence) for sentence in found]
    longest = max(found, key=length, default="")
    return sum(lengths) / max(len(lengths), 1), length(longest), len(found), longest


def main(arguments: list[str]) -> None:
    """Print the table."""
    verbose = "-v" in arguments
    paths = [Path(name) for name in arguments if name != "-v"] or pages()
    print(f"{'page':24}{'sentences':>10}{'mean':>7}{'longest':>9}")
    for path in paths:
        mean, most, count, longest = figures(path.read_text())
        print(f"{path.name:24}{count:10}{mean:7.1f}{most:9}")
        if verbose:
            print("   ", longest)


if __name__ == "__main__":
    main(sys.argv[1:])
