"""``jaxftc demo``: the paper's experiment, its comparison table and what became of each claim."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from jaxftc.cli import common, results
from jaxftc.io.files import write_text
from jaxftc.io.text_table import aligned

if TYPE_CHECKING:
    from jaxftc.paper.results import Experiment, Row


@dataclasses.dataclass
class Demo(common.Options):
    """The paper's four conditions with every observer and controller: comparison table, claims and report.html."""

    def run(self) -> None:
        """Run it, print the table and the claims, write report.html and result.json."""
        common.prepare(self, many=True)
        from jaxftc import Config
        from jaxftc.cli import record
        from jaxftc.paper import experiment as paper
        from jaxftc.paper.page import demo_page

        robot = common.load_arm(self)
        dt = common.sample_time(self)
        config = Config(robot, dt=dt, t_final=common.motion_time(dt), engine=self.engine)
        gains = common.load_or_default(self, config)
        key = common.key(self)
        with results.folder(self, "demo") as folder:
            experiment = paper.run(config, gains, key)
            ran = record.of(self, config)
            text = results.write_json(folder / "result.json", paper.as_json(experiment) | {"provenance": ran})
            write_text(folder / "report.html", demo_page(config, gains, experiment, ran))
        common.say(self, table(experiment.rows))
        common.say(self, claims(experiment))
        common.say(self, f"\nWritten: {folder / 'report.html'}, {folder / 'result.json'}")
        if self.json:
            print(text)


def table(rows: list[Row]) -> str:
    """The comparison table as text."""
    from jaxftc.evaluation.metrics import SETTLE
    from jaxftc.paper.page import comparison

    head, units, cells = comparison(rows)
    note = f"isolated: every joint's verdict is right {1e3 * SETTLE:.0f} ms after the first alarm; "
    note += "chattering: torque travel over its limit"
    return "\n".join([*aligned(head, units, cells, text=3), note])


def claims(experiment: Experiment) -> str:
    """Each claim with its figure."""
    lines = ["", "Claims of the paper, with one set of gains for every row:"]
    for claim in experiment.claims:
        lines.append(
            f"  {'met    ' if claim.met else 'NOT MET'}  {claim.claim}: {claim.value:.4g} {claim.unit} ({claim.detail})"
        )
    return "\n".join(lines)
