"""``jaxftc export``: the tick as C99 and as StableHLO, and the check of both."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from jaxftc.cli import common, results

if TYPE_CHECKING:
    from jaxftc.export.check import Compared
    from jaxftc.export.tick import Tick


@dataclasses.dataclass
class Export(common.Options):
    """The tick as C99 and as StableHLO, for a controller without Python.

    Writes ftc_step.h, ftc_step.c, example.c, ftc_init.stablehlo, ftc_step.stablehlo, gains.toml and ftc.json.
    """

    scheme: common.Scheme = "cascade"
    decision: Literal["rule", "learned"] = "rule"
    """What names joints and channels after an alarm: the paper's rule, or a network with memory."""
    real: Literal["double", "float"] = "double"
    """Precision of the code."""
    gains_at_run_time: bool = False
    """Make the gains an argument (a struct), not constants."""
    check: bool = False
    """Compare the files with jaxftc.step under every kind of fault; exit code 1 if they differ. C needs a compiler."""
    ticks: int = 10_000
    """Ticks of each kind of fault in the check."""
    coulomb: bool = True
    """Give the PUMA 560 its Coulomb friction, in the controller's model."""
    seed: int = 0
    """Seed of the check's motions, faults and noise."""
    engine: tyro.conf.Suppress[Literal["mjx", "chain"]] = "chain"

    def run(self) -> None:
        """Write, check, say where."""
        from jaxftc import checks

        checks.integer("--ticks", self.ticks, 1, "it is the number of ticks of each kind of fault")
        common.prepare(self, many=self.check)
        from jaxftc import Config
        from jaxftc.campaigns.spec import variant
        from jaxftc.cli import record
        from jaxftc.export.folder import write
        from jaxftc.export.tick import precision

        common.key(self)  # the seed's range
        common.look_here_for(self.scheme)
        dt = common.sample_time(self)
        base = Config(common.load_arm(self), dt=dt, t_final=1000 * dt, engine="chain", decision=self.decision)
        config = variant(base, self.scheme)
        with precision("double"):
            gains = common.load_or_default(self, config)
        with results.folder(self, "export") as folder:
            tick = write(config, gains, folder, real=self.real, gains_at_run_time=self.gains_at_run_time)
            compared = self._compare(tick, folder) if self.check else {}
            checked = {name: one._asdict() | {"met": one.met} for name, one in compared.items()}
            result = tick.metadata | {"check": checked or None}
            text = results.write_json(folder / "result.json", result | {"provenance": record.of(self, config)})
        for name, one in compared.items():
            common.say(self, table(name, one))
        common.say(self, f"Written to {folder}: ftc_step.h, ftc_step.c, example.c, StableHLO, gains.toml, ftc.json")
        if self.json:
            print(text)
        different = [name for name, one in compared.items() if not one.met]
        if different:
            print(f"jaxftc: {' and '.join(different)} differ from jaxftc.step, see above", file=sys.stderr)
            sys.exit(1)

    def _compare(self, tick: Tick, folder: Path) -> dict[str, Compared]:
        from tqdm import tqdm

        from jaxftc.compile import native
        from jaxftc.export import check
        from jaxftc.export.artifact import Native, StableHLO

        artifacts: dict[str, Any] = {"StableHLO": StableHLO(folder, tick)}
        if native.compiler() is None:
            common.say(self, "no C compiler (cc, gcc, clang, or the one that CC names): the C code is not checked")
        else:
            artifacts = {"C": Native(folder, tick)} | artifacts
        run = min(check.RUN, self.ticks)
        total = len(check.KINDS) * run * -(-self.ticks // run)
        with tqdm(total=total, desc="ticks", unit="tick", leave=False) as bar:
            return check.compare(tick, artifacts, ticks=self.ticks, run=run, seed=self.seed, done=bar.update)


def table(name: str, found: Compared) -> str:
    """The comparison of an artifact as text."""
    lines = [f"{name} against jaxftc.step, {found.ticks} ticks of each kind of fault", ""]
    lines += [f"{'fault':22}{'largest difference over the signal':>36}"]
    lines += [f"{kind:22}{error:36.1e}" for kind, error in found.error.items()]
    if found.learned:
        lines.append(f"\nwhat is learned of the arm {found.learned:.1e}, allowed {found.learned_tolerance:g}")
    if found.counted:
        lines.append(f"\nticks in which a counter differs {found.counted}, allowed {found.counted_tolerance}")
    lines.append(f"\nallowed {found.tolerance:g}; verdicts that differ: {found.verdicts}; worst signal: {found.worst}")
    return "\n".join([*lines, "the same\n" if found.met else "NOT THE SAME\n"])
