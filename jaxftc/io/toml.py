"""TOML as people's editors leave it."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any


def read_toml(path: str | Path, what: str) -> dict[str, Any]:
    """The tables of a file, with a byte order mark or without.

    Raises:
        ValueError: it cannot be read; ``what`` was wanted from it.
    """
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"cannot read {what} from {path}: {error}") from error
    except RecursionError as error:
        raise ValueError(f"cannot read {what} from {path}: brackets are nested too deeply") from error
