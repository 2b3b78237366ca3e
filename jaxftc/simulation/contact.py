"""What a contact of a scenario does to the joints of the arm."""

from __future__ import annotations

import jax.numpy as jnp
from jax import lax

from jaxftc.numerics.batch import trailing
from jaxftc.robot import forces
from jaxftc.robot.model import Robot
from jaxftc.scenarios.contact import Contact
from jaxftc.simulation.fault_profiles import size
from jaxftc.types import Array


def torque(robot: Robot, contact: Contact | None, t: Array, q: Array) -> Array:
    """J^T F [n, ...] N m at t s of an arm at q [n, ...] rad; exactly 0 where there is no contact, or it is None.

    The kinematics are run only where one scenario of the batch is touched.
    """
    if contact is None:
        return jnp.zeros_like(q)
    axes = q.ndim - 1
    contact = Contact(*(trailing(x, name in ("offset", "axis"), axes) for name, x in contact._asdict().items()))
    force = jnp.broadcast_to(size(contact, t) * contact.size, q.shape[1:])

    def touched(q: Array, force: Array) -> Array:
        place = forces.Place(contact.link, contact.along, contact.offset)
        return jnp.where(force > 0, forces.joint_torques(robot, q, place, force * contact.axis), 0.0)

    return lax.cond(jnp.any(contact.size > 0), touched, lambda q, force: jnp.zeros_like(q), q, force)
