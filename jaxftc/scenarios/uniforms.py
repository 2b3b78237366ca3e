"""The random numbers of one scenario and what is read from them: laws, kinds of fault, signs, joints."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc.scenarios.distributions import Law, quantile
from jaxftc.scenarios.faults import Actuator, Kind, Sensor, Unsized
from jaxftc.types import Array

DEALT: dict[type[Kind], Kind] = {Actuator: Actuator.SATURATION, Sensor: Sensor.DROPOUT}


class UniformStream:
    """Uniform numbers of one scenario, drawn at once (one random call compiles in a second, forty do not) and dealt out."""

    def __init__(self, key: Array, count: int) -> None:
        self._key = key
        self._left = jax.random.uniform(key, (count,), float)

    def number(self, shape: tuple[int, ...] = ()) -> Array:
        """The next numbers, U(0, 1)."""
        count = math.prod(shape)
        taken, self._left = self._left[:count], self._left[count:]
        return taken.reshape(shape)

    def __call__(self, law: Law, shape: tuple[int, ...] = ()) -> Array:
        """The next numbers of a law, one each."""
        return quantile(law, self.number(shape))

    def kind(self, options: dict[str, Unsized], codes: type[Kind]) -> Array:
        """One of some kinds of fault by their weights, int32; NONE without any."""
        weights = [kind.weight for kind in options.values()]
        ends = np.cumsum(weights) * (len(weights) / (sum(weights) or 1.0))  # 1, 2, 3, .. for equal weights, exactly
        index = (len(weights) * self.number() >= ends[:-1]).sum()
        return jnp.asarray([codes[name.upper()] for name in options] or [codes(0)], jnp.int32)[index]

    def of_kind(self, kind: Kind) -> UniformStream:
        """The stream that a kind's size is dealt from.

        Kinds up to ``DEALT`` share this one; a later one has its own, so that a preset draws what it drew before there was
        such a kind.
        """
        if kind <= DEALT[type(kind)]:
            return self
        return self.apart(100 * (type(kind) is Sensor) + kind, 1)

    def apart(self, number: int, count: int) -> UniformStream:
        """Another stream of ``count`` numbers, which takes none of this one's."""
        return UniformStream(jax.random.fold_in(self._key, number), count)

    def side(self) -> Array:
        """Either -1 or 1."""
        return jnp.where(self.number() < 0.5, -1.0, 1.0)

    def joints(self, count: int, allowed: list[int], n: int) -> Array:
        """``count`` different joints of those allowed, [n] bool."""
        order = jnp.argsort(self.number((n,))[: len(allowed)])
        return jnp.zeros(n, bool).at[jnp.asarray(allowed)].set(order < count)
