"""``jaxftc bench``: the benchmark suites."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from benchmarks.metrics import SECTIONS, Section
from jaxftc.cli import common, results
from jaxftc.io.files import write_text
from jaxftc.io.tables import write_parquet
from tuning.settings import Settings

if TYPE_CHECKING:
    from benchmarks.ranking import Pair
    from jaxftc.config import Config


@dataclasses.dataclass
class Bench(common.Options):
    """Benchmarks, side by side in one run; writes result.json and report.html.

    speed: plant, closed loop, gradient, tick and campaign against MuJoCo C, MJX and NumPy, results checked while timed.
    tuning: gradient, CMA-ES, random search and finite differences, held-out objective over simulations and over time.
    ranking: the paper's two rankings, every observer and controller tuned from its default gains with the same budget.
    """

    suite: tyro.conf.Positional[Literal["speed", "tuning", "ranking"]] = "speed"
    """Suite to run."""
    sections: tuple[Section, ...] = SECTIONS
    """Parts to measure (speed)."""
    quick: bool = False
    """Small sizes, to see that everything works; the figures cannot be compared (speed)."""
    largest: int = 100_000
    """Scenarios of the largest campaign (speed)."""
    gate: bool = False
    """Exit with 1 if a ratio is worse than the committed baseline allows, or missing (speed)."""
    update_baseline: bool = False
    """Make this run the committed baseline and results (speed)."""
    settings: tyro.conf.OmitArgPrefixes[Settings] = dataclasses.field(default_factory=Settings)
    engine: Literal["mjx", "chain"] = "chain"
    """Simulated arm (tuning, ranking): recursions unrolled from its model, or MuJoCo MJX."""
    coulomb: bool = True
    """Give the PUMA 560 its Coulomb friction, in plant and model."""
    seed: int = 0
    """Seed of the ranking's scenarios; tuning counts its seeds from 0."""
    seeds: int = 5
    """Seeds of each method (tuning)."""
    methods: tuple[Literal["cmaes", "random", "finite"], ...] = ("cmaes", "random", "finite")
    """Methods that the gradient is compared with (tuning)."""
    more: float = 1.0
    """Factor on the budget of CMA-ES (tuning)."""
    held_out: int = 1024
    """Held-out scenarios (ranking)."""

    def run(self) -> None:
        """Measure, print, write."""
        common.prepare(self, many=True, devices=self.suite != "speed")
        from benchmarks import baseline, machine
        from jaxftc import Config, checks
        from jaxftc.cli import record

        self.settings.check()
        checks.integer("--seeds", self.seeds, 1, "5 show the spread")
        checks.integer("--held-out", self.held_out, 32, "rankings are read by condition")
        checks.positive("--more", self.more, "the budget")
        checks.integer("--largest", self.largest, 20_000, "10,000 are measured anyway")
        if self.quick and (self.gate or self.update_baseline):
            raise ValueError("--quick has other sizes than the baseline; leave it out with --gate and --update-baseline")
        if self.gate:
            baseline.load()  # refused now rather than after the run
        config = Config(common.load_arm(self), engine=self.engine)
        with results.folder(self, f"bench-{self.suite}") as folder:
            suite = {"speed": self._speed, "tuning": self._tuning, "ranking": self._ranking}[self.suite]
            ran = record.of(self, config)
            result, text, page = suite(config, folder, ran)
            result = {"machine": machine.describe(), **result, "provenance": ran}
            printed = results.write_json(folder / "result.json", result)
            write_text(folder / "report.html", page)
        common.say(self, text)
        common.say(self, f"\nWritten to {folder}: result.json, report.html")
        if self.json:
            print(printed)
        if self.suite == "speed":
            self._judge(result)

    def _speed(self, config: Config, folder: Path, ran: dict[str, Any]) -> tuple[dict[str, Any], str, str]:
        import tempfile

        from tqdm import tqdm

        from benchmarks import speed, speed_page
        from benchmarks.results import Failed, Setup
        from benchmarks.sizes import FULL, QUICK
        from jaxftc.compile.devices import cores

        sizes = QUICK if self.quick else dataclasses.replace(FULL, campaigns=(FULL.campaigns[0], self.largest))

        def announced() -> Iterator[Section]:
            with tqdm(self.sections, unit="section", leave=False) as bar:
                for section in bar:
                    bar.set_description(section)
                    yield section

        with tempfile.TemporaryDirectory() as scratch:
            try:
                found = speed.run(Setup(self, sizes, cores(), Path(scratch)), announced())
            except Failed as failure:
                raise SystemExit(f"jaxftc: {failure}") from failure
        return speed_page.as_dict(found, sizes, config), speed_page.as_text(found), speed_page.page(found, ran)

    def _judge(self, result: dict[str, Any]) -> None:
        """Hold the run against the baseline, or make it the baseline."""
        from benchmarks import baseline

        if self.gate:
            worse = baseline.compare(baseline.load()["metrics"], {row["key"]: row["value"] for row in result["metrics"]})
            for line in worse:
                print(f"jaxftc: {line}", file=sys.stderr)
            if worse:
                sys.exit(1)
            common.say(self, "No ratio is worse than the baseline allows.")
        if self.update_baseline:
            baseline.save(result)
            common.say(self, f"Written: {baseline.PATH}, {baseline.RESULTS}")

    def _tuning(self, config: Config, folder: Path, ran: dict[str, Any]) -> tuple[dict[str, Any], str, str]:
        import numpy as np
        from tqdm import tqdm

        from benchmarks import curves, report

        gains = common.load_or_default(self, config)
        factors = {name: self.more if name == "cmaes" else 1.0 for name in ("gradient", *self.methods)}
        with tqdm(total=self.seeds * len(factors), desc="methods x seeds", unit="run", leave=False) as bar:
            found, cost = curves.measure(config, gains, self.seeds, self.settings, factors, bar.update)
        rows = [
            (c.method, c.seed, *point) for c in found for point in zip(c.simulations, c.seconds, c.objective, strict=True)
        ]
        names = ("method", "seed", "simulations", "seconds", "held_out_objective")
        write_parquet(
            folder / "curves.parquet",
            {n: np.array(column) for n, column in zip(names, zip(*rows, strict=True), strict=True)},
        )
        verdicts = curves.verdicts(found)
        result = {"settings": dataclasses.asdict(self.settings), "gradient_cost": cost, "seeds": self.seeds}
        result |= {"methods": verdicts}
        return result, tuning_text(cost, verdicts), report.curves_page(found, cost, ran)

    def _ranking(self, config: Config, folder: Path, ran: dict[str, Any]) -> tuple[dict[str, Any], str, str]:
        from tqdm import tqdm

        from benchmarks import ranking, report

        with tqdm(total=len(ranking.STRUCTURES) + 3, desc="structures", unit="run", leave=False) as bar:
            pairs, notes = ranking.measure(config, self.seed, self.held_out, self.settings, bar.update)
        rows = [pair._asdict() | {"ratio": pair.ratio._asdict(), "result": pair.word} for pair in pairs]
        settings = dataclasses.asdict(self.settings)
        page = report.ranking_page(pairs, notes, ran)
        return {"settings": settings, "pairs": rows, **notes}, ranking_text(pairs, notes), page


