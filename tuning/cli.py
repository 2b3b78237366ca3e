"""``jaxftc tune``: gains by descent over simulated faults, compared on held-out scenarios."""

from __future__ import annotations

import contextlib
import dataclasses
import secrets
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from jaxftc.cli import common, results
from jaxftc.io.files import write_text
from jaxftc.io.tables import write_parquet
from tuning.settings import Settings

if TYPE_CHECKING:
    from jaxftc.config import Config
    from jaxftc.gains import Gains
    from tuning.held_out import Comparison
    from tuning.loop import Result
    from tuning.terms import Term

Terms = Annotated[tuple[str, ...], common.left_out("TERM=NUMBER ...")]
HELD_OUT = 0x48454C44  # keeps held-out scenarios apart from those of a training seed with the same number


@dataclasses.dataclass
class Tune(common.Options):
    """Tune the gains on simulated faults; writes gains.toml, history.parquet, report.html and result.json.

    To resume a run that was stopped, give the same command with the same --out.
    """

    settings: tyro.conf.OmitArgPrefixes[Settings] = dataclasses.field(default_factory=Settings)
    engine: Literal["mjx", "chain"] = "chain"
    """Simulated arm: recursions unrolled from its model, or MuJoCo MJX (same motion, several times slower)."""
    coulomb: bool = True
    """Give the PUMA 560 its Coulomb friction, in plant and model."""
    seed: int = 0
    """Seed of the scenarios, their noise and the search."""
    preset: str = "standard"
    """Distributions of the training scenarios: standard, hard, doubles, uncommon, contact, paper, or your own TOML file."""
    scheme: common.Scheme = "cascade"
    observer: Literal["pi", "eso", "ts"] = "ts"
    """PI, PI with super-twisting, or both with the Takagi-Sugeno stage."""
    control: Literal["smc", "esmc", "afesmc"] = "afesmc"
    """Sliding mode, with fault estimates, or with these and the fuzzy gain."""
    rules: Literal["printed", "symmetric", "s_only"] = "printed"
    """Table 1 of the paper as printed, or its corrected forms."""
    duration: common.MaybeNumber = None
    """Length of a simulated run, s; the motion's, 1 s, if not given."""
    only: common.Names = ()
    """Gains or blocks to tune, such as observer.alpha_i control (docs/gains.md); most if not given."""
    freeze: common.Names = ()
    """Gains or blocks to leave as they are."""
    shared: common.Names = ()
    """Gains or blocks that change by the same factor on all joints; the others change joint by joint."""
    weight: Terms = ()
    """Weights of terms of the objective, such as delay=3 tracking=2 (docs/tuning.md)."""
    limit: Terms = ()
    """Upper limits of terms on the validation scenarios, such as delay=0.2; gains beyond one are never chosen."""
    held_out: int = 512
    """Scenarios of each preset, standard and hard, on which the gains are compared in the end."""
    held_out_seed: common.MaybeInteger = None
    """Seed of the held-out scenarios; a random one, recorded in result.json, if not given."""
    distributed: bool = False
    """Be one of several processes, started by srun, mpirun or by hand, that share every batch (docs/scale.md)."""
    coordinator: Annotated[str | None, common.left_out("HOST:PORT")] = None
    """Address of the first process, with any free port; needed if started by hand, as are the next two."""
    processes: common.MaybeInteger = None
    """Number of processes."""
    process: common.MaybeInteger = None
    """Number of this process, from 0."""

    def run(self) -> None:
        """Tune, compare, write."""
        if not self.distributed:
            if (self.coordinator, self.processes, self.process) != (None, None, None):
                raise ValueError("--coordinator, --processes and --process are for --distributed; give that too")
            common.prepare(self, many=True, devices=True)
            self._run()
            return
        common.quiet_xla()
        from jaxftc.compile import processes

        line = processes.begin(processes.place(self.coordinator, self.processes, self.process))
        common.prepare(self, many=True, devices=True)
        with processes.together(line):
            self._run()

    def _run(self) -> None:
        """What every process does, and what the first, or only, one does with it."""
        import jax

        from jaxftc import checks, load_preset, sample_scenarios
        from jaxftc.compile import processes
        from tuning import transform
        from tuning.bar import Bar
        from tuning.held_out import compare
        from tuning.loop import fit

        self.settings.check()
        objective, limits = self._objective()
        checks.integer("--held-out", self.held_out, 2, "the gains are compared on them", high=1_000_000)
        checks.seed("--held-out-seed", self.held_out_seed or 0)
        config = self._config()
        preset = load_preset(self.preset)
        free = transform.select(config, self.only, self.freeze)
        start = common.load_or_default(self, config, preset=preset)
        train, validate, noise = jax.random.split(common.key(self), 3)
        count = self.settings.steps * self.settings.batch
        training = sample_scenarios(train, count, preset, config=config)
        validation = sample_scenarios(validate, self.settings.validation, preset, config=config)
        seed, writes = self._held_out_seed(), processes.first()
        with self._folder() if writes else contextlib.nullcontext() as folder:
            with Bar(config, shown=writes) as bar:
                result = fit(
                    config,
                    start,
                    training,
                    validation=validation,
                    key=noise,
                    objective=objective,
                    limits=limits,
                    only=free,
                    shared=self.shared,
                    settings=self.settings,
                    folder=folder,
                    on_round=bar.show,
                )
            if writes:
                common.say(self, f"comparing the gains on {self.held_out} held-out scenarios of each preset")
            unseen = jax.random.fold_in(jax.random.key(seed), HELD_OUT)
            settings = {"n": self.held_out, "objective": objective, "batch": self.settings.batch}
            encoder = preset.encoder if preset.encoder.in_counts else None
            comparisons = compare(config, start, result.gains, unseen, encoder=encoder, **settings)
            if folder is None:
                return
            text = self._write(folder, config, start, result, comparisons, seed)
        self._tell(folder, config, start, result, comparisons, seed)
        if self.json:
            print(text)

    def _objective(self) -> tuple[dict[str, Term], dict[str, float]]:
        """Terms with their weights, and limits on them."""
        from tuning import terms

        objective = terms.weighted(terms.OBJECTIVE, common.numbers("--weight", self.weight, "delay=3"))
        limits = common.numbers("--limit", self.limit, "delay=0.2")
        terms.check_terms("limit", objective, limits)
        return objective, limits

    def _config(self) -> Config:
        """What runs."""
        from jaxftc import Config
        from jaxftc.variants import changes

        common.look_here_for(self.scheme)
        dt = common.sample_time(self)
        structure: dict[str, Any] = {"observer": self.observer, "control": self.control} | changes(self.scheme)
        return Config(
            common.load_arm(self),
            dt=dt,
            t_final=common.motion_time(dt),
            engine=self.engine,
            rules=self.rules,
            duration=self.duration,
            **structure,
        )

    def _held_out_seed(self) -> int:
        """The seed of the held-out scenarios, the same in all processes."""
        from jaxftc.compile.processes import from_first

        fresh = secrets.randbits(31) if self.held_out_seed is None else self.held_out_seed
        return int(from_first(str(fresh).encode()))

    @contextlib.contextmanager
    def _folder(self) -> Iterator[Path]:
        """The folder for results, and for what a stopped run has left."""
        from tuning import checkpoint

        with results.folder(self, "tune", goes_on=True) as folder:
            if self.force:
                (folder / checkpoint.NAME).unlink(missing_ok=True)
            if (folder / checkpoint.NAME).exists():
                common.say(self, f"Resuming from {folder / checkpoint.NAME}; --force starts anew")
            elif self.out is None:
                common.say(self, f"To resume after a stop: the same command with --out {shlex.quote(str(folder))}")
            yield folder

    def _write(
        self, folder: Path, config: Config, start: Gains, result: Result, comparisons: list[Comparison], seed: int
    ) -> str:
        """All files; the text of result.json."""
        from jaxftc import save_gains
        from jaxftc.cli import record
        from tuning import report

        save_gains(folder / "gains.toml", result.gains, config)
        write_parquet(folder / "history.parquet", result.history)
        same_seed = () if self.held_out_seed is not None else ("--held-out-seed", str(seed))
        ran = record.of(self, config, more=same_seed)
        told = as_json(result, comparisons, folder) | {"held_out_seed": seed, "provenance": ran}
        write_text(folder / "report.html", report.page_of(config, start, result, comparisons, ran))
        return results.write_json(folder / "result.json", told)

    def _tell(
        self, folder: Path, config: Config, start: Gains, result: Result, comparisons: list[Comparison], seed: int
    ) -> None:
        """What came of it, for people."""
        from jaxftc.stages import staged
        from tuning import report

        common.say(self, summary(result, comparisons, seed))
        common.say(self, "\n".join(["", "gains, before -> after", *(report.moved(start, result.gains) or ["none moved"])]))
        common.say(self, f"\nWritten to {folder}: gains.toml, history.parquet, result.json, report.html")
        arm = ("--coulomb" if self.coulomb else "") if self.robot == "puma560" else shlex.join(common.arm_words(self))
        words = ["jaxftc simulate --engine chain", arm, f"--observer {config.observer} --control {config.control}"]
        words += ["--adaptive"] * config.adaptive
        if self.rules == "printed" and staged(config):  # what the command has options for
            words.append(f"--gains {shlex.quote(str(folder / 'gains.toml'))}")
            common.say(self, f"See them at work: {' '.join(filter(None, words))}")


