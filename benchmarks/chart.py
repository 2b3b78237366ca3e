"""The README's chart, drawn from the committed results: ``python -m benchmarks.chart`` writes ``docs/performance.svg``.

Plain SVG text: bars on a logarithmic scale with their figures beside them, on a ground of its own that follows the reader's
light or dark setting.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from benchmarks.baseline import RESULTS
from jaxftc.io.files import write_text

PATH = Path(__file__).parents[1] / "docs" / "performance.svg"
GROUPS = {  # title to (metric, label, whether it is ours)
    "Plant only": (
        ("plant_steps_per_s", "jaxftc, chain", True),
        ("rollout_steps_per_s", "MuJoCo C, mujoco.rollout", False),
        ("mj_step_steps_per_s", "MuJoCo C, mj_step, one thread", False),
        ("mjx_default_steps_per_s", "MuJoCo MJX, mjx.step as it comes", False),
    ),
    "Whole closed loop: plant, faults, observers, diagnosis, control": (
        ("loop_steps_per_s", "jaxftc, chain", True),
        ("loop_mjx_steps_per_s", "jaxftc, MJX", True),
        ("numpy_steps_per_s", "NumPy on MuJoCo C, one arm", False),
    ),
    "Its gradient for all gains": (("grad_steps_per_s", "jaxftc, chain", True),),
}
WIDTH, LEFT, RIGHT, ROW, BAR = 760, 250, 90, 24, 16  # px
STYLE = """
svg{font:13px system-ui,sans-serif} .ground{fill:#fff} text{fill:#222} .soft{fill:#666;font-size:12px}
.title{font-size:16px;font-weight:600} .group{font-weight:600} .grid{stroke:#ddd} .ours{fill:#0072b2} .peer{fill:#e69f00}
@media (prefers-color-scheme:dark){.ground{fill:#0d1117} text{fill:#e6e6e6} .soft{fill:#a0a8b0} .grid{stroke:#30363d}
.ours{fill:#56b4e9} .peer{fill:#d99a1c}}
"""


def draw(result: Mapping[str, Any]) -> str:
    """SVG text of a whole run's result."""
    values = {row["key"]: float(row["value"]) for row in result["metrics"]}
    machine, shown = result["machine"], [key for rows in GROUPS.values() for key, _, _ in rows]
    low = math.floor(math.log10(min(values[key] for key in shown)))
    high = math.ceil(math.log10(max(values[key] for key in shown)))
    scale = (WIDTH - LEFT - RIGHT) / (high - low)
    head = f"{machine['processor']}, {machine['cores']} cores, float32"
    parts = [_text(16, 26, "Scenario-steps per second, logarithmic", "title"), _text(16, 46, head, "soft")]
    y, body = 66, []
    for title, rows in GROUPS.items():
        y += 10
        body.append(_text(16, y + 13, title, "group"))
        y += ROW
        for key, label, ours in rows:
            length = scale * (math.log10(values[key]) - low)
            body.append(_text(LEFT - 8, y + 13, label, "end"))
            body.append(
                f'<rect class="{"ours" if ours else "peer"}" x="{LEFT}" y="{y}" width="{length:.1f}" height="{BAR}"/>'
            )
            body.append(_text(LEFT + length + 6, y + 13, short(values[key]), ""))
            y += ROW
    for power in range(low, high + 1):
        x = LEFT + scale * (power - low)
        parts.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="66" y2="{y}"/>')
        parts.append(_text(x, y + 16, short(10.0**power), "soft middle"))
    height = y + 28
    size = f'width="{WIDTH}" height="{height}"'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {WIDTH} {height}" role="img">'
        f"<title>Scenario-steps per second of jaxftc and of what users would otherwise pick</title><style>{STYLE}</style>"
        f'<rect class="ground" {size}/>{"".join(parts + body)}</svg>\n'
    )


def short(value: float) -> str:
    """Three digits at most, with k or M."""
    for size, letter in ((1e6, " M"), (1e3, " k")):
        if value >= size:
            return f"{value / size:.3g}{letter}"
    return f"{value:.3g}"


def _text(x: float, y: float, text: str, look: str) -> str:
    anchor = "end" if "end" in look else "middle" if "middle" in look else "start"
    return f'<text class="{look}" x="{x:.1f}" y="{y}" text-anchor="{anchor}">{escape(text)}</text>'


if __name__ == "__main__":
    write_text(PATH, draw(json.loads(RESULTS.read_text(encoding="utf-8"))))
    print(f"Written: {PATH}")
