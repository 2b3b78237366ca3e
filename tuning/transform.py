"""Tuning works on one unconstrained vector theta; this is what it means in gains.

Every free gain has a transform of its own, chosen by its limits (``jaxftc.gains``), under which any theta gives allowed
gains. theta is 0 at the start, and one unit is a natural step:

* a gain without an upper limit moves by factors: g = start exp(theta). A start of 0 is moved to ``SMALLEST``;
* a gain in an interval moves by odds: logit of its place in it. A start at an end is moved inside by ``INSET``;
* set centres, which must increase, move by the log of their gaps, the first one by gaps;
* what torque thresholds follow of the motion moves only if it is named: ``jaxftc calibrate`` fits it;
* both Laguerre poles move as one, ``arx.xi_a``, by odds within (-1, 1); the read-out is then that of the exact model, also
  where it was identified before.

The search is bounded, for every method alike, by |theta| <= ``REACH``: a factor of 20 in gain, odds or gap.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc import checks, stages
from jaxftc.compile.jit import jit
from jaxftc.config import Config
from jaxftc.diagnosis import threshold
from jaxftc.gain_spec import INCREASING
from jaxftc.gains import Gains, Spec, blocks, names, shape_of, specs
from jaxftc.gains import check as check_gains
from jaxftc.observer import arx
from jaxftc.observer.readout import exact
from jaxftc.schemes.registry import scheme
from jaxftc.stages import Stages
from jaxftc.types import Array

REACH = math.log(20.0)
INSET = 0.01  # of the interval
SMALLEST = {"control.k_b": 1.0, "diagnosis.lead": 1000.0}  # 1/s, 1/s^2; for the others a thousandth of their default
SMALLEST |= {"control.rate": 10.0}  # 1/s
SMALLEST |= {"diagnosis.follow_speed": 1e-2, "diagnosis.follow_acceleration": 1e-3}  # s/rad, s^2/rad
SMALLEST |= {"diagnosis.follow_reversal": 1e-2}  # 1
SMALLEST |= {"diagnosis.follow_torque": 1e-3, "diagnosis.follow_payload": 1e-3}  # 1/(N m)
POLES = "arx.xi_a"
IF_NAMED = {POLES, *threshold.GAINS}


def idle(config: Config) -> set[str]:
    """Gains that a config does not use, so that changing them does nothing."""
    return set(names(config)) - scheme(config).gains_used(config)


def tunable(config: Config) -> tuple[str, ...]:
    """Names of all gains that can be tuned with a config, in order."""
    every = [f"{block}.{name}" for block, name, _ in specs(config) if block != "arx" or f"{block}.{name}" == POLES]
    poles_follow = config.input == "rigid_body"
    return tuple(name for name in every if name not in idle(config) and (name != POLES or poles_follow))


def select(config: Config, only: Iterable[str] = (), freeze: Iterable[str] = ()) -> tuple[str, ...]:
    """Names of the free gains: those of ``only`` (all but ``IF_NAMED`` if empty) less those of ``freeze``.

    A block's name stands for all its gains.

    Raises:
        ValueError: an unknown name, a gain that this config does not use, or nothing left to tune.
    """
    allowed = tunable(config)
    chosen = _expand(config, only) or {name for name in allowed if name not in IF_NAMED}
    left = (chosen & set(allowed)) - _expand(config, freeze)
    if not left:
        raise ValueError("every gain is frozen, so there is nothing to tune; free at least one")
    return tuple(name for name in allowed if name in left)


def _expand(config: Config, words: Iterable[str]) -> set[str]:
    allowed, unused = tunable(config), idle(config)
    found: set[str] = set()
    for name in words:
        if name in unused:
            used = f"observer {config.observer!r} and control {config.control!r}"
            raise ValueError(
                f"gain {name!r} does nothing with {used if stages.staged(config) else f'scheme {config.scheme!r}'}"
            )
        members = {gain for gain in allowed if gain.split(".")[0] == name}
        if not members:
            checks.one_of("gain", name, (*allowed, *blocks(config)))
        found |= members or {name}
    return found


class Leaf(NamedTuple):
    """One gain's place in a vector."""

    block: str
    name: str
    part: slice
    shape: tuple[int, ...]
    spec: Spec

    @property
    def path(self) -> str:
        """Block and name."""
        return f"{self.block}.{self.name}"


class Layout(NamedTuple):
    """All gains that can be tuned with a config, as one vector; the poles only where they are to move."""

    config: Config
    leaves: tuple[Leaf, ...]
    size: int


