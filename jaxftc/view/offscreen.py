"""Drawing without a window: which OpenGL there is, found out in a process of its own, and a canvas on it."""

from __future__ import annotations

import functools
import importlib
import os
import subprocess
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from jaxftc.view.scene import Scene

BACKENDS = {"linux": ("egl", "osmesa", "glfw"), "darwin": ("cgl", "glfw")}  # in the order they are tried; else glfw
OFF = ("disable", "disabled", "off", "false", "0")  # words with which MUJOCO_GL switches drawing off
INSTALL = "install libegl1, libopengl0 and libgl1-mesa-dri, or libosmesa6 (so called on Debian and Ubuntu)"
_PROBE = (
    "import mujoco, mujoco.{0} as gl; c = gl.GLContext(16, 16); c.make_current(); "
    "mujoco.MjrContext(mujoco.MjModel.from_xml_string('<mujoco/>'), mujoco.mjtFontScale.mjFONTSCALE_100.value)"
)


@functools.cache
def backend() -> str:
    """The first OpenGL that works here: egl, osmesa, glfw or cgl; the one that MUJOCO_GL names, if it names one of these.

    Each is tried in a process of its own: one that fails, by an exception or by a crash in the driver, leaves libraries
    behind that keep the next one from loading.

    Raises:
        ValueError: none works, or MUJOCO_GL switches drawing off.
    """
    asked = os.environ.get("MUJOCO_GL", "").strip().lower()
    if asked in OFF:
        raise ValueError(f"MUJOCO_GL={asked} switches drawing off; unset it")
    known = BACKENDS.get(sys.platform, ("glfw",))
    faults = []
    for name in (asked,) if asked in known else known:
        fault = _try(name)
        if fault is None:
            return name
        faults.append(f"{name}: {fault}")
    what_to_do = INSTALL if sys.platform == "linux" else "look at the driver of the graphics card"
    named = f", the one that MUJOCO_GL={asked} asks for" if asked in known else ""
    raise ValueError(f"no OpenGL to draw with{named} ({'; '.join(faults)}); {what_to_do}")


def _try(name: str) -> str | None:
    """What is wrong with a backend, None if it works."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE.format(name)], capture_output=True, text=True, timeout=60, check=False
        )
    except subprocess.TimeoutExpired:
        return "no answer"
    if done.returncode == 0:
        return None
    return (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1][:120]


class Canvas:
    """A picture of a fixed size that scenes are drawn on; a context manager, because it holds memory of the driver."""

    def __init__(self, scene: Scene, width: int, height: int, *, left: float = 0.0, ghost: bool = True) -> None:
        """A canvas of width by height pixels; the share ``left`` of its width is kept free of the arm."""
        import mujoco

        self._scene, self._ghost = scene, ghost
        scene.model.vis.global_.offwidth, scene.model.vis.global_.offheight = width, height
        self._gl = importlib.import_module(f"mujoco.{backend()}").GLContext(width, height)
        self._gl.make_current()
        self._context = mujoco.MjrContext(scene.model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._view = mujoco.MjrRect(0, 0, width, height)
        self._picture = mujoco.MjvScene(scene.model, maxgeom=2 * scene.model.ngeom + 100)
        self._option, self._camera = mujoco.MjvOption(), scene.camera(width / height, left)
        self._option.sitegroup[:] = 0

    def draw(self) -> np.ndarray:
        """The scene as it stands, [height, width, 3] uint8."""
        import mujoco
        import numpy as np

        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        scene = self._scene
        mujoco.mjv_updateScene(scene.model, scene.data, self._option, None, self._camera, everything, self._picture)
        if self._ghost:
            scene.add_ghost(self._picture, self._option, self._camera)
        mujoco.mjr_render(self._view, self._picture, self._context)
        pixels = np.empty((self._view.height, self._view.width, 3), np.uint8)
        mujoco.mjr_readPixels(pixels, None, self._view, self._context)
        return np.flipud(pixels)

    def __enter__(self) -> Canvas:
        return self

    def __exit__(self, *exception: object) -> None:
        self._context.free()
        self._gl.free()
