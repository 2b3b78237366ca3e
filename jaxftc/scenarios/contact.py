"""A force on a link, ``Contact``: its place, direction, size and law in time; how a preset draws it, and how it is built."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple, TypeVar, Unpack

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from pydantic import Strict

from jaxftc import checks
from jaxftc.scenarios.builders import Law as TimeLaw
from jaxftc.scenarios.builders import require_range, times_of
from jaxftc.scenarios.distributions import Law, Table, require
from jaxftc.scenarios.preset_error import PresetError, is_integer
from jaxftc.scenarios.uniforms import UniformStream
from jaxftc.types import Array

Vector = ArrayLike | Sequence[float]
S = TypeVar("S")  # Scenario, which has the builder as a method


class Contact(NamedTuple):
    """One force on one link, and its law in time.

    Attributes:
        link: [...] int32, which link, from 1; 0 for none.
        along: [...] 1, where between the link's joint, 0, and the next joint or the tool, 1.
        offset: [3, ...] m, from there, in the frame at the link's joint, whose z axis is the joint.
        axis: [3, ...] 1, direction of the force in the base frame, of length 1.
        size: [...] N; 0 is no contact.
        onset: [...] s.
        clear: [...] s, infinite if it stays.
        rise: [...] s, ramp from 0 to full size; 0 is abrupt.
        period: [...] s, of an intermittent contact; infinite if it is not.
        duty: [...] 1, share of the period in which it is there.
    """

    link: Array
    along: Array
    offset: Array
    axis: Array
    size: Array
    onset: Array
    clear: Array
    rise: Array
    period: Array
    duty: Array


def no_contact(axes: tuple[int, ...] = ()) -> Contact:
    """Contacts of size 0, scenarios on leading ``axes``: for a run that stands beside runs with one."""
    zero, never = jnp.zeros(()), jnp.full((), jnp.inf)
    up = jnp.asarray([0.0, 0.0, 1.0])
    none = Contact(jnp.zeros((), jnp.int32), zero, jnp.zeros(3), up, zero, zero, never, zero, never, jnp.ones(()))
    return Contact(*(jnp.broadcast_to(leaf, (*axes, *leaf.shape)) for leaf in none))


@dataclasses.dataclass(frozen=True, kw_only=True)
class ContactLaw(Table):
    """The law of contacts in a preset: every link as likely, every direction as likely."""

    size: Law  # N
    along: Law = 1.0  # 1, from the link's joint to the next one, or the tool
    radius_m: Law = 0.0  # m, from that line or, of a link without length, from its joint, in a direction that is drawn, too
    links: tuple[Annotated[int, Strict()], ...] | None = None  # counted from 1; all if None

    def __post_init__(self) -> None:
        require("size", self.size, 0.0)
        require("along", self.along, 0.0, 1.0)
        require("radius_m", self.radius_m, 0.0)
        if self.links is None:
            return
        whole = isinstance(self.links, tuple) and all(is_integer(link) and link >= 1 for link in self.links)
        if not whole or not self.links or len(set(self.links)) < len(self.links):
            raise PresetError("links", f"must be different links, counted from 1, got {self.links!r}")


def draw(law: ContactLaw, stream: UniformStream, links: Sequence[int], there: Array, times: dict[str, Array]) -> Contact:
    """A contact on one of some links, from 1; of size 0 where it is not ``there``."""
    link = jnp.asarray(links, jnp.int32)[(len(links) * stream.number()).astype(jnp.int32)]
    axis, side = _direction(stream.number((2,))), _direction(stream.number((2,)))
    along, radius, size = stream(law.along), stream(law.radius_m), stream(law.size)
    return Contact(
        link=jnp.where(there, link, 0),
        along=along,
        offset=radius * side,
        axis=axis,
        size=jnp.where(there, size, 0.0),
        **times,
    )


def _direction(u: Array) -> Array:
    """A direction [3], every one as likely, of two uniform numbers."""
    z, turn = 2 * u[0] - 1, 2 * jnp.pi * u[1]
    r = jnp.sqrt(jnp.maximum(1 - z * z, 0.0))
    return jnp.stack([r * jnp.cos(turn), r * jnp.sin(turn), z])


def with_contact(
    scenario: S,
    link: int,
    force: ArrayLike,
    onset: ArrayLike,
    *,
    axis: Vector = (0.0, 0.0, 1.0),
    along: ArrayLike = 1.0,
    offset: Vector = (0.0, 0.0, 0.0),
    **law: Unpack[TimeLaw],
) -> S:
    """Something pushes against a link; it takes the place of a contact that was there.

    Args:
        scenario: One scenario, or a set with a leading axis.
        link: Which one, from 1; it is moved by the joint of that number.
        force: N, a number or one a scenario; 0 is none.
        onset: When it comes, s.
        axis: [3] direction of the force in the base frame, of any length but zero; or one a scenario, [..., 3].
        along: 1, where between the link's joint, 0, and the next joint or the tool, 1.
        offset: [3] m from there, in the frame at the link's joint, whose z axis is the joint.
        **law: ``clear`` s, ``rise`` s, ``period`` s and ``duty``, as in ``Law``.

    Returns:
        The scenario with this contact.

    Raises:
        ValueError: no such link, a number that is not finite or not allowed, or scenarios on trailing axes.
    """
    given: Any = scenario
    axes, joints = np.shape(given.id), np.shape(given.fault_tau.onset)[-1]
    before = given.contact or no_contact(axes)
    if np.shape(before.size) != axes:
        raise ValueError(
            "a contact is given to one scenario or to a set with a leading axis, got contact.size of shape "
            f"{list(np.shape(before.size))} and id of shape {list(axes)}"
        )
    checks.integer("link", link, 1, f"links count from 1 to {joints}")
    if link > joints:
        raise ValueError(f"link must be 1 to {joints}, got {link}")
    for name, value, about in (("force", force, "N"), ("axis", axis, "a direction"), ("offset", offset, "m")):
        checks.finite(name, value, f"it is in {about}" if about != "a direction" else "it is a direction")
    require_range("force", force, 0.0, math.inf)
    require_range("along", along, 0.0, 1.0)
    values = {"link": jnp.int32(link), "along": along, "offset": offset, "axis": _unit(axis), "size": force}
    values |= times_of(onset, law)
    contact = Contact(*(_filled(name, values[name], leaf, axes) for name, leaf in before._asdict().items()))
    return given._replace(contact=contact)


def _unit(axis: Vector) -> Array:
    """Of length 1."""
    length = jnp.linalg.norm(jnp.asarray(axis, float), axis=-1, keepdims=True)
    if not isinstance(length, Tracer) and not (np.asarray(length) > 0).all():
        raise ValueError(f"axis must not be zero, got {np.asarray(axis).tolist()}; it is the direction of the force")
    return jnp.asarray(axis, float) / length


def _filled(name: str, value: ArrayLike, leaf: ArrayLike, axes: tuple[int, ...]) -> Array:
    """A value, one for all scenarios or one a scenario, in shape and precision of a leaf."""
    own = np.shape(leaf)[len(axes) :]
    if np.shape(value) not in (own, axes + own):
        raise ValueError(f"{name} must have shape {list(own)} or {list(axes + own)}, got {list(np.shape(value))}")
    return jnp.broadcast_to(jnp.asarray(value, jnp.asarray(leaf).dtype), np.shape(leaf))
