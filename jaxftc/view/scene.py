"""The arm and its ghost at one tick: posed, coloured, and with a camera that has them in view."""

from __future__ import annotations

import mujoco
import numpy as np

from jaxftc.robot.model import Robot
from jaxftc.view import stage
from jaxftc.view.looks import Colour
from jaxftc.view.replay import ALARM, DETECTED, FAULT, Replay

COLOURS: dict[int, Colour] = {  # of a joint by its state, told apart by colour-blind readers: vermilion, blue, orange
    FAULT: (0xD5 / 255, 0x5E / 255, 0.0, 1.0),
    DETECTED: (0.0, 0x72 / 255, 0xB2 / 255, 1.0),
    ALARM: (0xE6 / 255, 0x9F / 255, 0.0, 1.0),
}
GHOST: Colour = (0.35, 0.37, 0.42, 0.5)
GHOST_FROM, GHOST_FULL = 1e-3, 4e-3  # in sizes of the scene: how far off the reference a ghost starts to show, and is full
GHOST_BEHIND = 2.5e-3  # in sizes of the scene, how much farther away the ghost is drawn than it is
AZIMUTH, ELEVATION = 135.0, -14.0  # deg


class Scene:
    """One replay on stage: ``data`` is the arm, ``ghost`` the same ``model`` at the reference."""

    def __init__(self, robot: Robot, replay: Replay) -> None:
        """Build it, at the first tick.

        Raises:
            ValueError: the joints of the replay are not the robot's.
        """
        if replay.joints != robot.joint_names:
            raise ValueError(
                f"the trace is of joints {', '.join(replay.joints)}, robot {robot.name} has {', '.join(robot.joint_names)}; "
                "give the robot it was made with as --robot FILE"
            )
        self.replay = replay
        self.model, self._tinted = stage.build(robot)
        self.data, self.ghost = mujoco.MjData(self.model), mujoco.MjData(self.model)
        self._plain = self.model.geom_rgba.copy(), self.model.geom_matid.copy()
        self._states = replay.states
        self._corners = self._swept()
        self._furnish()
        self.show(0)

    def show(self, tick: int) -> None:
        """Pose arm and ghost, and colour the joints, as of one tick."""
        for data, angles in ((self.data, self.replay.q), (self.ghost, self.replay.q_ref)):
            data.qpos[:] = angles[tick]
            mujoco.mj_kinematics(self.model, data)
            mujoco.mj_camlight(self.model, data)
        self.model.geom_rgba[:], self.model.geom_matid[:] = self._plain
        for geoms, state in zip(self._tinted, self._states[tick].tolist(), strict=True):
            if state in COLOURS:
                self.model.geom_rgba[geoms], self.model.geom_matid[geoms] = COLOURS[state], -1

    def tool_off(self) -> float:
        """Distance in m of the tool from where the reference has it; without a site named tool, of the last body."""
        tool = self._id(mujoco.mjtObj.mjOBJ_SITE, "tool")
        arm, ghost = ((d.site_xpos[tool] if tool >= 0 else d.xpos[-1]) for d in (self.data, self.ghost))
        return float(np.linalg.norm(arm - ghost))

    def add_ghost(self, picture: mujoco.MjvScene, option: mujoco.MjvOption, camera: mujoco.MjvCamera) -> None:
        """Add the ghost to a picture: translucent, and fading out where the arm is where it should be.

        Two surfaces in one place flicker, so there is no ghost of a link in its place, and the others are a little behind.
        """
        size = self.model.stat.extent
        off = np.linalg.norm(self.data.geom_xpos - self.ghost.geom_xpos, axis=1) / size  # of every shape's middle
        strength = np.clip((off - GHOST_FROM) / (GHOST_FULL - GHOST_FROM), 0, 1)
        if not strength.any():
            return
        first, moving = picture.ngeom, mujoco.mjtCatBit.mjCAT_DYNAMIC.value
        mujoco.mjv_addGeoms(self.model, self.ghost, option, mujoco.MjvPerturb(), moving, picture)
        behind = GHOST_BEHIND * size * _axes(camera.azimuth, camera.elevation)[:, 2]
        for geom in picture.geoms[first : picture.ngeom]:
            here = strength[geom.objid] if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM else 0.0
            geom.rgba[:] = (*GHOST[:3], GHOST[3] * here)
            geom.pos[:] += behind
            geom.matid = -1

    def camera(self, aspect: float, left: float = 0.0) -> mujoco.MjvCamera:
        """A camera that has the arm in view for the whole run, right of the share ``left`` of the picture's width.

        ``aspect`` is width over height.
        """
        axes = _axes(AZIMUTH, ELEVATION)
        seen = self._corners @ axes
        low, high = seen.min(0), seen.max(0)
        middle, half = (low + high) / 2, 1.04 * (high - low) / 2
        slope = np.tan(np.deg2rad(self.model.vis.global_.fovy) / 2)
        distance = half[2] / 2 + max(half[1], half[0] / (aspect * (1 - left))) / slope
        middle[0] -= left * aspect * slope * distance
        camera = mujoco.MjvCamera()
        camera.lookat[:] = axes @ middle
        camera.distance, camera.azimuth, camera.elevation = distance, AZIMUTH, ELEVATION
        return camera

    def _swept(self) -> np.ndarray:
        """Corners [k, 3] in m of boxes around the arm's shapes at up to fifty ticks of the run."""
        model, data = self.model, self.data
        shown = (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_rgba[:, 3] > 0)
        solid = np.setdiff1d(np.flatnonzero(shown), self._id(mujoco.mjtObj.mjOBJ_GEOM, stage.FLOOR))
        signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, 1, 8)
        middle, half = model.geom_aabb[solid, :3], model.geom_aabb[solid, 3:]
        local = middle.T[:, :, None] + signs * half.T[:, :, None]  # [3, geoms, 8]
        corners = []
        for tick in np.unique(np.linspace(0, len(self.replay.t) - 1, 50).astype(int)):
            data.qpos[:] = self.replay.q[tick]
            mujoco.mj_kinematics(model, data)
            turned = np.einsum("gij,jgc->gci", data.geom_xmat[solid].reshape(-1, 3, 3), local)
            corners.append((data.geom_xpos[solid, None] + turned).reshape(-1, 3))
        return np.concatenate(corners)

    def _furnish(self) -> None:
        """Put floor and light where the arm is, and give MuJoCo the size of the scene, which clipping and shadows need."""
        model, low, high = self.model, self._corners.min(0), self._corners.max(0)
        model.stat.center[:], model.stat.extent = (low + high) / 2, float(np.linalg.norm(high - low))
        floor, lamp = self._id(mujoco.mjtObj.mjOBJ_GEOM, stage.FLOOR), self._id(mujoco.mjtObj.mjOBJ_LIGHT, stage.LAMP)
        if floor >= 0:
            model.geom_pos[floor] = (*model.stat.center[:2], min(0.0, low[2]) - stage.FLOOR_HALF)
            model.geom_size[floor, 0] = 0.5 * np.linalg.norm((high - low)[:2])
        if lamp >= 0:
            model.light_pos[lamp] = model.stat.center - 1.5 * model.stat.extent * np.array(stage.LIGHT)

    def _id(self, kind: mujoco.mjtObj, name: str) -> int:
        return mujoco.mj_name2id(self.model, kind, name)


def _axes(azimuth: float, elevation: float) -> np.ndarray:
    """Right, up and ahead of a camera at these angles in deg, as columns [3, 3]."""
    a, e = np.deg2rad((azimuth, elevation))
    ahead, right = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]), np.array([np.sin(a), -np.cos(a), 0])
    return np.column_stack([right, np.cross(right, ahead), ahead])
