"""The replay in MuJoCo's own viewer: in slow motion, over and over, from any side."""

from __future__ import annotations

import os
import sys
import time
import warnings
from typing import Any

from jaxftc.types import Verdict
from jaxftc.view.replay import check_speed
from jaxftc.view.scene import Scene

INSTEAD = "give --video FILE.mp4 (or .gif, .png), which needs no screen"
PAUSE = 0.8  # s at the end before it starts again
SPACE = 32  # key that stops and goes on


def show(scene: Scene, speed: float, *, ghost: bool = True) -> None:
    """Replay until the window is closed; ``speed`` seconds of the run pass in one second. The space key stops it.

    Raises:
        ValueError: there is no screen, or the speed is not a positive number.
    """
    check_speed(speed)
    _check_screen()
    from mujoco import viewer

    clock = Clock(scene, speed)
    try:
        handle = viewer.launch_passive(
            scene.model, scene.data, key_callback=clock.key, show_left_ui=False, show_right_ui=False
        )
    except RuntimeError as error:  # on macOS windows belong to the main thread, which mjpython keeps for them
        raise ValueError(f"the viewer does not start: {error}; {INSTEAD}") from error
    with handle:
        with handle.lock():
            camera, handle.opt.sitegroup[:] = scene.camera(4 / 3), 0
            handle.cam.lookat[:] = camera.lookat
            handle.cam.distance, handle.cam.azimuth, handle.cam.elevation = camera.distance, camera.azimuth, camera.elevation
        while handle.is_running():
            tick = clock.tick(time.perf_counter())
            with handle.lock():
                scene.show(tick)
                if ghost:
                    handle.user_scn.ngeom = 0
                    scene.add_ghost(handle.user_scn, handle.opt, handle.cam)
            if hasattr(handle, "set_texts"):  # newer than the oldest MuJoCo that will do
                handle.set_texts((None, None, *caption(scene, tick)))
            handle.sync()
            time.sleep(1 / 60)


class Clock:
    """Which tick to show at which time of the wall clock; the space key stops it and lets it go on."""

    def __init__(self, scene: Scene, speed: float) -> None:
        """A clock at the start of the scene's run."""
        self._replay, self._speed = scene.replay, speed
        self._length = float(self._replay.t[-1] - self._replay.t[0])
        self._passed, self._before, self._stopped = 0.0, None, False

    def key(self, code: int) -> None:
        """What a key does."""
        if code == SPACE:
            self._stopped = not self._stopped

    def tick(self, now: float) -> int:
        """The tick to show at ``now`` s of the wall clock; after the end it waits ``PAUSE`` s and starts again."""
        if self._before is not None and not self._stopped:
            self._passed += (now - self._before) * self._speed
        self._before = now
        if self._passed > self._length + PAUSE * self._speed:
            self._passed = 0.0
        return int(self._replay.tick(self._replay.t[0] + min(self._passed, self._length)))


def caption(scene: Scene, tick: int) -> tuple[str, str]:
    """Two columns of text: time, and joint by joint what is wrong with it and what was said of it."""
    replay = scene.replay
    truth, verdict = replay.truth[tick], replay.verdict[tick]
    left, right = ["time", "tool off reference"], [f"{replay.t[tick]:.3f} s", f"{1e3 * scene.tool_off():.1f} mm"]
    for joint, fault, said in zip(replay.joints, truth, verdict, strict=True):
        if fault or said:
            left.append(joint)
            fault, said = (Verdict(k).label if k else "none" for k in (fault, said))
            right.append(f"fault {fault}, verdict {said}")
    return "\n".join(left), "\n".join(right)


def _check_screen() -> None:
    """Refuse to start where no window can open: MuJoCo's viewer would wait for it for ever."""
    linux = sys.platform.startswith("linux")
    if linux and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ValueError(f"there is no screen to open a window on (neither DISPLAY nor WAYLAND_DISPLAY is set); {INSTEAD}")
    if not linux:
        return
    glfw: Any = __import__("glfw")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if not glfw.init():
            raise ValueError(f"no window can be opened on the screen DISPLAY={os.environ.get('DISPLAY', '')}; {INSTEAD}")
        glfw.terminate()