def as_json(result: Result, comparisons: list[Comparison], folder: Path) -> dict[str, Any]:
    """The machine-readable result; a simulation is one closed-loop run, a gradient counted as several."""
    held_out = {c.preset: c.as_dict() for c in comparisons if c.sign == "smooth"}
    hard_sign = {c.preset: c.as_dict() for c in comparisons if c.sign == "hard"}
    return {
        "held_out": held_out,
        "held_out_hard_sign": hard_sign,
        "steps": result.steps,
        "best_step": result.best_step,
        "simulations": result.simulations,
        "seconds": result.seconds,
        "stopped": result.stopped,
        "events": result.events,
        "limits": {
            name: {"limit": limit, "before": before, "after": after, "kept": after <= limit}
            for name, limit in result.limits.items()
            for before, after in (result.validation[name],)
        },
        "gains": str(folder / "gains.toml"),
    }


def summary(result: Result, comparisons: list[Comparison], seed: int) -> str:
    """The held-out comparison as text."""
    from tuning.problem import LOST

    lines = [
        f"{result.steps} steps, {result.simulations} closed-loop simulations, {result.seconds:.0f} s: {result.stopped}; "
        + (f"gains of step {result.best_step}" if result.best_step else "no step was better: the gains are unchanged"),
        *(f"  {event}" for event in result.events),
    ]
    for name, limit in result.limits.items():
        before, after = result.validation[name]
        kept = "kept" if after <= limit else f"NOT KEPT by any step: relax it, give --weight {name}=..., or more --steps"
        lines.append(f"limit {name} {limit:g}: {before:.4f} -> {after:.4f} on the validation scenarios, {kept}")
    for c in comparisons:
        (before, after), (low, high) = c.objective, c.ratio[1:]
        name = c.preset + (", hard sgn" if c.sign == "hard" else "")
        lines.append(
            f"\nheld out, {name}: objective {before:.3f} -> {after:.3f}, ratio {after / before:.3f}, "
            f"95 % [{low:.3f}, {high:.3f}], {c.before.shape[1]} scenarios of seed {seed}"
        )
        middle = [f"{m.value:.3f} [{m.low:.3f}, {m.high:.3f}]" for m in c.median]
        lines.append(f"  median over scenarios {middle[0]} -> {middle[1]}")
        if any(c.diverged):
            lines.append(f"  DIVERGED: {c.diverged[0]} -> {c.diverged[1]} runs, which count {LOST:g} in every term")
        for term, b, a, weight in zip(c.names, c.before.mean(1), c.after.mean(1), c.weights, strict=True):
            note = "  WORSE" if c.word(term) == "worse" else ""
            lines.append(f"  {term:12} {b:8.4f} -> {a:8.4f}   weight {weight:g}{note}")
    return "\n".join(lines)
