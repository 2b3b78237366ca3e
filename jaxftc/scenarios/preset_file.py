"""Presets to and from TOML: the built-in ones and those that users write, checked by pydantic.

A file's error is one line: the file, the place in it, what came and what is allowed.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import importlib.resources
import re
import tomllib
import typing
from pathlib import Path
from typing import Any

import pydantic

from jaxftc import checks
from jaxftc.io.toml import read_toml
from jaxftc.scenarios.distributions import FORMS, WAYS
from jaxftc.scenarios.preset import Paper, Preset
from jaxftc.scenarios.preset_error import PresetError, one_of_text
from jaxftc.scenarios.presets import PRESET_NAMES

Table = dict[str, Any]
TAGS = ("<number>", *(f"<{form}>" for form in FORMS))  # of the form of a law, in the places that pydantic gives
CHANNELS = ("actuator", "sensor", "sensor_in_both")  # replaced as a whole, so that a file can drop kinds
BASE = 'or take what is not said from a preset, with base = "standard" on top'


def load_preset(preset: str | Path | Preset) -> Preset:
    """A preset by its name or from its file.

    Equal files give equal presets, also in their hash, so that nothing compiles twice.

    Args:
        preset: ``paper``, ``standard``, ``hard``, ``doubles``, ``uncommon`` or ``contact``; the path of a file, a
            text that ends in .toml; or a preset, which comes back as it is.

    Returns:
        The laws that scenarios are drawn from.

    Raises:
        ValueError: an unknown name, a file that cannot be read, or a key or value in it that is not allowed.
    """
    if isinstance(preset, Preset):
        return preset
    if isinstance(preset, Path) or str(preset).endswith(".toml"):
        return _load_file(Path(preset))
    try:
        checks.one_of("preset", preset, PRESET_NAMES)
    except ValueError as error:
        raise ValueError(f"{error} (a file of your own ends in .toml)") from None
    return _built_in(preset)


def as_dict(preset: Preset) -> Table:
    """The preset as plain tables that ``tomli_w`` writes and ``load_preset`` reads back to an equal one."""
    return {"base": "paper"} if isinstance(preset, Paper) else _plain(preset)


def said(preset: str) -> Table:
    """A preset by name or file, for records: its name, the preset that it is based on and what it changes of that."""
    own = dict(read_toml(preset, "preset")) if preset.endswith(".toml") else {}
    return {"name": preset, "base": own.pop("base", None) if own else preset, "changes": own}


@functools.cache
def _built_in(name: str) -> Preset:
    return Paper() if name == "paper" else _check(name, _built_in_table(name))


@functools.cache
def _built_in_table(name: str) -> Table:
    file = importlib.resources.files("jaxftc.scenarios.presets") / f"{name}.toml"
    return _complete(name, tomllib.loads(file.read_text(encoding="utf-8")))


def _load_file(path: Path) -> Preset:
    said = read_toml(path, "preset")
    if said.get("base") == "paper":
        if len(said) > 1:
            other = next(key for key in said if key != "base")
            raise ValueError(
                f'{path}: {other}: base = "paper" stands alone; its conditions are the paper\'s, nothing is drawn'
            )
        return _built_in("paper")
    return _check(path, _complete(path, said))


def _complete(where: str | Path, said: Table) -> Table:
    """What a file says, over what its base says."""
    own = dict(said)
    base = own.pop("base", None)
    if base is None:
        return own
    if not isinstance(base, str) or base not in PRESET_NAMES:
        raise ValueError(f"{where}: base: {one_of_text(base, PRESET_NAMES)}")
    return _over(_built_in_table(base), own)


def _over(base: Table, own: Table) -> Table:
    """Tables merge key by key; laws and the kinds of a channel are replaced as a whole."""
    merged = base | own
    for key, value in own.items():
        below = base.get(key)
        if isinstance(below, dict) and isinstance(value, dict) and key not in CHANNELS and not FORMS.keys() & below.keys():
            merged[key] = _over(below, value)
    return merged


def _check(where: str | Path, table: Table) -> Preset:
    try:
        return _adapter().validate_python(table)
    except pydantic.ValidationError as error:
        # A misspelt key is also a missing one: the former says what to do.
        found = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "unexpected_keyword_argument")[0]
        raise ValueError(f"{where}: {_line(found)}") from None


@functools.cache
def _adapter() -> pydantic.TypeAdapter[Preset]:
    return pydantic.TypeAdapter(Preset)


def _line(error: Any) -> str:
    """One line for one of pydantic's errors: the place, what came, what is allowed."""
    path = [part for part in error["loc"][:-1] if part not in TAGS]
    if error["loc"] and (error["loc"][-1] not in TAGS or error["type"] == "unexpected_keyword_argument"):
        path.append(error["loc"][-1])
    cause = error.get("ctx", {}).get("error")
    if isinstance(cause, PresetError):
        path += filter(None, [cause.place])
    place = ""
    for part in path:
        name = str(part) if re.fullmatch(r"[\w.-]+", str(part)) else repr(part)
        place += f"[{part}]" if isinstance(part, int) else f".{name}" if place else name
    return f"{place}: {cause.reason if isinstance(cause, PresetError) else _reason(error)}"


def _reason(error: Any) -> str:
    loc, kind, got = error["loc"], error["type"], _got(error["input"])
    if kind == "unexpected_keyword_argument":
        near = difflib.get_close_matches(str(loc[-1]), allowed := _keys(loc[:-1]), n=1)
        return "unknown key; " + (f"did you mean {near[0]!r}?" if near else f"the keys here are {', '.join(allowed)}")
    if kind == "missing":
        law = "{ uniform = [low, high] }"
        return f"missing; give a number or a law such as {law}" if loc[0] in CHANNELS else f"missing; give it, {BASE}"
    if kind == "dataclass_type":
        return f"must be a table of {', '.join(_keys(loc))}, {got}"
    if kind == "tuple_type":
        return f"must be a list of numbers, {got}"
    if kind == "union_tag_not_found" or (kind.startswith("float") and loc[-1] in TAGS):
        return f"must be {WAYS}, {got}"
    wanted = "an integer" if kind.startswith("int") else "a text" if kind.startswith("string") else "a number"
    return f"must be {wanted}, {got}"


def _got(value: object) -> str:
    text = repr(value)
    return f"got {text}" if len(text) <= 60 else f"got {text[:60]}..."


def _keys(loc: tuple[str | int, ...]) -> list[str]:
    """Keys that the table at one of pydantic's places can have."""
    table: Any = Preset
    for part in loc:
        if part in TAGS:
            table = FORMS[str(part)[1:-1]]
        else:
            hint = typing.get_type_hints(table)[str(part)]
            table = next((t for t in (hint, *typing.get_args(hint)) if dataclasses.is_dataclass(t)), table)
    return [field.name for field in dataclasses.fields(table)] + (["base"] if table is Preset else [])


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        items = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return {name: _plain(item) for name, item in items.items() if item is not None}
    return list(value) if isinstance(value, tuple) else value
