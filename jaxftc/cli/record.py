"""What ran: robot, config, preset, seed, gains, options, versions and the command, for every result and page."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxftc.cli import common, results
from jaxftc.io.files import digest

if TYPE_CHECKING:
    from jaxftc.config import Config


def of(options: common.ArmOptions, config: Config, *, more: tuple[str, ...] = ()) -> dict[str, Any]:
    """The record of a call; ``more`` are words for the command that it takes to get the same again."""
    from jaxftc.campaigns.spec import describe, versions
    from jaxftc.scenarios.preset_file import said

    found: dict[str, Any] = {
        "command": shlex.join(["jaxftc", *options.words, *more]),
        "robot": {"name": config.robot.name, "fingerprint": config.robot.fingerprint},
    }
    if isinstance(options, common.Options):
        preset = getattr(options, "preset", None)
        found |= {
            "config": {name: value for name, value in describe(config).items() if name != "robot_fingerprint"},
            "preset": None if preset is None else said(preset),
            "seed": options.seed,
        }
    else:  # of a config for logs nothing else counts
        found["sample_time_s"] = config.dt
    given = dict(results.given(options))
    if "gains" in given:
        found["gains"] = gains_file(given["gains"])
    return found | {"options": results.request(options), "versions": versions()}


def of_campaign(folder: Path) -> dict[str, Any]:
    """What a replay takes from a campaign's folder in place of its own options."""
    from jaxftc.campaigns import store
    from jaxftc.scenarios.preset_file import said

    asked = store.read_manifest(folder)["request"]
    preset = said(str(folder / store.PRESET)) | {"name": asked["preset"][0]}
    return {"campaign": asked, "seed": asked["seed"], "preset": preset, "gains": gains_file(folder / store.GAINS)}


def gains_file(path: Path | None) -> dict[str, str] | None:
    """A gains file and its content's SHA-256; None for the default gains."""
    return None if path is None else {"file": str(path), "sha256": digest(path)}
