"""The tick as C99: ``ftc_step.h`` and ``ftc_step.c``."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence

import jax
import numpy as np

from jaxftc.compile import c99
from jaxftc.compile.scalars import scalars
from jaxftc.export.tick import Leaf, Tick, precision

KINDS = {"float32": "ftc_real", "float64": "ftc_real", "int32": "int32_t", "int64": "int64_t", "bool": "bool"}


def source(tick: Tick) -> dict[str, str]:
    """Text of the files by name."""
    return {"ftc_step.h": header(tick), "ftc_step.c": code(tick)}


def header(tick: Tick) -> str:
    """Types, metadata and the two functions."""
    facts, leaves = tick.metadata, tick.leaves()
    joints = ", ".join(f"{k} {name}" for k, name in enumerate(facts["joint_names"]))
    limits = ", ".join("none" if limit is None else f"{limit:g}" for limit in facts["torque_limit_nm"])
    about = [
        "One tick of fault diagnosis and fault-tolerant control, written by jaxftc export; do not edit.",
        "",
        f"robot        {_clean(facts['robot'])} ({facts['robot_fingerprint']})",
        f"joints       {_clean(joints)}",
        f"limits       {limits} N m",
        f"sample time  {facts['dt']:g} s",
        f"scheme       {facts['scheme']}, observer {facts['observer']}, control {facts['control']}",
        f"arm          {'learned while it runs' if facts['adaptive'] else 'as the model has it'}",
        f"decision     {facts['decision']}",
        f"gains        {facts['gains']}, SHA-256 {facts['gains_sha256']}",
        f"jaxftc       {facts['jaxftc']}",
        "",
        "Call ftc_init once, at rest, and ftc_step once a sample time. They allocate nothing, call nothing",
        "but math.h, have no loop, and no state but what they are given: one for each arm.",
        "Units are rad, N m, s and kg. An array has a number a joint, in the order above.",
    ]
    names = [f'"{_clean(name)}"' for name in facts["joint_names"]]
    lines = ["/*", *(f" * {line}".rstrip() for line in about), " */", "#ifndef FTC_STEP_H", "#define FTC_STEP_H", ""]
    lines += ["#include <stdbool.h>", "#include <stdint.h>", "", "#ifdef __cplusplus", 'extern "C" {', "#endif", ""]
    lines += [
        f"typedef {tick.real} ftc_real;",
        "",
        "/* Verdicts; unknown: the state was lost. */",
        "enum { FTC_NORMAL, FTC_ACTUATOR, FTC_SENSOR, FTC_BOTH, FTC_UNKNOWN, FTC_CONTACT = 8 };",
        "",
        f"#define FTC_JOINTS {tick.config.n}",
        f"#define FTC_SAMPLE_TIME {c99.literal(np.float64(facts['dt']))} /* s */",
        f'#define FTC_GAINS_SHA256 "{facts["gains_sha256"]}"',
        f"#define FTC_JOINT_NAMES {{{', '.join(names)}}}",
        f"#define FTC_TORQUE_LIMITS {{{', '.join(map(_limit, facts['torque_limit_nm']))}}} /* N m, 0: none */",
        "",
    ]
    lines += _struct(
        "ftc_reference", "What motion is wanted. A joint with a value that is not finite holds its angle.", leaves
    )
    lines += _struct("ftc_measurement", "What the robot says. What is not finite did not come.", leaves)
    lines += ["typedef struct {", "    ftc_reference reference;", "    ftc_measurement measurement;", "} ftc_in;", ""]
    lines += _struct("ftc_out", "What the tick says.", leaves)
    lines += _struct("ftc_state", "What the next tick needs; not to be read or changed.", leaves)
    if tick.at_run_time:
        lines += _struct("ftc_gains", "What tuning may change.", leaves)
        lines += ["/* The gains of the file above. */", "extern const ftc_gains ftc_default_gains;", ""]
    lines += [
        "/* State at rest in q [rad], which must be finite, holding the arm against gravity. */",
        f"{_init(tick)};",
        "",
    ]
    lines += ["/* One tick: changes the state, fills out. */", f"{_step(tick)};", ""]
    return "\n".join([*lines, "#ifdef __cplusplus", "}", "#endif", "#endif", ""])


def code(tick: Tick) -> str:
    """The two functions."""
    leaves = tick.leaves()
    with precision(tick.real):
        init, step = scalars(tick.init, *tick.init_arguments), scalars(tick.step, *tick.step_arguments)
    state = _places("state->", leaves["state"])
    gains = _places("gains->", leaves["gains"]) if tick.at_run_time else []
    signals = _places("in->reference.", leaves["reference"]) + _places("in->measurement.", leaves["measurement"])
    at_rest = c99.body(init, [*gains, [f"q[{j}]" for j in range(tick.config.n)]], state)
    of_tick = c99.body(step, [*gains, *state, *signals], [*state, *_places("out->", leaves["out"])])
    lines = ["/* Written by jaxftc export; do not edit. One line an operation, in the order of the paper's boxes. */"]
    lines += ['#include "ftc_step.h"', "", "#include <math.h>", "", *c99.helpers(init, step), ""]
    if tick.at_run_time:
        lines += [*_default_gains(tick, leaves["gains"]), ""]
    for signature, statements in ((_init(tick), at_rest), (_step(tick), of_tick)):
        unused = [f"(void){name};" for name in ("gains", "q", "in") if f"*{name}" in signature or f"{name}[" in signature]
        unused = [line for line in unused if not any(line[6:-1] in statement for statement in statements)]
        lines += [f"{signature} {{", *(f"    {line}".rstrip() for line in (*unused, *statements)), "}", ""]
    return "\n".join(lines)


def _init(tick: Tick) -> str:
    gains = "const ftc_gains *gains, " if tick.at_run_time else ""
    return f"void ftc_init(ftc_state *state, {gains}const ftc_real q[FTC_JOINTS])"


def _step(tick: Tick) -> str:
    gains = "const ftc_gains *gains, " if tick.at_run_time else ""
    return f"void ftc_step(ftc_state *state, {gains}const ftc_in *in, ftc_out *out)"


def _struct(name: str, about: str, leaves: dict[str, list[Leaf]]) -> list[str]:
    lines = [f"/* {about} */", "typedef struct {"]
    for leaf in leaves[name.removeprefix("ftc_")]:
        size = f"[{math.prod(leaf.shape)}]" if leaf.shape else ""
        shape = f"[{', '.join(map(str, leaf.shape))}]" if len(leaf.shape) > 1 else ""
        said = re.sub(r"^(int32|bool), ", "", leaf.about.partition("] ")[2] or leaf.about) or shape
        said = said.replace("``", "")  # Python's markup
        member = f"    {KINDS[leaf.dtype.name]} {leaf.name}{size};"
        lines.append(f"{member} /* {said} */" if said else member)
    return [*lines, f"}} {name};", ""]


def _places(before: str, leaves: Sequence[Leaf]) -> list[list[str]]:
    """Expressions for every number of every leaf."""
    return [
        [f"{before}{leaf.name}[{k}]" for k in range(math.prod(leaf.shape))] if leaf.shape else [f"{before}{leaf.name}"]
        for leaf in leaves
    ]


def _default_gains(tick: Tick, leaves: Sequence[Leaf]) -> list[str]:
    lines = ["const ftc_gains ftc_default_gains = {"]
    for leaf, value in zip(leaves, jax.tree.leaves(tick.gains), strict=True):
        numbers = ", ".join(c99.literal(number) for number in np.ravel(np.asarray(value)))
        lines.append(f"    .{leaf.name} = {{{numbers}}},")
    return [*lines, "};"]


def _limit(limit: float | None) -> str:
    return "0" if limit is None else repr(limit)


def _clean(name: str) -> str:
    """A name that ends neither a comment nor a string."""
    return json.dumps(name)[1:-1].replace("*/", "* /")