class Free(NamedTuple):
    """Which entries of a layout are free, and where they start: data, so that one program serves every choice of gains."""

    start: Gains
    coordinates: Array  # [layout.size] free coordinates of the start, see ``_to_free``
    spread: Array  # [layout.size, layout.size] 1 where an entry of theta (row) moves one of the layout (column), else 0
    gaps: Array  # [leaves] mean gap of set centres at the start, 1 for other gains
    stages: Stages | None  # which observer and controller run


def gains_at(layout: Layout, free: Free, theta: Array, widen: Array | float = 1.0) -> Gains:
    """Gains at theta [layout.size], or at [.., scenarios] a set a scenario; differentiable."""
    return gains_of(layout, free, spread(free, theta), widen)


def spread(free: Free, theta: Array) -> Array:
    """What theta [layout.size, ...] moves each entry of the layout by."""
    return jnp.tensordot(free.spread, theta, axes=(0, 0), precision=jax.lax.Precision.HIGHEST)


def gather(free: Free, slopes: Array) -> Array:
    """Slopes by the entries of the layout [layout.size, ...] as slopes by theta: the transpose of ``spread``."""
    return jnp.tensordot(free.spread, slopes, axes=(1, 0), precision=jax.lax.Precision.HIGHEST)


def gains_of(layout: Layout, free: Free, moves: Array, widen: Array | float = 1.0) -> Gains:
    """Gains whose free coordinates are moved by [layout.size], or by [.., scenarios], a set a scenario; differentiable.

    ``widen`` is a factor on the widths of both smooth signs, by which tuning can begin with a smoother loop.
    """
    move = functools.partial(_moved, layout, free)
    moved = move(moves) if moves.ndim == 1 else jax.vmap(move, in_axes=1, out_axes=-1)(moves)
    changed = {block: dataclasses.replace(getattr(free.start, block), **values) for block, values in moved.items()}
    return widened(dataclasses.replace(free.start, **changed), widen)


def _moved(layout: Layout, free: Free, moves: Array) -> dict[str, dict[str, Array]]:
    """The gains of a layout by block and name; what is not free stays as it started, to the last bit."""
    can_move, coordinates = free.spread.sum(0) > 0, free.coordinates + moves
    moved: dict[str, dict[str, Array]] = {}
    for leaf, gap in zip(layout.leaves, free.gaps, strict=True):
        value = _from_free(leaf, coordinates[leaf.part].reshape(leaf.shape), gap).astype(moves.dtype)
        own = getattr(getattr(free.start, leaf.block), leaf.name)
        if leaf.path == POLES:  # free if they are there; the read-out follows
            kappa_a, kappa_b = arx.exact_kappa(value, layout.config.order_a, layout.config.order_b, layout.config.dt)
            follow = {"xi_b": value, "kappa_a": kappa_a, "kappa_b": kappa_b[:, None], "offset": 0.0 * value}
            moved.setdefault("arx", {}).update(follow)
        else:
            value = jnp.where(can_move[leaf.part].reshape(leaf.shape), value, own)
        moved.setdefault(leaf.block, {})[leaf.name] = value
    return moved


