"""The table of schemes, and of the named variants that campaigns and commands offer. Imports nothing: ``--help`` reads it.

A scheme is a module, or any object, with

* ``State``, which has ``q`` [n, ...] rad, the angle that it takes the arm to be at, ``unread`` [n, ...], ticks since a
  reading was last used, and ``tau`` [n, ...] N m, its last command before the limits,
* ``init(config, gains, q)`` and ``step(config, gains, state, reference, measurement)``,
* ``gains_used(config)``: the names of the gains that it reads, of which tuning moves some,
* ``DIAGNOSES``: whether it raises alarms, so that it has thresholds to set,
* if it has gains of its own, ``GAINS``: their class (``jaxftc.gains.block``); they are ``gains.own``,
* if its ``step`` takes the cascade's ``stages`` as data, ``STAGED = True``,
* if it learns the arm where ``config.adaptive`` says so, ``LEARNS = True``.

A scheme of the package is a module and its line here. Any other goes by the name under which Python finds it,
``module:object``, so that a new process and the manifest of a campaign find it too.
"""

from __future__ import annotations

from typing import Any

SCHEMES: dict[str, str] = {
    "cascade": "jaxftc.schemes.cascade",
    "momentum": "jaxftc.schemes.momentum",
    "ekf": "jaxftc.schemes.ekf",
    "computed_torque": "jaxftc.schemes.computed_torque",
}

# The cascade with another observer or control, or an arm that is learned: what changes in the config.
CASCADES: dict[str, dict[str, Any]] = {
    "pi": {"observer": "pi"},
    "eso": {"observer": "eso"},
    "eso_printed": {"observer": "eso_printed"},
    "smc": {"control": "smc"},
    "esmc": {"control": "esmc"},
    "adaptive": {"adaptive": True},
}

CONTRACT = ("State", "init", "step", "gains_used", "DIAGNOSES")


def variants() -> dict[str, dict[str, Any]]:
    """Every named variant, and what it changes in a config; read anew, so that an added scheme is among them."""
    return {name: {"scheme": name} for name in SCHEMES} | CASCADES


def changes(name: str) -> dict[str, Any]:
    """What a variant, or a scheme of the user's, changes in a config.

    Raises:
        ValueError: it is neither.
    """
    known = variants()
    if name not in known:
        load(name, tuple(known))
    return known.get(name, {"scheme": name})


def load(name: str, known: tuple[str, ...] = tuple(SCHEMES)) -> Any:
    """The scheme of a name; ``known`` is what an error lists.

    Raises:
        ValueError: nothing is found under it, or it lacks something.
    """
    from importlib import import_module

    if name in SCHEMES:
        return import_module(SCHEMES[name])
    module, _, path = name.partition(":")
    try:
        found = import_module(module)
        for part in path.split(".") if path else ():
            found = getattr(found, part)
    except (ImportError, AttributeError, ValueError, TypeError) as error:
        raise ValueError(_unknown(name, known, error)) from error
    lacking = [part for part in CONTRACT if not hasattr(found, part)]
    if lacking:
        raise ValueError(f"scheme {name!r} lacks {', '.join(lacking)}; a scheme has {', '.join(CONTRACT)}")
    try:
        hash(found)
    except TypeError as error:
        raise ValueError(f"scheme {name!r} must be hashable, as programs are kept by it; use a frozen dataclass") from error
    return found


def _unknown(name: str, known: tuple[str, ...], error: Exception) -> str:
    from difflib import get_close_matches

    near = get_close_matches(name, known, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else f" ({error}); is its folder on PYTHONPATH?"
    if name in CASCADES:
        hint = f"; that is {', '.join(f'{k}={v!r}' for k, v in CASCADES[name].items())} of the scheme 'cascade'"
    return f"scheme must be one of {', '.join(map(repr, known))}, or module:object, got {name!r}{hint}"


def name_of(scheme: Any) -> str:
    """The name under which ``load`` finds a scheme.

    Raises:
        ValueError: it would not be found under the name that it has.
    """
    if isinstance(scheme, str):
        return scheme
    module = getattr(scheme, "__module__", None)
    name = f"{module}:{getattr(scheme, '__qualname__', '')}" if module else getattr(scheme, "__name__", "")
    try:
        found = load(name)
    except ValueError:
        found = None
    if found is not scheme:
        raise ValueError(f"scheme must be a module, a class of one, or the text module:object, got {scheme!r}")
    return name


def own_gains(name: str) -> type | None:
    """The class of a scheme's own gains, if it has any; those of the package share theirs."""
    return None if name in SCHEMES else getattr(load(name), "GAINS", None)


def code(name: str) -> tuple[Any, ...]:
    """What tells a scheme of the user's from another one that had its name before: functions, defined anew in a notebook."""
    if name in SCHEMES:
        return ()
    found = load(name)
    return found.init, found.step


def source(name: str) -> str | None:
    """A digest of the name and the file of a user's scheme, if it is in one; what that imports is not looked at."""
    from hashlib import sha256
    from importlib import import_module
    from pathlib import Path

    path = None if name in SCHEMES else getattr(import_module(name.partition(":")[0]), "__file__", None)
    return sha256(name.encode() + Path(path).read_bytes()).hexdigest()[:16] if path else None
