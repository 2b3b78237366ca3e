"""``Gains``: everything that tuning may change, each with its unit, shape and limits in one place.

The metadata of a field drives the defaults, the checks, the gains file and the shaping of constants; ``[n]`` leaves hold one
value a joint. Gains may carry trailing scenario axes of their own, for sweeps.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike

from jaxftc import checks
from jaxftc.config import Config
from jaxftc.numerics.batch import trailing
from jaxftc.types import Array


class Spec(NamedTuple):
    """What a gain is: axes (n joints, a and b Laguerre functions, u inputs, or a number), unit, default, limits."""

    axes: tuple[str, ...]
    unit: str
    default: Any
    low: float
    high: float
    open_low: bool


def _gain(
    axes: str, unit: str, default: Any, low: float = -math.inf, high: float = math.inf, *, above: float | None = None
) -> Any:
    spec = Spec(tuple(axes.split()), unit, default, low if above is None else above, high, above is not None)
    return dataclasses.field(metadata={"spec": spec})


def _block(cls: type) -> type:
    return jax.tree_util.register_dataclass(dataclasses.dataclass(frozen=True)(cls))


_THIRDS = tuple(k / 3 for k in range(-3, 4))
_Q_RANGE, _S_RANGE = math.radians(100.0), 1.0  # rad and rad/s, the paper's ranges of Table 1's inputs


@_block
class ArxGains:
    """Block 1, Eqs. (4), (5)."""

    xi_a: Array = _gain("n", "1", 0.8, above=-1.0, high=1.0)  # pole of the angle's bank, in (-1, 1)
    xi_b: Array = _gain("n", "1", 0.8, above=-1.0, high=1.0)  # pole of the input's bank, in (-1, 1)
    kappa_a: Array = _gain("n a", "1", None)  # read-out of the angle's bank
    kappa_b: Array = _gain("n u b", "rad per input unit", None)  # read-out of the input's bank
    offset: Array = _gain("n", "rad", 0.0)  # read-out of the constant input


@_block
class ObserverGains:
    """Blocks 2 to 4, Eqs. (6) to (10). Gains act per tick."""

    alpha_p: Array = _gain("n", "1", 0.7, above=0.0, high=1.0)  # correction weight, Eq. (6)
    alpha_i: Array = _gain("n", "1/s^2", 680.0, low=0.0)  # integral, Eq. (6)
    alpha_sm: Array = _gain("n", "rad^0.5/s^2", 120.0, low=0.0)  # super-twisting root, Eq. (7)
    alpha_sm0: Array = _gain("n", "rad/s^3", 30.0, low=0.0)  # super-twisting integral, Eq. (7)
    eps: Array = _gain("n", "rad", 1e-3, above=0.0)  # width of the smooth sgn of the innovation
    alpha_f1: Array = _gain("n", "1/s^2", 1500.0, low=0.0)  # consequent of the actuator rule, Eq. (9)
    alpha_f2: Array = _gain(
        "n", "1", 1.0, low=0.0, high=1.0
    )  # consequent of the sensor rule: share of a jump attributed to the encoder
    alpha_f3: Array = _gain("n", "1/s^2", 1500.0, low=0.0)  # consequent of the actuator-and-sensor rule, Eq. (9)
    leak: Array = _gain("n", "1", 0.002, low=0.0, high=1.0)  # l, forgetting of the fuzzy estimate per tick
    jump: Array = _gain("n", "rad", 1e-3, above=0.0)  # jump that is surely the encoder's; graded 1/2 at half of it
    tau_centres: Array = _gain("2", "1", (0.0, 1.0))  # sets "zero", "at threshold" of |residual_tau| / alpha_tau
    tau_widths: Array = _gain("2", "1", (0.25, 0.25), above=0.0)
    jump_centres: Array = _gain("2", "1", (0.0, 1.0))  # sets "zero", "at threshold" of |jump| / jump
    jump_widths: Array = _gain("2", "1", (0.15, 0.15), above=0.0)


@_block
class DiagnosisGains:
    """Blocks 5 to 7, Eqs. (14), (17), (18)."""

    alpha_tau: Array = _gain("n", "N m", 2.0, above=0.0)  # torque threshold
    alpha_q: Array = _gain("n", "rad", math.radians(1.0), above=0.0)  # encoder threshold
    lead: Array = _gain("n", "1/s^2", 0.0, low=0.0)  # weight of the innovation beside psi in the torque statistic
    lam_tau: Array = _gain("n", "1", 0.7, low=0.0, high=1.0)  # w, weight of the residual against its leaky mean
    lam_q: Array = _gain("n", "1", 1.0, low=0.0, high=1.0)
    leak_tau: Array = _gain("n", "1", 0.1, above=0.0, high=1.0)  # l, forgetting of that mean per tick
    leak_q: Array = _gain("n", "1", 0.1, above=0.0, high=1.0)
    rate: Array = _gain("n", "1/s", 10.0, above=0.0)  # bandwidth of the torque residual (Diagnoser)
    stiction: Array = _gain("n", "N m", 0.0, low=0.0)  # residual that a standing joint may hold by friction (Diagnoser)


@_block
class ControlGains:
    """Blocks 8, 9, Eqs. (19), (24), (30) to (33)."""

    lam: Array = _gain("n", "1/s", 20.0, above=0.0)  # slope of the sliding surface
    alpha_sm: Array = _gain("n", "rad/s^2", 10.0, low=0.0)  # switching gain of SMC
    alpha_sm2: Array = _gain("n", "rad/s^2", 10.0, low=0.0)  # switching gain of ESMC and AFESMC
    k_b: Array = _gain("n", "1/s", 0.0, low=0.0)  # linear reaching term; the paper's K_beta, which only its proof has
    eps: Array = _gain("n", "rad/s", 0.5, above=0.0)  # boundary layer of sgn(s)
    speed_weight: Array = _gain("n", "1", 0.15, above=0.0, high=1.0)  # weight of the measured against the predicted speed
    q_centres: Array = _gain("7", "rad", tuple(_Q_RANGE * c for c in _THIRDS))  # Table 1, sets NB to PB
    q_widths: Array = _gain("7", "rad", (0.15 * _Q_RANGE,) * 7, above=0.0)
    s_centres: Array = _gain("7", "rad/s", tuple(_S_RANGE * c for c in _THIRDS))
    s_widths: Array = _gain("7", "rad/s", (0.15 * _S_RANGE,) * 7, above=0.0)
    outputs: Array = _gain("3", "1", (0.5, 1.5, 2.5), low=0.0, high=3.0)  # centres of PS, PM, PB
    floor: Array = _gain("n", "1", 0.1, above=0.0)  # least alpha_online; as printed it can reach 0


@_block
class BaselineGains:
    """The other schemes: computed torque, momentum observer, extended Kalman filter (jaxftc/baselines).

    A walk is the standard deviation that a random walk reaches in one second.
    """

    kp: Array = _gain("n", "1/s^2", 625.0, low=0.0)  # computed torque, on the angle's error
    kd: Array = _gain("n", "1/s", 50.0, low=0.0)  # on the speed's error
    speed_weight: Array = _gain("n", "1", 0.15, above=0.0, high=1.0)  # of the measured against the predicted speed
    rate: Array = _gain("n", "1/s", 120.0, above=0.0)  # K_o of the momentum observer
    noise_y: Array = _gain("n", "rad", 3e-5, above=0.0)  # EKF, standard deviation of a reading
    walk_qd: Array = _gain("n", "rad/s^1.5", 0.02, above=0.0)  # EKF, of the speed: what the model does not know
    walk_psi: Array = _gain("n", "rad/s^2.5", 10.0, above=0.0)  # EKF, of the actuator fault, as its joint's acceleration
    walk_b: Array = _gain("n", "rad/s^0.5", 3e-4, above=0.0)  # EKF, of the encoder fault


@_block
class Gains:
    """All of them, by block."""

    arx: ArxGains
    observer: ObserverGains
    diagnosis: DiagnosisGains
    control: ControlGains
    baseline: BaselineGains

    def replace(self, changes: Mapping[str, ArrayLike]) -> Gains:
        """Gains with some of them changed: ``gains.replace({"control.lam": 30.0})``.

        It can be traced: the new values may depend on what ``jax.grad`` or ``jax.vmap`` is over. Limits are checked where
        the gains are used.

        Args:
            changes: New values in the gain's unit, by block and name. A number counts for every joint, set or function; an
                array has the gain's own axes, each as long as the gain's or 1, and may have scenario axes behind them.

        Returns:
            Other gains; the dtype of each is kept.

        Raises:
            ValueError: an unknown name, or a shape that the gain cannot take.
        """
        blocks: dict[str, dict[str, Array]] = {}
        for path, value in changes.items():
            checks.one_of("gain", path, NAMES)
            block, name = path.split(".")
            blocks.setdefault(block, {})[name] = _filled(path, value, getattr(getattr(self, block), name))
        changed = {block: dataclasses.replace(getattr(self, block), **values) for block, values in blocks.items()}
        return Gains(**{block: changed.get(block, getattr(self, block)) for block in BLOCKS})


BLOCKS = {
    "arx": ArxGains,
    "observer": ObserverGains,
    "diagnosis": DiagnosisGains,
    "control": ControlGains,
    "baseline": BaselineGains,
}
NAMES = tuple(f"{block}.{field.name}" for block, cls in BLOCKS.items() for field in dataclasses.fields(cls))
INCREASING = ("tau_centres", "jump_centres", "q_centres", "s_centres")


def _spec(block: str, name: str) -> Spec:
    return BLOCKS[block].__dataclass_fields__[name].metadata["spec"]


def specs() -> Iterator[tuple[str, str, Spec]]:
    """(block, name, spec) of every gain, in order."""
    for block, cls in BLOCKS.items():
        for field in dataclasses.fields(cls):
            yield block, field.name, field.metadata["spec"]


def shape_of(config: Config, spec: Spec) -> tuple[int, ...]:
    """Numbers for the axes of a spec."""
    sizes = {"n": config.n, "a": config.order_a, "b": config.order_b, "u": config.inputs}
    return tuple(sizes[axis] if axis in sizes else int(axis) for axis in spec.axes)


def build(config: Config, values: dict[str, dict[str, Any]]) -> Gains:
    """Gains from nested plain values, in JAX's current float type."""
    blocks = {
        block: cls(**{f.name: jnp.asarray(values[block][f.name], float) for f in dataclasses.fields(cls)})
        for block, cls in BLOCKS.items()
    }
    gains = Gains(**blocks)
    check(config, gains)
    return gains


