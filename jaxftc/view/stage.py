"""The model that is drawn: the robot's own file compiled once more with shapes, floor, light and background.

``Robot.mj_model`` stays without them: MJX would carry every shape through its kinematics. Shapes that the file has itself
are used, joints that are welded stand as it draws them; only links without one, or the whole arm if there is none, are
dressed by ``looks``.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from jaxftc.robot import mjcf
from jaxftc.robot.model import Robot
from jaxftc.robot.mujoco_model import mujoco_spec
from jaxftc.robot.puma560 import puma560
from jaxftc.view import looks
from jaxftc.view.looks import Colour, Part

FLOOR, LAMP = "jaxftc_floor", "jaxftc_lamp"  # names in the model
LIGHT = (0.3, 0.5, -1.0)  # where the light goes
FLOOR_HALF = 0.005  # m, half the thickness of the disc that is the floor
_PART = "jaxftc_part"
_SHOWN_GROUPS = 3  # geoms of the groups below this are what MuJoCo shows, by its own default
_PAPER: Colour = (0.965, 0.97, 0.975, 1.0)  # behind everything: light, in a page of either mode
_GROUND: Colour = (0.96, 0.97, 0.985, 1.0)


class Stage(NamedTuple):
    """What is drawn."""

    model: mujoco.MjModel
    tinted: tuple[np.ndarray, ...]  # by joint, the geoms that take its colour


def build(robot: Robot) -> Stage:
    """The model of a robot to look at: its own file's shapes, or where that does not compile, its joints and links alone."""
    spec, bare = _drawn(robot)
    bodies, parts = {body.name: body for body in spec.bodies}, _parts(robot, bare)
    base = int(bare.body_parentid[bare.jnt_bodyid[0]])
    for number, part in enumerate(parts):
        carrier = int(bare.jnt_bodyid[part.link]) if part.link >= 0 else base
        _add(spec, bodies[bare.body(carrier).name], part, f"{_PART}{number}")
    _furnish(spec, bare)
    model = spec.compile()
    return Stage(model, _tinted(model, parts))


def _drawn(robot: Robot) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """The robot's file with the arm's joints alone, compiled; the bare chain where the file lacks its meshes."""
    if robot.source is not None:
        try:
            spec = mujoco.MjSpec.from_file(str(robot.source.path))
            mjcf.name_all(spec)
            for kind in (*mjcf.IDLE, "actuators"):
                for element in [] if kind in ("cameras", "lights") else list(getattr(spec, kind)):
                    spec.delete(element)
            for joint in list(spec.joints):
                if joint.name not in robot.joint_names:
                    spec.delete(joint)
            return spec, _compiled(spec, robot)
        except ValueError:
            pass
    spec = mujoco_spec(robot)
    return spec, _compiled(spec, robot)


def _compiled(spec: mujoco.MjSpec, robot: Robot) -> mujoco.MjModel:
    spec.compiler.discardvisual = spec.compiler.fusestatic = False  # true for a URDF, and would drop what is added here
    model = spec.compile()
    if model.njnt != robot.n:
        raise ValueError("another arm")
    return model


def _parts(robot: Robot, bare: mujoco.MjModel) -> tuple[Part, ...]:
    """What the model lacks to be looked at."""
    drawn = (bare.geom_group < _SHOWN_GROUPS) & (bare.geom_rgba[:, 3] > 0)
    dressed = set(_links(bare)[bare.geom_bodyid[drawn]].tolist())
    if dressed - {-1}:
        return looks.capsules(bare, set(range(bare.njnt)) - dressed)
    if robot in (puma560(), puma560(coulomb=False)):
        return looks.PUMA560
    return looks.capsules(bare, set(range(-1, bare.njnt)))


def _tinted(model: mujoco.MjModel, parts: tuple[Part, ...]) -> tuple[np.ndarray, ...]:
    """Of the parts those that say a joint, of the arm's own shapes the whole link."""
    tinted: list[list[int]] = [[] for _ in range(model.njnt)]
    link = _links(model)
    for geom in range(model.ngeom):
        name = model.geom(geom).name
        joint = parts[int(name.removeprefix(_PART))].joint if name.startswith(_PART) else int(link[model.geom_bodyid[geom]])
        if joint is not None and joint >= 0 and model.geom_group[geom] < _SHOWN_GROUPS:
            tinted[joint].append(geom)
    return tuple(np.array(geoms, int) for geoms in tinted)


def _links(model: mujoco.MjModel) -> np.ndarray:
    """Last hinge that moves each body [bodies], -1 for the base."""
    link = np.full(model.nbody, -1)
    for body in range(1, model.nbody):
        count = int(model.body_jntnum[body])
        link[body] = model.body_jntadr[body] + count - 1 if count else link[model.body_parentid[body]]
    return link


def _add(spec: mujoco.MjSpec, body: mujoco.MjsBody, part: Part, name: str) -> None:
    """One part as a geom that touches nothing and weighs nothing."""
    look = {"name": name, "rgba": part.colour, "contype": 0, "conaffinity": 0, "mass": 0.0, "group": 0}
    kind, (start, end) = (
        getattr(mujoco.mjtGeom, f"mjGEOM_{part.kind.upper()}", mujoco.mjtGeom.mjGEOM_MESH),
        np.array(part.ends),
    )
    if part.kind == "plate":
        spec.add_mesh(name=name, uservert=looks.plate(part.ends, part.size).ravel())
        body.add_geom(type=kind, meshname=name, **look)
    elif part.kind == "box":
        body.add_geom(type=kind, pos=(start + end) / 2, size=(end - start) / 2, **look)
    elif part.kind == "sphere":
        body.add_geom(type=kind, pos=start, size=(part.size[0], 0, 0), **look)
    else:
        body.add_geom(type=kind, fromto=(*start, *end), size=(part.size[0], 0, 0), **look)


def _furnish(spec: mujoco.MjSpec, bare: mujoco.MjModel) -> None:
    """Background, floor and light, each only where the model has none of its own."""
    if not np.any(bare.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX):
        flat = {
            "builtin": mujoco.mjtBuiltin.mjBUILTIN_FLAT,
            "rgb1": _PAPER[:3],
            "rgb2": _PAPER[:3],
            "width": 16,
            "height": 16,
        }
        spec.add_texture(name="jaxftc_paper", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, **flat)
    if not np.any(bare.geom_type == mujoco.mjtGeom.mjGEOM_PLANE):
        disc = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": (1, FLOOR_HALF, 0), "rgba": _GROUND, "mass": 0.0}
        spec.worldbody.add_geom(name=FLOOR, contype=0, conaffinity=0, **disc)
    if not bare.nlight:
        look = {"diffuse": (0.35,) * 3, "specular": (0.15,) * 3, "ambient": (0.0,) * 3, "cutoff": 30.0, "exponent": 0.0}
        spec.worldbody.add_light(name=LAMP, dir=LIGHT, castshadow=True, **look)
        head = spec.visual.headlight
        head.ambient, head.diffuse, head.specular = (0.55,) * 3, (0.3,) * 3, (0.1,) * 3
    quality = spec.visual.quality
    quality.shadowsize, quality.numslices, quality.numstacks = 1024, 48, 8
