"""The demo's page: the paper's figures, block diagram and Table 1, each claim with our number and whether it was met."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxftc.config import Config
from jaxftc.fuzzy import rule_table
from jaxftc.gains import Gains
from jaxftc.paper import diagram
from jaxftc.paper.figures import figures
from jaxftc.report.figures import surface_figure
from jaxftc.report.page import embed, page, table
from jaxftc.scenarios.scenario import PAPER_ANGLE, PAPER_TORQUE, PAPER_WINDOW

if TYPE_CHECKING:
    from jaxftc.paper.claims import Claim
    from jaxftc.paper.results import Experiment, Row

SETS = ("NB", "NM", "NS", "Z", "PS", "PM", "PB")
LEVELS = ("PS", "PM", "PB")


def demo_page(config: Config, gains: Gains, experiment: Experiment, ran: Mapping[str, Any] = MappingProxyType({})) -> str:
    """The paper's experiment: claims, block diagram, the paper's figures in their order, comparison table; what ran."""
    sections = [
        f"<p>{html.escape(_about(config))}</p>",
        "<h2>The paper's claims, met or not</h2>" + _claims(experiment.claims),
        f"<h2 id='figure-8'>Figures 1 and 8. What runs in one tick</h2>{diagram.draw()}",
        "<h2>The paper's figures, from our runs</h2>",
        *(
            embed(
                figure, number=number, below="".join(_claim(claim) for claim in experiment.claims if claim.figure == number)
            )
            for number, figure in figures(config, gains, experiment)
        ),
        "<h2 id='table-1'>Table 1. Fuzzy rules of the switching gain</h2>" + _rules(config, gains),
        embed(surface_figure(config, {"": gains}, "Table 1 as a surface: the factor on the switching gain")),
        "<h2>Every observer with every controller</h2>" + _comparison(experiment.rows),
    ]
    return page("jaxftc demo: the paper's experiment", sections, config.robot.joint_names, ran)


def _about(config: Config) -> str:
    start, end = PAPER_WINDOW
    return (
        f"{config.robot.name}, {config.engine} engine, {config.ticks * config.dt:g} s at {1 / config.dt:g} Hz, one set of "
        f"gains for every run. Faults are on every joint at once, from {start:g} to {end:g} s: {PAPER_TORQUE:g} N m of "
        f"torque, {math.degrees(PAPER_ANGLE):g} deg of the encoder, or both. Angles of the arm are true ones unless called "
        "readings; verdicts come from readings and commands alone."
    )


def _rules(config: Config, gains: Gains) -> str:
    """The rule base as it is used, with the centre of each output set."""
    outputs = np.asarray(gains.control.outputs)
    rules = rule_table.TABLES[config.rules].tolist()
    body = [(SETS[row], *(LEVELS[level] for level in levels)) for row, levels in enumerate(rules)]
    centres = ", ".join(f"{name} {value:g}" for name, value in zip(LEVELS, outputs, strict=True))
    words = f"Rows: joint position; columns: sliding surface s; entries: output set, centres {centres}."
    if config.rules == "printed":
        words += " As printed, it raises the gain by joint position, which has nothing to do with a fault."
    return f"<p>{html.escape(words)}</p>" + table(("q \\ s", *SETS), body)


def _claims(claims: list[Claim]) -> str:
    """All claims with our numbers, each leading to its figure."""
    rows = [
        (_fate(claim), (f"Fig. {claim.figure}", f"#figure-{claim.figure}"), claim.claim, _value(claim), claim.detail)
        for claim in claims
    ]
    return table(("", "", "claim", "our figure", "detail"), rows, text=5, look="claims")


def _claim(claim: Claim) -> str:
    """A claim as a line under its figure."""
    fate, look = _fate(claim)
    words = (html.escape(text) for text in (claim.claim, _value(claim), claim.detail))
    return "<p class='claim'><span class='{}'>{}</span> {}: <b>{}</b> <span class='note'>({})</span></p>".format(
        look, fate, *words
    )


def _fate(claim: Claim) -> tuple[str, str]:
    return ("met", "yes") if claim.met else ("not met", "no")


def _value(claim: Claim) -> str:
    return f"{claim.value:.4g} {claim.unit}"


def comparison(rows: list[Row]) -> tuple[tuple[str, ...], tuple[str, ...], list[tuple[str, ...]]]:
    """Head, units and cells of the comparison table, for page and terminal alike."""
    head = ("condition", "observer", "controller", "torque est.", "angle est.", "delay", "isolated", "false alarm")
    head += ("tracking", "chattering")
    units = ("", "", "", "rms N m", "rms deg", "ms", "", "at s", "rms deg", "1/s")
    cells = [
        (
            *(
                r.condition,
                r.observer.upper(),
                r.controller.upper(),
                f"{r.fault_tau_rms_nm:.3f}",
                f"{r.fault_q_rms_deg:.4f}",
            ),
            "-" if r.delay_s is None else "missed" if np.isinf(r.delay_s) else f"{r.delay_s * 1e3:.0f}",
            *("yes" if r.isolated else "no", "-" if r.false_alarm_s is None else f"{r.false_alarm_s:.3f}"),
            *(f"{r.tracking_rms_deg:.3f}", f"{r.chattering:.2f}"),
        )
        for r in rows
    ]
    return head, units, cells


def _comparison(rows: list[Row]) -> str:
    head, units, cells = comparison(rows)
    note = (
        "Rms over joints and the run. Delay: from onset to the first alarm. Isolated: every joint's verdict is right 60 "
        "ms after it. Chattering: travel of the torque over its limit, per second."
    )
    return f"<p>{note}</p>" + table(head, cells, units=units, text=3)