def _filled(path: str, value: ArrayLike, old: Array) -> Array:
    """A new value of a gain in the shape [own axes, ...] and the dtype of the old one."""
    block, name = path.split(".")
    own = jnp.shape(old)[: len(_spec(block, name).axes)]
    new = jnp.asarray(value, jnp.result_type(old))
    axes = new.shape[: len(own)]
    if new.ndim and (len(axes) < len(own) or any(a not in (1, b) for a, b in zip(axes, own, strict=True))):
        raise ValueError(
            f"{path} must be a number or have shape {list(own)}, scenario axes behind that, got {list(new.shape)}"
        )
    return jnp.broadcast_to(new, (*own, *new.shape[len(own) :]))


def align(gains: Gains, axes: int) -> Gains:
    """Give every leaf the singleton scenario axes it lacks, so that blocks simply broadcast."""
    blocks = {
        block: cls(
            **{
                f.name: trailing(getattr(getattr(gains, block), f.name), len(f.metadata["spec"].axes), axes)
                for f in dataclasses.fields(cls)
            }
        )
        for block, cls in BLOCKS.items()
    }
    return Gains(**blocks)


def check(config: Config, gains: Gains) -> None:
    """Refuse gains of a wrong shape, not finite or outside their limits; values under a trace are not looked at.

    Raises:
        ValueError: naming the gain, what came and what is allowed.
    """
    for block, name, spec in specs():
        leaf, path = getattr(getattr(gains, block), name), f"{block}.{name}"
        shape = shape_of(config, spec)
        if jnp.shape(leaf)[: len(shape)] != shape:
            raise ValueError(f"{path} must have shape {list(shape)}, got {list(jnp.shape(leaf))}; n is {config.n} joints")
        if not isinstance(leaf, Tracer):
            _check_values(path, np.asarray(leaf), spec)


def _check_values(path: str, value: np.ndarray, spec: Spec) -> None:
    if not np.isfinite(value).all():
        raise ValueError(f"{path} must be finite, got {value.tolist()}")
    both_open = spec.open_low and spec.high == 1.0 and spec.low == -1.0
    below = value <= spec.low if spec.open_low else value < spec.low
    over = value >= spec.high if both_open else value > spec.high
    if (below | over).any():
        closing = ")" if both_open or math.isinf(spec.high) else "]"
        interval = f"{'(' if spec.open_low else '['}{spec.low:g}, {spec.high:g}{closing}"
        unit = "" if spec.unit == "1" else f" {spec.unit}"
        raise ValueError(f"{path} must lie in {interval}{unit}, got {value.tolist()}")
    if path.split(".")[1] in INCREASING and (np.diff(value, axis=0) <= 0).any():
        raise ValueError(f"{path} must increase from set to set, got {value.tolist()}")
