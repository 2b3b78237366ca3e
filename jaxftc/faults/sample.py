"""Presets: scenarios drawn from laws, each a function of the key and of its id alone.

Scenario ``id`` is drawn with ``fold_in(key, id)``, so it does not depend on how many are drawn, in which order or chunk.
Faults are sized by the joint's torque limit and by angles; sizes that fit the arm's own kinds are in ``kinds.py``.
"""

from __future__ import annotations

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np

from jaxftc import checks
from jaxftc.arm.plant import nominal_plant
from jaxftc.compile import jit
from jaxftc.config import Config
from jaxftc.faults.kinds import Actuator, Fault, Sensor
from jaxftc.faults.scenario import CONDITIONS, ENCODER_NOISE, Scenario, paper_motion, paper_scenario, stack
from jaxftc.types import Array

SLOW = (Sensor.DRIFT, Sensor.FREEZE, Sensor.SCALE, Sensor.NOISE)


@dataclasses.dataclass(frozen=True)
class Preset:
    """Laws of a preset: shares of the conditions, kinds and sizes of faults, how the arm differs from its model."""

    shares: tuple[float, float, float, float] = (0.2, 0.3, 0.3, 0.2)  # healthy, actuator, sensor, both
    actuator_kinds: tuple[Actuator, ...] = (Actuator.BIAS, Actuator.LOSS, Actuator.STUCK)
    sensor_kinds: tuple[Sensor, ...] = (Sensor.BIAS, *SLOW)
    sensor_kinds_in_both: tuple[Sensor, ...] = (Sensor.BIAS,)
    joints: int = 1  # at fault in a channel at once
    smaller: float = 1.0  # factor on the lower bounds of all sizes
    gradual: float = 0.0  # share of incipient faults, and the same share of intermittent ones
    mass: float = 0.02  # +- on each link
    friction: float = 0.10  # +- on each joint's viscous and Coulomb friction
    payload: float = 0.0  # kg, the most


PRESETS = {
    "standard": Preset(),
    "hard": Preset(joints=2, smaller=0.5, gradual=1 / 3, mass=0.05, friction=0.20, payload=1.0),
    "doubles": Preset(shares=(0.0, 0.0, 0.0, 1.0), sensor_kinds_in_both=SLOW),
}
BIAS_TAU, LOSS, SATURATION = (0.05, 0.3), (0.3, 0.9), (0.1, 0.5)  # of the torque limit; lost share; share left
BIAS_Q, DRIFT = (math.radians(0.2), math.radians(5.0)), (math.radians(5.0), math.radians(50.0))  # rad, rad/s
SCALE, NOISE = (0.02, 0.10), (20.0, 100.0)  # share of the angle; factor on the noise
START, TRAVEL = math.radians(30.0), math.radians(90.0)  # rad, +- about the paper's start, and per joint
ONSET, LASTING = (0.1, 0.5), (0.1, 0.4)  # s; half of the faults stay instead
RISE, PERIOD, DUTY = (0.02, 0.2), (0.05, 0.2), (0.3, 0.8)  # s, s, 1


def sample_scenarios(key: Array, n: int, preset: str = "standard", *, config: Config) -> Scenario:
    """Draw n scenarios with a leading axis; ``paper`` deals the paper's four conditions in turn and draws nothing.

    Raises:
        ValueError: an unknown preset, n below 1, or an arm without the torque limits that faults are sized by.
    """
    checks.one_of("preset", preset, ("paper", *PRESETS))
    checks.integer("n", n, 1, "it is the number of scenarios")
    ids = jnp.arange(n, dtype=jnp.int32)
    if preset == "paper":
        four = stack([paper_scenario(condition, config) for condition in CONDITIONS])
        return jax.tree.map(lambda leaf: leaf[ids % len(CONDITIONS)], four)._replace(id=ids)
    if not np.isfinite(config.robot.torque_limit).all():
        raise ValueError(
            f"preset {preset!r} sizes faults by torque limits, {config.robot.name!r} has "
            f"{config.robot.torque_limit.tolist()} N m; "
            "give every joint a motor with a ctrlrange, or build Scenario yourself"
        )
    return _draw_all(PRESETS[preset], config, key, ids)


def _draw_all(laws: Preset, config: Config, key: Array, ids: Array) -> Scenario:
    return jax.vmap(lambda i: draw(laws, config, jax.random.fold_in(key, i), i))(ids)


_draw_all = jit(_draw_all, static_argnums=(0, 1))


