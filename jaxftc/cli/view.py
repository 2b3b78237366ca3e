"""``jaxftc view``: a run in MuJoCo's viewer, or as a film or picture drawn without a screen."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any

import tyro

from jaxftc.cli import common


@dataclasses.dataclass
class View:
    """Replay a run in MuJoCo's viewer, or write it as mp4, gif or png without a screen (--video).

    Colours of a joint: vermilion, fault not yet detected; blue, fault detected; orange, alarm without a fault. The
    translucent arm is the reference. In the window, the space key pauses and resumes.
    """

    source: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """Folder that simulate wrote, or its trace.parquet."""
    video: common.MaybePath = None
    """Write this file, .mp4, .gif or .png, and open no window."""
    robot: str = "puma560"
    """The run's arm: the built-in one, an MJCF or URDF file, or an arm's own file or its folder."""
    tip: common.MaybeName = None
    """The run's --tip."""
    lock: common.Poses = ()
    """The run's --lock."""
    speed: float = 0.25
    """Speed of the replay; 1 is real time."""
    ghost: bool = True
    """Show the reference as a translucent arm."""
    fps: float = 30.0
    """Frames per second of an mp4 or gif."""
    at: common.MaybeNumber = None
    """Time of a png, s; 60 ms after the first alarm if not given, or the middle of a run without one."""
    width: int = 640
    """Width of the film or picture, pixels."""
    height: int = 480
    """Height of the film or picture, pixels."""
    json: bool = False
    """With --video, print one JSON object on stdout and nothing else there."""

    def run(self) -> None:
        """Open the window, or write the file."""
        self._refuse_idle()
        if self.video is None:
            from jaxftc.view import window

            window.show(self._scene(), self.speed, ghost=self.ghost)
            return
        result = self._film(self.video)
        if self.json:
            print(json.dumps(result, indent=2, allow_nan=False))
        else:
            print(f"Written: {self.video}")

    def _film(self, path: Path) -> dict[str, Any]:
        """Write the file; what is in it."""
        from jaxftc.view import film, offscreen

        film.check(path, self.width, self.height, self.fps)
        offscreen.backend()  # before MuJoCo is imported, which a wrong MUJOCO_GL makes impossible
        scene = self._scene()
        replay, still = scene.replay, path.suffix.lower() == ".png"
        if still:
            moment = replay.moment() if self.at is None else self.at
            if not replay.t[0] <= moment <= replay.t[-1]:
                raise ValueError(f"--at must lie in the run, {replay.t[0]:g} to {replay.t[-1]:g} s, got {moment:g}")
            which = replay.tick([moment])
        else:
            which = film.ticks(replay, path.suffix.lower(), self.speed, self.fps)
        frames = film.shoot(scene, which, self.width, self.height, ghost=self.ghost, progress=not still)
        film.write(path, frames, self.fps)
        shown = {"video": str(path), "frames": len(which), "width": self.width, "height": self.height}
        return shown | ({"at_s": float(replay.t[which[0]])} if still else {"seconds": len(which) / self.fps})

    def _scene(self) -> Any:
        """The run on stage."""
        from jaxftc.cli import common
        from jaxftc.view.replay import read
        from jaxftc.view.scene import Scene

        replay = read(self.source)
        if self.robot == "puma560":
            return Scene(common.built_in(self.tip, self.lock, coulomb=True), replay)
        return Scene(common.read_arm(self.robot, self.tip, self.lock, cautions=False), replay)

    def _refuse_idle(self) -> None:
        """Refuse options that would do nothing."""
        kind = self.video.suffix.lower() if self.video is not None else None
        idle = {
            None: ("fps", "at", "width", "height", "json"),
            ".png": ("speed", "fps"),
            ".mp4": ("at",),
            ".gif": ("at",),
        }.get(kind, ())
        what = "in the window; it is for --video" if kind is None else f"for a {kind}"
        for field in dataclasses.fields(self):
            if field.name in idle and getattr(self, field.name) != field.default:
                raise ValueError(f"--{field.name} does nothing {what}; leave it out")
