"""Which column is which: our names, the joints' names, and how ur_rtde, libfranka, PlotJuggler and LeRobot write them.

A name is a word for the quantity and a joint, in any order and with any separators: ``q1``, ``tau_elbow``, ``actual_q_0``,
``state.q[0]``, ``/joint_states/elbow/position``, ``observation.state.0``. The words are in ``words``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from jaxftc import checks
from jaxftc.logs.formats import unit_named
from jaxftc.logs.words import ANGLE, CURRENT, PARTIAL, TIME, TORQUE, WANTED, core

_UNIT = re.compile(r"[\s_]*[\[(]\s*([^\[\]()]+?)\s*[\])]$|_([A-Za-z]+)$")
_UNSURE = {  # behind an underscore these are units only in names of what has them: torque_a is of arm a, q_min a limit
    "a": re.compile(r"curr|amp|^i[\W_]*\d*$", re.IGNORECASE),
    "h": re.compile(r"time|stamp|elapsed|epoch|(^|_)t$", re.IGNORECASE),
    "min": re.compile(r"time|stamp|elapsed|epoch|(^|_)t$", re.IGNORECASE),
}
_JOINT = r"joints?|j|axis|motor|actuators?|servos?"
_INDEX = (
    re.compile(r"^(.*?)[\W_]*?(?:joint|j|(?<![A-Za-z])(?:a|axis))?[\W_]*(\d+)[\W_]*()$", re.IGNORECASE),  # q1, state.q[0]
    re.compile(rf"^(.*?)(?:{_JOINT}|(?<![A-Za-z])a)[\W_]*(\d+)[\W_]+(.*)$", re.IGNORECASE),  # joint1_position
    re.compile(r"^(.*?)[\W_]*(\d+)[\W_]+((?:meas|act|msr|fbk|feedback|raw)[a-z]*)$", re.IGNORECASE),  # q1_measured
)


class Columns(NamedTuple):
    """Names in the file of what a log needs, joints in the robot's order."""

    time: str | None
    angle: list[str]
    torque: list[str] | None  # None where the file has none
    units: dict[str, list[str | float | None]]  # of "time", "angle", "torque", column by column; None: not said
    signs: dict[str, float]  # of columns that were given with a minus
    notes: list[str]


class _Group(NamedTuple):
    """Columns that share a word."""

    word: str
    path: str  # the word as the file has it
    unit: str | float | None
    columns: dict[str, str]  # joint, or index as text -> column
    again: dict[str, str]  # the same, of columns that name what an earlier one does


def find(
    names: list[str], joints: tuple[str, ...], given: Mapping[str, str] | None, below: Mapping[str, str] | None = None
) -> Columns:
    """The columns of a log.

    Args:
        names: All columns of the file.
        joints: The robot's joints.
        given: Our names (t, q1, ..., tau1, ...) and the file's, where the user says them; ``-name`` turns the sign round.
        below: Units by column that the file has elsewhere than in its names.

    Raises:
        ValueError: no angles can be found, a word has too few joints, the columns of several arms fit, or a given column is
            not there.
    """

    def unit_of(column: str) -> str | float | None:
        unit = _bare(column)[1]
        return unit_named((below or {}).get(column, "")) if unit is None else unit

    notes: list[str] = []
    chosen, signs = _given(names, len(joints), given or {})
    groups = _groups(names, joints)
    angle = _complete(chosen, "q", len(joints)) or _pick(groups, ANGLE, joints, notes)
    torque = _complete(chosen, "tau", len(joints)) or _pick(groups, TORQUE, joints, notes)
    current = None if torque else _pick(groups, CURRENT, joints, notes)
    time = chosen.get("t") or next((n for word in TIME for n in names if _bare(n)[0] == word), None)
    if time is None:
        time = next((n for n in names if _bare(n)[0] in ("t", *TIME) or _last(n) in TIME), None)
    if angle is None:
        n = len(joints)
        raise ValueError(
            f"the log must have columns q1 to q{n} in rad, or q_{joints[0]} and so on; it has {listed(names)}; "
            f"say which they are with --columns q1=... to q{n}=..."
        )
    units = {
        "time": [unit_of(time) if time is not None else None],
        "angle": [unit_of(column) for column in angle],
        "torque": [unit_of(column) for column in torque or current or []],
    }
    if current is not None:
        own = "load" if "load" in current[0].lower() else "A"
        units["torque"] = [unit or own for unit in units["torque"]]
    said = {"angle": angle, "torque": torque or current or []}
    for key, columns in said.items():
        if columns and _plain(columns[0]) not in (f"{'q' if key == 'angle' else 'tau'}1",) and not given:
            notes.append(f"{key} taken from {columns[0].strip()} to {columns[-1].strip()}")
    return Columns(time, angle, torque or current, units, signs, notes)


