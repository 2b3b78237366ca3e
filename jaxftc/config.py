"""``Config``: what is fixed before anything is traced. Frozen and hashable: a static argument of ``jax.jit``."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

from jaxftc import checks, variants
from jaxftc.fuzzy.rule_table import TABLES
from jaxftc.robot.dynamics import ENGINES, Engine
from jaxftc.robot.model import Robot

Observer = Literal["pi", "eso", "ts", "eso_printed"]
Control = Literal["smc", "esmc", "afesmc"]
OBSERVERS: tuple[str, ...] = ("pi", "eso", "ts")  # the paper's ranking; "eso_printed" is "eso" without its erratum mended
CONTROLS: tuple[str, ...] = ("smc", "esmc", "afesmc")
BY_TIME: Any = None  # a number of ticks that follows dt unless it is given
TIMES = {
    "alarm_ticks": (0.003, 2),
    "release_ticks": (0.01, 3),
    "transient_ticks": (0.06, 6),
}  # s, and at least so many ticks


class _ByTime(int):
    """Ticks that were not given: with another dt, as of ``dataclasses.replace``, there are others."""


@dataclasses.dataclass(frozen=True)
class Config:
    """Robot, structure and timing. Everything that tuning may change is in ``Gains`` instead.

    Attributes:
        robot: The arm, from ``puma560()`` or ``load_robot(path)``.
        dt: s, sample time.
        t_final: s, end of the motion, t_f of Eq. (35); a multiple of dt.
        duration: s, length of a simulation, a multiple of dt; t_final if None.
        engine: Dynamics of the simulated arm: MuJoCo MJX, or the unrolled chain (same motion,
            several times as fast).
        scheme: The paper's observer and controller, or another name of the table in
            ``jaxftc.variants``; or a scheme of your own, as ``module:object``, or the module or
            class itself. It is kept as that text.
        observer: How much of the cascade runs: ``pi`` is block 2, ``eso`` adds block 3, Eq. (7)
            mended (``eso_printed``: as printed), ``ts`` adds block 4.
        control: Sliding-mode law: Eq. (19), (24) or (30).
        adaptive: Whether payload and friction are learned while the arm runs; the cascade's only.
        contact: How many motors may fail at once. Torque alarms of more joints that a force on a
            link explains are a contact; with 0 contacts are not judged, with 1 two faults at once may
            be called one. The cascade's and the Diagnoser's.
        decision: What names joints and channels once there was an alarm: the rule, Eqs. (17), (18), or a
            small network with memory, whose weights are gains; the complete cascade's only.
        order_a: Laguerre functions on the output.
        order_b: Laguerre functions on the input.
        input: What drives the ARX model: an acceleration from the rigid-body model, or the torques
            themselves, as in the paper.
        rules: Table 1 as printed, or one of its mended forms.
        sign: ``smooth`` is tanh(x / eps), ``hard`` the printed sgn.
        alarm_ticks: Ticks above the threshold before a torque alarm, 3 ms unless given; a jump
            alarms at once.
        release_ticks: Ticks below the release level before an alarm ends, 10 ms unless given.
        transient_ticks: A torque alarm that ends sooner, 60 ms unless given, was a velocity
            transient of the reading, not a torque.

    Raises:
        ValueError: a value is not allowed; the message says which are.
    """

    robot: Robot
    dt: float = 1e-3
    t_final: float = 1.0
    duration: float | None = None
    engine: Engine = "mjx"
    scheme: Any = "cascade"
    observer: Observer = "ts"
    control: Control = "afesmc"
    adaptive: bool = False
    contact: int = 0
    decision: Literal["rule", "learned"] = "rule"
    order_a: int = 3
    order_b: int = 2
    input: Literal["rigid_body", "torque"] = "rigid_body"
    rules: Literal["printed", "symmetric", "s_only"] = "printed"
    sign: Literal["smooth", "hard"] = "smooth"
    alarm_ticks: int = BY_TIME
    release_ticks: int = BY_TIME
    transient_ticks: int = BY_TIME
    _code: tuple[Any, ...] = dataclasses.field(init=False, repr=False, default=())  # of a scheme of the user's

    def __post_init__(self) -> None:
        if not isinstance(self.robot, Robot):
            raise ValueError(f"robot must be a Robot, got {type(self.robot).__name__}; call puma560() or load_robot(path)")
        checks.positive("dt", self.dt, "seconds")
        for name, (seconds, least) in TIMES.items():
            if getattr(self, name) is BY_TIME or isinstance(getattr(self, name), _ByTime):
                object.__setattr__(self, name, _ByTime(max(least, round(seconds / self.dt))))
        checks.positive("t_final", self.t_final, "seconds")
        checks.multiple("t_final", self.t_final, self.dt)
        if self.duration is not None:
            checks.positive("duration", self.duration, "seconds")
            checks.multiple("duration", self.duration, self.dt)
        checks.one_of("engine", self.engine, ENGINES)
        object.__setattr__(self, "scheme", variants.name_of(self.scheme))
        object.__setattr__(self, "_code", variants.code(self.scheme))
        checks.one_of("observer", self.observer, (*OBSERVERS, "eso_printed"))
        checks.one_of("control", self.control, CONTROLS)
        checks.one_of("input", self.input, ("rigid_body", "torque"))
        checks.one_of("rules", self.rules, tuple(TABLES))
        checks.one_of("sign", self.sign, ("smooth", "hard"))
        self._check_adaptive()
        checks.integer("contact", self.contact, 0, "it is how many motors may fail at once; 0 judges no contacts", 2)
        checks.one_of("decision", self.decision, ("rule", "learned"))
        self._check_decision()
        checks.integer("order_a", self.order_a, 2, "a joint is a double integrator; 3 suits it at 1 kHz")
        checks.integer("order_b", self.order_b, 2, "a joint is a double integrator; 2 suits it at 1 kHz")
        checks.integer("alarm_ticks", self.alarm_ticks, 1, "1 alarms at once")
        checks.integer("release_ticks", self.release_ticks, 1, "1 releases at once")
        checks.integer("transient_ticks", self.transient_ticks, 0, "0 switches the sensor check off")

    def _check_adaptive(self) -> None:
        if not isinstance(self.adaptive, bool):
            raise ValueError(f"adaptive must be True or False, got {self.adaptive!r}")
        if not self.adaptive:
            return
        learns = getattr(variants.load(self.scheme), "LEARNS", False)
        if not learns or self.input != "rigid_body":
            raise ValueError(
                "adaptive needs a scheme that learns, the cascade, and input='rigid_body', which measure the torque that "
                f"the model lacks; got scheme={self.scheme!r}, input={self.input!r}"
            )

    def _check_decision(self) -> None:
        if self.decision == "rule":
            return
        staged = getattr(variants.load(self.scheme), "STAGED", False)
        if not staged or self.observer != "ts" or self.input != "rigid_body" or self.contact:
            raise ValueError(
                "decision='learned' was trained on the complete cascade: it needs a scheme of its stages, observer='ts', "
                "input='rigid_body' and contact=0, as contacts are judged from the rule's verdicts; "
                f"got {self.scheme!r}, {self.observer!r}, {self.input!r}, {self.contact}"
            )

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n

    @property
    def ticks(self) -> int:
        """Number of controller ticks in a simulation."""
        return checks.multiple("duration", self.duration or self.t_final, self.dt)

    @property
    def record(self) -> dict[str, Any]:
        """Every field but the robot, for files that say what ran; of a scheme of the user's a digest of its source, too."""
        names = [field.name for field in dataclasses.fields(self) if field.init and field.name != "robot"]
        source = variants.source(self.scheme)
        return {name: getattr(self, name) for name in names} | ({} if source is None else {"scheme_source": source})

    @property
    def inputs(self) -> int:
        """Input signals that reach each joint's ARX model."""
        return 1 if self.input == "rigid_body" else self.n
