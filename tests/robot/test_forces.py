"""A force on a link: J^T F against MuJoCo and against the work it does, and what no joint bears."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from jaxftc import puma560
from jaxftc.robot import forces
from tests.arms import three_hinges

ARMS = {"three hinges": three_hinges, "puma560": puma560}


def place(link, along=0.0, offset=(0.0, 0.0, 0.0)):
    return forces.Place(jnp.int32(link), jnp.asarray(along), jnp.asarray(offset))


def point(robot, data, link, along, offset):
    """The point [3] m, by MuJoCo's kinematics."""
    body = data.body(robot.link_names[link - 1])
    end = data.site("tool").xpos if link == robot.n else data.body(robot.link_names[link]).xpos
    return body.xpos + along * (end - body.xpos) + body.xmat.reshape(3, 3) @ offset


@pytest.mark.parametrize("name", ARMS)
def test_torques_are_those_of_mujoco(name):
    robot, random = ARMS[name](), np.random.default_rng(1)
    model = robot.plant_model()
    data = mujoco.MjData(model)
    for link in (*range(1, robot.n + 1), robot.n):
        data.qpos[:] = random.normal(size=robot.n)
        mujoco.mj_forward(model, data)
        force, along, offset = random.normal(size=3), random.uniform(), 0.1 * random.normal(size=3)
        wanted, body = np.zeros(robot.n), model.body(robot.link_names[link - 1]).id
        mujoco.mj_applyFT(model, data, force, np.zeros(3), point(robot, data, link, along, offset), body, wanted)
        found = forces.joint_torques(robot, jnp.asarray(data.qpos), place(link, along, offset), jnp.asarray(force))
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12)
        assert (np.asarray(found)[link:] == 0).all() and found[link - 1] != 0


def test_the_torques_do_the_work_of_the_force():
    """F . dp = tau . dq, by differences of where the point is."""
    robot, random = three_hinges(), np.random.default_rng(2)
    model = robot.plant_model()
    data, step = mujoco.MjData(model), 1e-6
    q, force, offset = random.normal(size=3), random.normal(size=3), np.array([0.03, -0.02, 0.05])

    def at(q):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        return point(robot, data, 3, 0.7, offset)

    work = [force @ (at(q + step * unit) - at(q - step * unit)) / (2 * step) for unit in np.eye(3)]
    found = forces.joint_torques(robot, jnp.asarray(q), place(3, 0.7, offset), jnp.asarray(force))
    np.testing.assert_allclose(found, work, rtol=0, atol=1e-8)


def test_links_that_there_are_not_bear_nothing():
    force, q = jnp.ones(3), jnp.ones(3)
    for link in (0, 4):
        assert (forces.joint_torques(three_hinges(), q, place(link, 1.0), force) == 0).all()


def test_configurations_side_by_side_are_those_one_by_one():
    robot, random = three_hinges(), np.random.default_rng(3)
    q, force, offset = random.normal(size=(3, 5)), random.normal(size=(3, 5)), random.normal(size=(3, 5))
    links, along = jnp.asarray([1, 2, 3, 2, 0], jnp.int32), random.uniform(size=5)
    whole = forces.joint_torques(robot, jnp.asarray(q), forces.Place(links, jnp.asarray(along), jnp.asarray(offset)), force)
    for k in range(5):
        own = forces.joint_torques(robot, jnp.asarray(q[:, k]), place(links[k], along[k], offset[:, k]), force[:, k])
        np.testing.assert_allclose(whole[:, k], own, rtol=0, atol=1e-13)


def test_a_length_is_the_way_from_a_joint_to_its_end():
    robot = puma560()
    links = forces.frames(robot, jax.tree.map(jnp.asarray, forces.rigid_body.pose(robot, jnp.ones(6))))
    ways = [np.linalg.norm(np.subtract(link.end, link.origin)) for link in links]
    np.testing.assert_allclose(forces.lengths(robot), ways, atol=1e-12)