def _given(names: list[str], n: int, given: Mapping[str, str]) -> tuple[dict[str, str], dict[str, float]]:
    ours = ("t", *(f"{word}{j + 1}" for word in ("q", "tau") for j in range(n)))
    chosen, signs = {}, {}
    for key, name in given.items():
        checks.one_of("--columns", key, ours)
        negative = name.startswith("-") and name not in names
        checks.one_of(f"column {key}", name[negative:], names)
        chosen[key] = name[negative:]
        if negative:
            signs[name[1:]] = -1.0
    return chosen, signs


def _complete(chosen: dict[str, str], word: str, n: int) -> list[str] | None:
    wanted = [f"{word}{j + 1}" for j in range(n)]
    there = [chosen[w] for w in wanted if w in chosen]
    if there and len(there) < n:
        missing = next(w for w in wanted if w not in chosen)
        raise ValueError(f"--columns names some of {wanted[0]} to {wanted[-1]}, but not {missing}; name all {n}, or none")
    return there or None


def _plain(text: str) -> str:
    return re.sub(r"[\W_]", "", text.lower())


def _bare(name: str) -> tuple[str, str | float | None]:
    """A name without unit, lower case and without separators; and the unit."""
    found = _UNIT.search(name.strip())
    if found is None or (unit := unit_named(found[1] or found[2])) is None:
        return _plain(name), None
    rest = name.strip()[: found.start()]
    if found[2] in _UNSURE and not _UNSURE[found[2]].search(rest):
        return _plain(name), None
    return _plain(rest), unit


def _last(name: str) -> str:
    return _plain(re.split(r"[/.]", name.strip().strip("/"))[-1])


def _groups(names: list[str], joints: tuple[str, ...]) -> list[_Group]:
    """Columns by word: those with a joint's name in them, then those with a number."""
    groups: dict[tuple[bool, str], _Group] = {}
    aliases = sorted(((alias, j) for j in joints for alias in {j, j.removesuffix("_joint")}), key=lambda a: -len(a[0]))

    def put(by_name: bool, path: str, key: str, column: str) -> None:
        word, unit = _bare(path)
        group = groups.setdefault((by_name, path.lower()), _Group(word, path, unit, {}, {}))
        if group.columns.setdefault(key, column) != column:
            group.again[key] = column

    for name in names:
        body = name.strip()
        unit = _UNIT.search(body)
        tail = body[unit.start() :] if unit and _bare(body)[1] is not None else ""
        plain = body[: len(body) - len(tail)]
        for alias, joint in aliases:
            found = re.search(rf"(?<![A-Za-z0-9]){re.escape(alias)}(?![A-Za-z0-9])", plain)
            if found:
                before, after = plain[: found.start()].strip("/._-[ "), plain[found.end() :].strip("/._-] ")
                put(True, f"{before}/{after}{tail}", joint, name)
                break
        indexed = next((found for pattern in _INDEX if (found := pattern.match(plain))), None)
        if indexed:
            put(False, indexed[1] + indexed[3] + tail, str(int(indexed[2])), name)
    return [groups[key] for key in sorted(groups, key=lambda key: not key[0])]


