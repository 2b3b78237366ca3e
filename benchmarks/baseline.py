"""The committed baseline of ratios, and the gate that holds a run against it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.metrics import TABLE, gated
from jaxftc.io.files import write_text

PATH = Path(__file__).with_name("baseline.json")
RESULTS = Path(__file__).with_name("results.json")  # of the same run, whole: the chart is drawn from it


def load(path: Path = PATH) -> dict[str, Any]:
    """``{"machine": {...}, "metrics": {key: value}}``.

    Raises:
        ValueError: there is none, or it cannot be read.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return {"machine": dict(found["machine"]), "metrics": {key: float(v) for key, v in found["metrics"].items()}}
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"no baseline in {path} ({error!r}); write one with --update-baseline") from error


def save(result: Mapping[str, Any], path: Path = PATH, results: Path = RESULTS) -> None:
    """Make a run the baseline: its ratios, and the whole result beside them.

    Raises:
        ValueError: a gated figure is missing.
    """
    values = {row["key"]: row["value"] for row in result["metrics"]}
    missing = sorted(gated().keys() - values.keys())
    if missing:
        raise ValueError(f"a baseline needs every section; this run lacks {', '.join(missing)}")
    ratios = {key: values[key] for key in gated()}
    write_text(results, json.dumps(result, indent=2, allow_nan=False) + "\n")
    write_text(path, json.dumps({"machine": result["machine"], "metrics": ratios}, indent=2, allow_nan=False) + "\n")


def compare(before: Mapping[str, float], now: Mapping[str, float]) -> list[str]:
    """A line for each gated figure that got worse than it may, or is missing on either side; none if all is well."""
    lines = []
    for key, tolerance in gated().items():
        if key not in now:
            lines.append(f"{key} is missing from this run; the baseline has {before.get(key, 'none either')}")
        elif key not in before:
            lines.append(f"{key} is missing from the baseline; this run has {now[key]:.4g}: --update-baseline adds it")
        else:
            rises = TABLE[key].direction == "higher"
            limit = max(before[key], TABLE[key].perfect) * (1 - tolerance if rises else 1 + tolerance)
            if not (now[key] >= limit if rises else now[key] <= limit):  # a nan is neither
                word = "at least" if rises else "at most"
                lines.append(f"{key} is {now[key]:.4g}, allowed {word} {limit:.4g}: the baseline has {before[key]:.4g}")
    return lines
