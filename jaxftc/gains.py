"""``Gains``: everything that tuning may change, each with its unit, shape and limits in one place.

The metadata of a field (``gain_spec.py``) drives the defaults, the checks, the gains file and the shaping of constants;
``[n]`` leaves hold one value a joint. Gains may carry trailing scenario axes of their own, for sweeps.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike

from jaxftc import checks, variants
from jaxftc.config import Config
from jaxftc.decision_gains import DecisionGains
from jaxftc.gain_spec import Spec as Spec
from jaxftc.gain_spec import block as block
from jaxftc.gain_spec import check_values
from jaxftc.gain_spec import gain as gain
from jaxftc.numerics.batch import trailing
from jaxftc.types import Array

_THIRDS = tuple(k / 3 for k in range(-3, 4))
_Q_RANGE, _S_RANGE = math.radians(100.0), 1.0  # rad and rad/s, the paper's ranges of Table 1's inputs


@block
class ArxGains:
    """Block 1, Eqs. (4), (5)."""

    xi_a: Array = gain("n", "1", 0.8, above=-1.0, high=1.0, doc="pole of the angle's bank, in (-1, 1)")
    xi_b: Array = gain("n", "1", 0.8, above=-1.0, high=1.0, doc="pole of the input's bank, in (-1, 1)")
    kappa_a: Array = gain("n a", "1", None, doc="read-out of the angle's bank")
    kappa_b: Array = gain("n u b", "rad per input unit", None, doc="read-out of the input's bank")
    offset: Array = gain("n", "rad", 0.0, doc="read-out of the constant input")


@block
class ObserverGains:
    """Blocks 2 to 4, Eqs. (6) to (10). Gains act per tick."""

    alpha_p: Array = gain("n", "1", 0.7, above=0.0, high=1.0, doc="correction weight, Eq. (6)")
    alpha_i: Array = gain("n", "1/s^2", 680.0, low=0.0, doc="integral, Eq. (6)")
    alpha_sm: Array = gain("n", "rad^0.5/s^2", 120.0, low=0.0, doc="super-twisting root, Eq. (7)")
    alpha_sm0: Array = gain("n", "rad/s^3", 30.0, low=0.0, doc="super-twisting integral, Eq. (7)")
    eps: Array = gain("n", "rad", 1e-3, above=0.0, doc="width of the smooth sgn of the innovation")
    alpha_f1: Array = gain("n", "1/s^2", 1500.0, low=0.0, doc="consequent of the actuator rule, Eq. (9)")
    alpha_f2: Array = gain(
        "n", "1", 1.0, low=0.0, high=1.0, doc="consequent of the sensor rule: the encoder's share of a jump"
    )
    alpha_f3: Array = gain("n", "1/s^2", 1500.0, low=0.0, doc="consequent of the actuator-and-sensor rule, Eq. (9)")
    leak: Array = gain("n", "1", 0.002, low=0.0, high=1.0, doc="l, forgetting of the fuzzy estimate per tick")
    jump: Array = gain("n", "rad", 1e-3, above=0.0, doc="jump that is surely the encoder's; graded 1/2 at half of it")
    tau_centres: Array = gain(
        "2", "1", (0.0, 1.0), doc="sets zero and at threshold of the size of residual_tau over alpha_tau"
    )
    tau_widths: Array = gain("2", "1", (0.25, 0.25), above=0.0, doc="their widths")
    jump_centres: Array = gain("2", "1", (0.0, 1.0), doc="sets zero and at threshold of a jump's size over jump")
    jump_widths: Array = gain("2", "1", (0.15, 0.15), above=0.0, doc="their widths")


@block
class DiagnosisGains:
    """Blocks 5 to 7, Eqs. (14), (17), (18)."""

    alpha_tau: Array = gain("n", "N m", 2.0, above=0.0, doc="torque threshold, of a joint at rest")
    alpha_q: Array = gain("n", "rad", math.radians(1.0), above=0.0, doc="encoder threshold")
    follow_speed: Array = gain("n", "s/rad", 0.0, low=0.0, doc="share of alpha_tau added to the torque threshold by speed")
    follow_acceleration: Array = gain("n", "s^2/rad", 0.0, low=0.0, doc="the same by acceleration")
    follow_reversal: Array = gain(
        "n", "1", 0.0, low=0.0, doc="the same where the joint turns round and friction changes sign"
    )
    follow_torque: Array = gain("n", "1/(N m)", 0.0, low=0.0, doc="the same by the torque that the model's links need")
    follow_payload: Array = gain("n", "1/(N m)", 0.0, low=0.0, doc="the same by the torque that 1 kg at the tool needs")
    lead: Array = gain("n", "1/s^2", 0.0, low=0.0, doc="weight of the innovation beside psi in the torque statistic")
    lam_tau: Array = gain("n", "1", 0.7, low=0.0, high=1.0, doc="w, weight of the residual against its leaky mean")
    lam_q: Array = gain("n", "1", 1.0, low=0.0, high=1.0, doc="the same weight in the encoder channel")
    leak_tau: Array = gain("n", "1", 0.1, above=0.0, high=1.0, doc="l, forgetting of that mean per tick")
    leak_q: Array = gain("n", "1", 0.1, above=0.0, high=1.0, doc="the same in the encoder channel")
    rate: Array = gain("n", "1/s", 10.0, above=0.0, doc="bandwidth of the torque residual, for the Diagnoser")
    fast: Array = gain("n", "1", 0.0, low=0.0, doc="weight of a faster residual beside that one, for the Diagnoser")
    stiction: Array = gain(
        "n", "N m", 0.0, low=0.0, doc="residual that a standing joint may hold by friction, for the Diagnoser"
    )


@block
class ControlGains:
    """Blocks 8, 9, Eqs. (19), (24), (30) to (33)."""

    lam: Array = gain("n", "1/s", 20.0, above=0.0, doc="slope of the sliding surface")
    alpha_sm: Array = gain("n", "rad/s^2", 10.0, low=0.0, doc="switching gain of SMC")
    alpha_sm2: Array = gain("n", "rad/s^2", 10.0, low=0.0, doc="switching gain of ESMC and AFESMC")
    k_b: Array = gain("n", "1/s", 0.0, low=0.0, doc="linear reaching term; the paper's K_beta, which only its proof has")
    eps: Array = gain("n", "rad/s", 0.5, above=0.0, doc="boundary layer of sgn(s)")
    speed_weight: Array = gain("n", "1", 0.15, above=0.0, high=1.0, doc="weight of measured against predicted speed")
    rate: Array = gain(
        "n", "1/s", 0.0, low=0.0, doc="rate at which the compensation takes up what psi leaves of a fault; 0: psi alone"
    )
    q_centres: Array = gain("7", "rad", tuple(_Q_RANGE * c for c in _THIRDS), doc="Table 1, sets NB to PB")
    q_widths: Array = gain("7", "rad", (0.15 * _Q_RANGE,) * 7, above=0.0, doc="their widths")
    s_centres: Array = gain("7", "rad/s", tuple(_S_RANGE * c for c in _THIRDS), doc="Table 1, sets NB to PB of s")
    s_widths: Array = gain("7", "rad/s", (0.15 * _S_RANGE,) * 7, above=0.0, doc="their widths")
    outputs: Array = gain("3", "1", (0.5, 1.5, 2.5), low=0.0, high=3.0, doc="centres of PS, PM, PB")
    floor: Array = gain("n", "1", 0.1, above=0.0, doc="least alpha_online; as printed it can reach 0")


@block
class AdaptationGains:
    """The arm that is learned (jaxftc/observer/adaptation.py): what it may differ by, and how soon it is learned."""

    load: Array = gain("1", "kg", 0.5, low=0.0, doc="standard deviation of the payload; 0 learns none")
    viscous: Array = gain("n", "1", 0.15, low=0.0, doc="standard deviation of viscous friction over the model's")
    coulomb: Array = gain("n", "1", 0.15, low=0.0, doc="the same of Coulomb friction")
    noise: Array = gain("n", "1", 0.1, above=0.0, doc="model error that is not learned, over alpha_tau")
    correlation: Array = gain("1", "s", 0.1, above=0.0, doc="time for which that error stays")
    memory: Array = gain("1", "s", 1.0, above=0.0, doc="time of motion after which a row is forgotten")


@block
class BaselineGains:
    """The other schemes: computed torque, momentum observer, extended Kalman filter (jaxftc/schemes).

    A walk is the standard deviation that a random walk reaches in one second.
    """

    kp: Array = gain("n", "1/s^2", 625.0, low=0.0, doc="computed torque, on the angle's error")
    kd: Array = gain("n", "1/s", 50.0, low=0.0, doc="on the speed's error")
    speed_weight: Array = gain("n", "1", 0.15, above=0.0, high=1.0, doc="of the measured against the predicted speed")
    rate: Array = gain("n", "1/s", 120.0, above=0.0, doc="K_o of the momentum observer")
    noise_y: Array = gain("n", "rad", 3e-5, above=0.0, doc="EKF, standard deviation of a reading")
    walk_qd: Array = gain("n", "rad/s^1.5", 0.02, above=0.0, doc="EKF, of the speed: what the model does not know")
    walk_psi: Array = gain("n", "rad/s^2.5", 10.0, above=0.0, doc="EKF, of the actuator fault, as its joint's acceleration")
    walk_b: Array = gain("n", "rad/s^0.5", 3e-4, above=0.0, doc="EKF, of the encoder fault")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Gains:
    """All of them, by block.

    Attributes:
        arx: The ARX-Laguerre model, block 1.
        observer: The cascade, blocks 2 to 4.
        diagnosis: Thresholds and statistics, blocks 5 to 7.
        control: The sliding-mode law and its fuzzy gain, blocks 8 and 9.
        adaptation: The arm that is learned while it runs.
        baseline: The other schemes of the package, which one gains file serves.
        own: Those of a scheme of the user's, if it has any.
        decision: Weights of the learned decision (``DecisionGains``), where that is used.
    """

    arx: ArxGains
    observer: ObserverGains
    diagnosis: DiagnosisGains
    control: ControlGains
    adaptation: AdaptationGains
    baseline: BaselineGains
    own: Any = None
    decision: Any = None

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
        found: dict[str, dict[str, Array]] = {}
        known = {f"{block}.{name}": spec for block, name, spec in specs(self)}
        for path, value in changes.items():
            checks.one_of("gain", path, tuple(known))
            block, name = path.split(".")
            found.setdefault(block, {})[name] = _filled(path, value, getattr(getattr(self, block), name), known[path])
        changed = {block: dataclasses.replace(getattr(self, block), **values) for block, values in found.items()}
        return dataclasses.replace(self, **changed)


BLOCKS = {
    "arx": ArxGains,
    "observer": ObserverGains,
    "diagnosis": DiagnosisGains,
    "control": ControlGains,
    "adaptation": AdaptationGains,
    "baseline": BaselineGains,
}
NAMES = tuple(f"{block}.{field.name}" for block, cls in BLOCKS.items() for field in dataclasses.fields(cls))


def blocks(of: Config | Gains | None = None) -> dict[str, type]:
    """Classes of the blocks, in order: with those of a config's scheme, or of gains, beside those that all have."""
    own, learned = None, False
    if isinstance(of, Config):
        own, learned = variants.own_gains(of.scheme), of.decision == "learned"
    elif of is not None:
        own, learned = None if of.own is None else type(of.own), of.decision is not None
    return BLOCKS | ({} if own is None else {"own": own}) | ({"decision": DecisionGains} if learned else {})


