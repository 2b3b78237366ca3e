"""Faults in an environment of gymnasium: the agent sees faulty observations, and the truth is in ``info``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxftc import checks
from jaxftc.faults.inject import Faults, Injector

try:
    import gymnasium  # pyright: ignore[reportMissingImports]
except ImportError as error:
    raise ImportError("faults in an environment need gymnasium; install it with: pip install 'jaxftc[gym]'") from error


class FaultWrapper(gymnasium.Wrapper):
    """An environment with faults between agent and simulator.

    Actions are clipped to their space, then the actuators' faults act on them; the sensors' faults act on observations. A
    sensor that gives nothing reads nan. Every ``info`` has ``faults``: what the faults added to the action (``action``) and
    to the observation (``observation``, 0 where nothing was read), and the observation without them (``truth``).

    Args:
        env: With actions and observations in boxes of one axis.
        faults: Those of every episode, or a function of a random generator that draws them for each. Their readings are
            the entries that ``sensors`` names.
        sensors: Entries of the observation that are read by sensors; all if None.
        dt: s, of a step; the environment's ``dt`` if None.

    Raises:
        ValueError: the spaces are of another kind, an entry is not there, or dt is not known.
    """

    def __init__(
        self,
        env: gymnasium.Env,
        faults: Faults | Callable[[np.random.Generator], Faults],
        *,
        sensors: Sequence[int] | None = None,
        dt: float | None = None,
    ) -> None:
        super().__init__(env)
        sizes: dict[str, int] = {}
        for name, space in (("actions", env.action_space), ("observations", env.observation_space)):
            if not (isinstance(space, gymnasium.spaces.Box) and len(space.shape) == 1):
                raise ValueError(f"{name} must be in a box of one axis, got {space}")
            sizes[name] = space.shape[0]
        size = sizes["observations"]
        self._sensors = np.arange(size) if sensors is None else np.asarray(sensors, int)
        if self._sensors.ndim != 1 or not ((self._sensors >= 0) & (self._sensors < size)).all():
            raise ValueError(f"sensors must be entries of the observation, 0 to {size - 1}, got {sensors}")
        step = getattr(env.unwrapped, "dt", None) if dt is None else dt
        if step is None:
            raise ValueError("dt must be given in s, as the environment does not say how long a step is")
        checks.positive("dt", step, "seconds")
        self._dt, self._steps = float(step), 0
        self._faults = faults
        self._random = np.random.default_rng()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, with faults drawn anew; the seed is theirs, too."""
        if seed is not None:
            self._random = np.random.default_rng(seed)
        faults = self._faults if isinstance(self._faults, Faults) else self._faults(self._random)
        low, high = self.env.action_space.low, self.env.action_space.high  # pyright: ignore[reportAttributeAccessIssue]
        self._low, self._high = low, high
        self._injector = Injector(faults, limit=np.maximum(np.abs(low), np.abs(high)))
        wanted = ((len(low),), (len(self._sensors),))
        found = (self._injector.command_error.shape, self._injector.reading_error.shape)
        if found != wanted:
            raise ValueError(f"faults must be of {wanted[0][0]} commands and {wanted[1][0]} readings, got shapes {found}")
        self._steps = 0
        observation, info = self.env.reset(seed=seed, options=options)
        return self._seen(observation, info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """One step: the faulty action acts, the faulty observation is seen."""
        delivered = self._injector.command(self._steps * self._dt, np.clip(action, self._low, self._high))
        self._steps += 1
        observation, reward, terminated, truncated, info = self.env.step(delivered.astype(self._low.dtype))
        return (*self._seen(observation, info, reward, terminated, truncated),)

    def _seen(self, observation: Any, info: dict[str, Any], *between: Any) -> tuple[Any, ...]:
        """What the agent gets, with the truth in info."""
        seen, error = np.array(observation), np.zeros(len(observation))
        seen[self._sensors] = self._injector.reading(self._steps * self._dt, seen[self._sensors])
        error[self._sensors] = self._injector.reading_error
        truth = {"action": self._injector.command_error, "observation": error, "truth": np.array(observation)}
        return seen, *between, info | {"faults": truth}