class Dice:
    """Uniform numbers of one scenario, drawn at once (one random call compiles in a second, forty do not) and dealt out."""

    def __init__(self, key: Array, count: int) -> None:
        self._left = jax.random.uniform(key, (count,), float)

    def __call__(self, low: float | Array, high: float | Array, shape: tuple[int, ...] = ()) -> Array:
        """The next numbers, U(low, high)."""
        size = math.prod(shape)
        taken, self._left = self._left[:size], self._left[size:]
        return low + (high - low) * taken.reshape(shape)

    def choice(self, options: tuple[int, ...]) -> Array:
        """One of some kinds, equally likely, int32."""
        index = self(0.0, len(options)).astype(jnp.int32)  # U is below 1
        return jnp.asarray(options, jnp.int32)[index]

    def side(self) -> Array:
        """Either -1 or 1."""
        return jnp.sign(self(-1.0, 1.0))

    def joints(self, count: int, n: int) -> Array:
        """``count`` different joints, [n] bool."""
        return jnp.argsort(self(0.0, 1.0, (n,))) < count


def draw(laws: Preset, config: Config, key: Array, scenario_id: Array) -> Scenario:
    """One scenario from its own key."""
    n = config.n
    dice = Dice(key, 32 + 7 * n)
    condition = jnp.searchsorted(jnp.cumsum(jnp.asarray(laws.shares[:3])), dice(0.0, 1.0), side="right")
    q_start = paper_motion(config)[0] + dice(-START, START, (n,))  # start: U(+-30 deg)
    q_goal = q_start + dice(-TRAVEL, TRAVEL, (n,))  # travel: U(+-90 deg)
    law = _times(laws, dice)
    torque = _actuator(laws, config, dice)
    alone, beside = _sensor(laws, laws.sensor_kinds, dice), _sensor(laws, laws.sensor_kinds_in_both, dice)
    angle = jnp.where(condition == 3, beside, alone)
    tau_joints, q_joints = dice.joints(laws.joints, n), dice.joints(laws.joints, n)
    return Scenario(
        id=scenario_id,
        q_start=q_start,
        q_goal=q_goal,
        noise=jnp.asarray(ENCODER_NOISE, float),
        fault_tau=_fault(torque, tau_joints & ((condition == 1) | (condition == 3)), law),
        fault_q=_fault(angle, q_joints & (condition >= 2), law),
        plant=nominal_plant(config.robot)._replace(
            mass=dice(1 - laws.mass, 1 + laws.mass, (n,)),
            damping=dice(1 - laws.friction, 1 + laws.friction, (n,)),
            coulomb=dice(1 - laws.friction, 1 + laws.friction, (n,)),
            payload=dice(0.0, laws.payload),
        ),
    )


def _actuator(laws: Preset, config: Config, dice: Dice) -> Array:
    """(kind, magnitude [n]) of an actuator fault as one array [1 + n]: every size is drawn, the kind's own is taken."""
    kind, side = dice.choice(laws.actuator_kinds), dice.side()
    bias, loss, left = (dice(laws.smaller * low, high) for low, high in (BIAS_TAU, LOSS, SATURATION))
    limit = jnp.asarray(config.robot.torque_limit, float)
    size = jnp.select(
        [kind == Actuator.BIAS, kind == Actuator.LOSS, kind == Actuator.SATURATION],
        [side * bias * limit, jnp.full_like(limit, loss), jnp.full_like(limit, left)],
        jnp.zeros_like(limit),
    )
    return jnp.concatenate([kind[None].astype(float), size])


def _sensor(laws: Preset, kinds: tuple[Sensor, ...], dice: Dice) -> Array:
    """(kind, magnitude) of an encoder fault as one array [2]."""
    kind, side = dice.choice(kinds), dice.side()
    bias, drift, scale, noise = (dice(laws.smaller * low, high) for low, high in (BIAS_Q, DRIFT, SCALE, NOISE))
    sizes = {Sensor.BIAS: side * bias, Sensor.DRIFT: side * drift, Sensor.SCALE: side * scale, Sensor.NOISE: noise}
    size = jnp.select([kind == k for k in sizes], list(sizes.values()), 0.0)
    return jnp.stack([kind.astype(float), size])


def _times(laws: Preset, dice: Dice) -> dict[str, Array]:
    """Onset, clearance, rise, period and duty of one scenario; both channels share them."""
    onset = dice(*ONSET)  # onset: U(.1, .5) s
    clear = jnp.where(dice(0.0, 1.0) < 0.5, jnp.inf, onset + dice(*LASTING))  # half stay, half clear after U(.1, .4) s
    u, rise, period, duty = dice(0.0, 1.0), dice(*RISE), dice(*PERIOD), dice(*DUTY)
    ramps, comes_and_goes = u < laws.gradual, (u >= laws.gradual) & (u < 2 * laws.gradual)
    return {
        "onset": onset,
        "clear": clear,
        "rise": jnp.where(ramps, rise, 0.0),
        "period": jnp.where(comes_and_goes, period, jnp.inf),
        "duty": jnp.where(comes_and_goes, duty, 1.0),
    }


def _fault(drawn: Array, joints: Array, law: dict[str, Array]) -> Fault:
    """The drawn fault on some joints [n], none on the others."""
    return Fault(
        kind=jnp.where(joints, drawn[0], 0).astype(jnp.int32),
        magnitude=jnp.where(joints, drawn[1:], 0.0),
        **{name: jnp.broadcast_to(value, joints.shape) for name, value in law.items()},
    )