def tuning_text(cost: float, verdicts: dict[str, Any]) -> str:
    """The methods as a table."""
    head = f"{'method':10}{'held out':>10}{'simulations':>13}{'s':>8}{'compile s':>11}  gradient reaches it with"
    lines = [f"a gradient counts as {cost:.1f} simulations, measured", "", head, "-" * len(head)]
    for method, v in verdicts.items():
        fewer = ", ".join("-" if x is None else f"{x:.1f}" for x in v["gradient_needs_times_fewer"])
        middle, compiled = v["gradient_needs_times_fewer_median"], v["compile_s"]
        verdict = "not better than the start" if middle is None else f"{middle:.1f} times fewer (by seed: {fewer})"
        lines.append(
            f"{method:10}{v['final_median']:10.3f}{v['simulations']:13.0f}{v['seconds']:8.0f}"
            f"{'in there' if compiled is None else f'{compiled:.0f}':>11}  {verdict}"
        )
    return "\n".join(lines)


def ranking_text(pairs: list[Pair], notes: dict[str, Any]) -> str:
    """Both rankings as a table, and the notes."""
    head = f"{'ranking':18}{'condition':11}{'from':8}{'to':8}{'median ratio, 95 %':>26}{'n':>6}  result"
    lines = [head, "-" * len(head)]
    for p in pairs:
        ratio = f"{p.ratio.value:.3f} [{p.ratio.low:.3f}, {p.ratio.high:.3f}]"
        note = f" ({100 * p.louder:.0f} % cannot be made to chatter alike)" if p.louder else ""
        lines.append(f"{p.ranking:18}{p.condition:11}{p.before:8}{p.after:8}{ratio:>26}{p.n:6}  {p.word}{note}")
    lines.append("")
    for name, note in notes.items():
        lines.append(f"{name}: " + ", ".join(f"{k} {v:.3f}" for k, v in note.items()))
    return "\n".join(lines)