def specs(of: Config | Gains | None = None) -> Iterator[tuple[str, str, Spec]]:
    """(block, name, spec) of every gain, in order; see ``blocks``."""
    for part, cls in blocks(of).items():
        for field in dataclasses.fields(cls):
            yield part, field.name, field.metadata["spec"]


def names(of: Config | Gains | None = None) -> tuple[str, ...]:
    """Block and name of every gain, in order; see ``blocks``."""
    return tuple(f"{block}.{name}" for block, name, _ in specs(of))


def shape_of(config: Config, spec: Spec) -> tuple[int, ...]:
    """Numbers for the axes of a spec."""
    sizes = {"n": config.n, "a": config.order_a, "b": config.order_b, "u": config.inputs}
    return tuple(sizes[axis] if axis in sizes else int(axis) for axis in spec.axes)


def build(config: Config, values: dict[str, dict[str, Any]]) -> Gains:
    """Gains from nested plain values, in JAX's current float type."""
    built = {
        block: cls(**{f.name: jnp.asarray(values[block][f.name], float) for f in dataclasses.fields(cls)})
        for block, cls in blocks(config).items()
    }
    gains = Gains(**built)
    check(config, gains)
    return gains


def _filled(path: str, value: ArrayLike, old: Array, spec: Spec) -> Array:
    """A new value of a gain in the shape [own axes, ...] and the dtype of the old one."""
    own = jnp.shape(old)[: len(spec.axes)]
    new = jnp.asarray(value, jnp.result_type(old))
    axes = new.shape[: len(own)]
    if new.ndim and (len(axes) < len(own) or any(a not in (1, b) for a, b in zip(axes, own, strict=True))):
        raise ValueError(
            f"{path} must be a number or have shape {list(own)}, scenario axes behind that, got {list(new.shape)}"
        )
    return jnp.broadcast_to(new, (*own, *new.shape[len(own) :]))


