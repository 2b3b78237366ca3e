"""The table of schemes, and of the named variants that campaigns and commands offer. Imports nothing: ``--help`` reads it.

A scheme is a module with

* ``State``, which has ``q`` [n, ...] rad, the angle that it takes the arm to be at, ``unread`` [n, ...], ticks since a
  reading was last used, and ``command.tau`` [n, ...] N m, its last command before the limits,
* ``init(config, gains, q)`` and ``step(config, gains, state, reference, measurement)``,
* ``gains_used(config)``: the names of the gains that it reads, of which tuning moves some,
* ``DIAGNOSES``: whether it raises alarms, so that it has thresholds to set.

A new scheme is a module and its line here.
"""

from __future__ import annotations

SCHEMES: dict[str, str] = {
    "cascade": "jaxftc.schemes.cascade",
    "momentum": "jaxftc.schemes.momentum",
    "ekf": "jaxftc.schemes.ekf",
    "computed_torque": "jaxftc.schemes.computed_torque",
}

CASCADES: dict[str, dict[str, str]] = {  # the cascade with another observer or control: what changes in the config
    "pi": {"observer": "pi"},
    "eso": {"observer": "eso"},
    "eso_printed": {"observer": "eso_printed"},
    "smc": {"control": "smc"},
    "esmc": {"control": "esmc"},
}


def variants() -> dict[str, dict[str, str]]:
    """Every named variant, and what it changes in a config; read anew, so that an added scheme is among them."""
    return {name: {"scheme": name} for name in SCHEMES} | CASCADES