def _pick(groups: list[_Group], words: tuple[str, ...], joints: tuple[str, ...], notes: list[str]) -> list[str] | None:
    """Columns of the first word that has all joints."""
    short: _Group | None = None
    for match in (lambda group: group.word, lambda group: _last(_strip_unit(group.path))):
        for word in words:
            there = [group for group in groups if match(group) == word]
            if found := _whole(there, joints, notes):
                return found
            short = short or next((group for group in there if "load" not in word), None)  # a computer has one, too
    for word in words:  # units differ from joint to joint
        if found := _whole(_joined([group for group in groups if group.word == word]), joints, notes):
            return found
    for word in (*words, *([""] if words is ANGLE else [])):  # joints alone, without a word, are angles
        if found := _whole([g for g in groups if core(_strip_unit(g.path)) == word and _says(g)], joints, notes):
            return found
    kinds = {ANGLE: ("rad", "deg", "mrad"), TORQUE: ("N m", "mN m", "N cm")}.get(words, ())
    if found := _whole(
        [g for g in groups if g.unit in kinds and not re.search(f"{WANTED.pattern}|{PARTIAL.pattern}", g.path, re.I)],
        joints,
        notes,
    ):
        return found  # a word that is not known, but its unit is
    if short is not None and not set(short.columns) <= {"0", "1"}:
        raise ValueError(
            f"the log must have columns {words[0]}1 to {words[0]}{len(joints)} for the arm's {len(joints)} joints "
            f"({', '.join(joints)}); it has {listed(list(short.columns.values()))}; say which they are with --columns"
        )
    return None


def _whole(there: list[_Group], joints: tuple[str, ...], notes: list[str]) -> list[str] | None:
    """Columns of the one group that has all joints; None if none has."""
    whole = [(group, keys) for group in there if (keys := _keys(group, joints))]
    if not whole:
        return None
    group, keys = _one(whole)
    if double := next((key for key in keys if key in group.again), None):
        raise ValueError(
            f"columns {group.columns[double]!r} and {group.again[double]!r} name one thing; remove one, or say which with "
            "--columns"
        )
    more = len(group.columns) - len(joints)
    if more > 0:
        notes.append(f"{more} columns of {group.path!r} beyond the arm's {len(joints)} joints are left out")
    return [group.columns[key] for key in keys]


def _joined(there: list[_Group]) -> list[_Group]:
    """Groups that differ in their unit only, as one."""
    out: dict[tuple[bool, str], _Group] = {}
    for group in there:
        by_name = not next(iter(group.columns)).isdigit()
        one = out.setdefault((by_name, _strip_unit(group.path).lower()), group._replace(columns={}, again={}))
        one.again.update({key: column for key, column in group.columns.items() if key in one.columns})
        one.columns.update({key: column for key, column in group.columns.items() if key not in one.columns})
    return list(out.values())


def _says(group: _Group) -> bool:
    """Whether its columns are more than numbers, and no wanted values."""
    return any(c.isalpha() for column in group.columns.values() for c in column) and not WANTED.search(group.path)


def _keys(group: _Group, joints: tuple[str, ...]) -> list[str] | None:
    """The joints' names or numbers, as the group has all of them."""
    low = 0 if "0" in group.columns else 1
    ways = list(joints), [str(low + j) for j in range(len(joints))]
    return next((keys for keys in ways if all(key in group.columns for key in keys)), None)


def _one(whole: list[tuple[_Group, list[str]]]) -> tuple[_Group, list[str]]:
    """The one of several groups of a word that was measured; columns by name come before numbered ones."""
    by_name = [(group, keys) for group, keys in whole if not keys[0].isdigit()] or whole
    measured = [(group, keys) for group, keys in by_name if not WANTED.search(group.path)] or by_name
    if len(measured) > 1:
        first = " and ".join(repr(group.columns[keys[0]]) for group, keys in measured[:2])
        raise ValueError(f"columns of {len(measured)} arms or topics fit, as {first} say; say which with --columns")
    return measured[0]


def _strip_unit(path: str) -> str:
    return path if _bare(path)[1] is None else path[: _UNIT.search(path.strip()).start()]  # pyright: ignore[reportOptionalMemberAccess]


def listed(names: list[str]) -> str:
    """The first thirty names, and how many more there are."""
    return ", ".join(names[:30]) + (f" and {len(names) - 30} more" if len(names) > 30 else "")