@dataclasses.dataclass(frozen=True, eq=False)
class Space:
    """The free gains as one vector theta [size]; theta = 0 is the start."""

    config: Config
    start: Gains
    leaves: tuple[Leaf, ...]  # the free ones, by their parts of theta; one number for a shared gain
    size: int
    layout: Layout
    free: Free

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free gains."""
        return tuple(leaf.path for leaf in self.leaves)

    def padded(self, theta: Array) -> Array:
        """Theta [size, ...] with zeros behind, [layout.size, ...]."""
        return jnp.pad(theta, [(0, self.layout.size - self.size), *[(0, 0)] * (theta.ndim - 1)])

    def gains(self, theta: Array, widen: Array | float = 1.0) -> Gains:
        """Gains at theta [size], or at [size, scenarios] one set a scenario on a trailing axis; differentiable."""
        return gains_at(self.layout, self.free, self.padded(theta), widen)

    @functools.cached_property
    def _compiled(self) -> Any:
        return jit(self.gains)

    def deploy(self, theta: np.ndarray, widen: float = 1.0) -> Gains:
        """Gains at theta [size] as they are saved: checked, the start itself where nothing moved, the read-out rounded."""
        if not np.any(theta) and widen == 1.0:
            return self.start
        gains = self._compiled(jnp.asarray(theta, self.start.arx.xi_a.dtype), widen)
        if POLES in self.names:
            gains = exact(self.config, gains)
        check_gains(self.config, gains)
        return gains


def widened(gains: Gains, factor: Array | float) -> Gains:
    """Gains with the widths of both smooth signs times a factor."""
    return gains.replace({"observer.eps": factor * gains.observer.eps, "control.eps": factor * gains.control.eps})


def space(config: Config, start: Gains, free: Iterable[str], shared: Iterable[str] = ()) -> Space:
    """Theta for the gains named in ``free``; those in ``shared`` move on all joints alike, the rest joint by joint.

    Raises:
        ValueError: the start is not allowed, a name is unknown, or poles are free that the read-out cannot follow.
    """
    check_gains(config, start)
    free, shared = select(config, free), _expand(config, shared)
    if any(leaf.ndim != len(spec.axes) for (_, _, spec), leaf in zip(specs(start), jax.tree.leaves(start), strict=True)):
        raise ValueError("tuning starts from one set of gains; these have scenario axes of their own")
    if POLES in free and not np.array_equal(start.arx.xi_a, start.arx.xi_b):
        raise ValueError(f"{POLES} can be tuned where both banks have the same pole, got arx.xi_a and arx.xi_b that differ")
    layout = layout_of(config, poles=POLES in free)
    leaves, moved, coordinates, gaps = [], np.zeros((layout.size, layout.size)), np.zeros(layout.size), []
    size = 0
    for leaf in layout.leaves:
        value = np.asarray(getattr(getattr(start, leaf.block), leaf.name), float)
        gaps.append(float(np.diff(value).mean()) if leaf.name in INCREASING else 1.0)
        smallest = SMALLEST.get(leaf.path, 1e-3 * float(np.max(leaf.spec.default)))
        coordinates[leaf.part] = _to_free(leaf.name, leaf.spec, value, gaps[-1], smallest).ravel()
        if leaf.path in free:
            shape = (1,) if leaf.path in shared and leaf.spec.axes == ("n",) else leaf.shape
            part = slice(size, size + math.prod(shape))
            moved[part, leaf.part] = np.ones(leaf.shape) if shape == (1,) else np.eye(math.prod(shape))
            leaves.append(leaf._replace(part=part, shape=shape))
            size = part.stop
    at, moves, gap = (jnp.asarray(x, start.arx.xi_a.dtype) for x in (coordinates, moved, gaps))
    return Space(config, start, tuple(leaves), size, layout, Free(start, at, moves, gap, stages.as_data(config)))


def layout_of(config: Config, *, poles: bool) -> Layout:
    """Every gain that some observer or controller of the scheme uses, so that all of them have one layout."""
    config = stages.general(config)
    unused = idle(config) - {"control.alpha_sm"}
    leaves, size = [], 0
    for block, name, spec in specs(config):
        path = f"{block}.{name}"
        if poles if path == POLES else block != "arx" and path not in unused:
            shape = shape_of(config, spec)
            leaves.append(Leaf(block, name, slice(size, size + math.prod(shape)), shape, spec))
            size += math.prod(shape)
    return Layout(config, tuple(leaves), size)


def _bounds(name: str, spec: Spec) -> tuple[float, float]:
    return (-1.0, 1.0) if name == "xi_a" else (spec.low, spec.high)


def _to_free(name: str, spec: Spec, value: np.ndarray, gap: float, smallest: float) -> np.ndarray:
    """Free coordinates of a gain, in its shape; set centres as the first one and the logs of their gaps."""
    low, high = _bounds(name, spec)
    if name in INCREASING:
        return np.concatenate([value[:1] / gap, np.log(np.diff(value))])
    if math.isinf(high):
        return np.log(np.maximum(value - low, smallest))
    place = (value - low) / (high - low)
    place = np.where(place <= 0, INSET, np.where(place >= 1, 1 - INSET, place))
    return np.log(place / (1 - place))


def _from_free(leaf: Leaf, free: Array, gap: Array) -> Array:
    """The gain at free coordinates of its shape; inverse of ``_to_free`` inside the limits."""
    low, high = _bounds(leaf.name, leaf.spec)
    if leaf.name in INCREASING:
        first = gap * free[:1]
        return jnp.concatenate([first, first + jnp.cumsum(jnp.exp(free[1:]))])
    if math.isinf(high):
        return low + jnp.exp(free)
    return low + (high - low) * jax.nn.sigmoid(free)
