"""``jaxftc demo``: the paper's experiment, its comparison table and what became of each claim."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from jaxftc.cli import common

if TYPE_CHECKING:
    from jaxftc.paper import Experiment, Row


@dataclasses.dataclass
class Demo(common.Options):
    """The paper's four conditions with every observer and controller: comparison table, claims and report.html."""

    def run(self) -> None:
        """Run it, print the table and the claims, write report.html and result.json."""
        common.prepare(self)
        import jax
        from tqdm import tqdm

        from jaxftc import Config, paper, report

        robot = common.load_arm(self)
        config = Config(robot, engine=self.engine)
        gains = common.load_or_default(self, config)
        folder = common.make_folder(self, "demo")
        with tqdm(total=9, desc="observers x controllers", unit="pair", leave=False) as bar:
            experiment = paper.run(config, gains, jax.random.key(self.seed), bar.update)
        text = common.write_json(folder / "result.json", paper.as_json(experiment))
        common.write_aside(folder / "report.html", report.demo_page(config, experiment))
        common.say(self, table(experiment.rows))
        common.say(self, claims(experiment))
        common.say(self, f"\nWritten: {folder / 'report.html'}, {folder / 'result.json'}")
        if self.json:
            print(text)


def table(rows: list[Row]) -> str:
    """The comparison table as text."""
    head = (
        "condition",
        "observer",
        "controller",
        "torque est.",
        "angle est.",
        "delay",
        "told apart",
        "tracking",
        "chattering",
    )
    units = ("", "", "", "rms N m", "rms deg", "ms", "", "rms deg", "1/s")
    lines = [head, units]
    for row in rows:
        delay = "-" if row.delay_s is None else f"{row.delay_s * 1e3:.0f}"
        lines.append(
            (
                row.condition,
                row.observer,
                row.controller,
                f"{row.fault_tau_rms_nm:.3f}",
                f"{row.fault_q_rms_deg:.4f}",
                delay,
                "yes" if row.isolated else "no",
                f"{row.tracking_rms_deg:.3f}",
                f"{row.chattering:.2f}",
            )
        )
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    text = [
        "  ".join(cell.ljust(w) if k < 3 else cell.rjust(w) for k, (cell, w) in enumerate(zip(line, widths, strict=True)))
        for line in lines
    ]
    return "\n".join([*text[:2], "-" * len(text[0]), *text[2:]])


def claims(experiment: Experiment) -> str:
    """Each claim with its figure."""
    lines = ["", "Claims of the paper, with one set of gains for every row:"]
    for claim in experiment.claims:
        lines.append(
            f"  {'met    ' if claim.met else 'NOT MET'}  {claim.claim}: {claim.value:.4g} {claim.unit} ({claim.detail})"
        )
    return "\n".join(lines)