def align(gains: Gains, axes: int) -> Gains:
    """Give every leaf the singleton scenario axes it lacks, so that blocks simply broadcast."""
    aligned = {
        block: cls(
            **{
                f.name: trailing(getattr(getattr(gains, block), f.name), len(f.metadata["spec"].axes), axes)
                for f in dataclasses.fields(cls)
            }
        )
        for block, cls in blocks(gains).items()
    }
    return Gains(**aligned)


def check(config: Config, gains: Gains) -> None:
    """Refuse gains of a wrong shape, not finite or outside their limits; values under a trace are not looked at.

    Raises:
        ValueError: naming the gain, what came and what is allowed; or config or gains are something else.
    """
    checks.instance("config", config, Config)
    checks.instance("gains", gains, Gains)
    own = blocks(config).get("own")
    if own is not None and not isinstance(gains.own, own):
        raise ValueError(
            f"gains.own must be those of scheme {config.scheme!r}, got {type(gains.own).__name__}; default_gains(config) "
            "has them"
        )
    if config.decision == "learned" and gains.decision is None:
        raise ValueError("gains.decision lacks the weights of decision='learned'; default_gains(config) has them")
    for part, name, spec in specs(config):
        leaf, path = getattr(getattr(gains, part), name), f"{part}.{name}"
        shape = shape_of(config, spec)
        if jnp.shape(leaf)[: len(shape)] != shape:
            raise ValueError(f"{path} must have shape {list(shape)}, got {list(jnp.shape(leaf))}; n is {config.n} joints")
        if not isinstance(leaf, Tracer):
            check_values(path, np.asarray(leaf), spec)
