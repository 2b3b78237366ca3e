"""``Config``: what is fixed before anything is traced. Frozen and hashable: a static argument of ``jax.jit``."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

from jaxftc import checks
from jaxftc.fuzzy.rule_table import TABLES
from jaxftc.robot.dynamics import ENGINES, Engine
from jaxftc.robot.model import Robot

Scheme = Literal["cascade", "momentum", "ekf", "computed_torque"]
Observer = Literal["pi", "eso", "ts", "eso_printed"]
Control = Literal["smc", "esmc", "afesmc"]
SCHEMES: tuple[str, ...] = ("cascade", "momentum", "ekf", "computed_torque")
OBSERVERS: tuple[str, ...] = ("pi", "eso", "ts")  # the paper's ranking; "eso_printed" is "eso" without its erratum mended
CONTROLS: tuple[str, ...] = ("smc", "esmc", "afesmc")
BY_TIME: Any = None  # a number of ticks that follows dt unless it is given
TIMES = {
    "alarm_ticks": (0.003, 2),
    "release_ticks": (0.01, 3),
    "transient_ticks": (0.06, 6),
}  # s, and at least so many ticks


@dataclasses.dataclass(frozen=True)
class Config:
    """Robot, structure and timing. Everything that tuning may change is in ``Gains`` instead.

    Raises:
        ValueError: a value is not allowed; the message says which are.
    """

    robot: Robot
    dt: float = 1e-3  # s, sample time
    t_final: float = 1.0  # s, end of the motion, t_f of Eq. (35); a multiple of dt
    duration: float | None = None  # s, length of a simulation, a multiple of dt; t_final if None
    engine: Engine = "mjx"  # plant dynamics
    scheme: Scheme = "cascade"  # the paper's observer and controller, or a baseline in their place (jaxftc/baselines)
    observer: Observer = "ts"  # how much of the cascade runs: block 2, blocks 2 and 3 (Eq. (7) mended or printed), 2 to 4
    control: Control = "afesmc"  # Eq. (19), (24) or (30)
    order_a: int = 3  # Laguerre functions on the output
    order_b: int = 2  # Laguerre functions on the input
    input: Literal["rigid_body", "torque"] = "rigid_body"  # what drives the ARX model
    rules: Literal["printed", "symmetric", "s_only"] = "printed"  # Table 1 as printed, or its mended forms
    sign: Literal["smooth", "hard"] = "smooth"  # tanh(x / eps), or the printed sgn
    alarm_ticks: int = BY_TIME  # ticks above threshold before a torque alarm, 3 ms; a jump alarms at once
    release_ticks: int = BY_TIME  # ticks below the release level before an alarm ends, 10 ms
    transient_ticks: int = BY_TIME  # a torque alarm that ends sooner, in 60 ms, was a velocity transient of the reading

    def __post_init__(self) -> None:
        if not isinstance(self.robot, Robot):
            raise ValueError(f"robot must be a Robot, got {type(self.robot).__name__}; call puma560() or load_robot(path)")
        checks.positive("dt", self.dt, "seconds")
        for name, (seconds, least) in TIMES.items():
            if getattr(self, name) is BY_TIME:
                object.__setattr__(self, name, max(least, round(seconds / self.dt)))
        checks.positive("t_final", self.t_final, "seconds")
        checks.multiple("t_final", self.t_final, self.dt)
        if self.duration is not None:
            checks.positive("duration", self.duration, "seconds")
            checks.multiple("duration", self.duration, self.dt)
        checks.one_of("engine", self.engine, ENGINES)
        checks.one_of("scheme", self.scheme, SCHEMES)
        checks.one_of("observer", self.observer, (*OBSERVERS, "eso_printed"))
        checks.one_of("control", self.control, CONTROLS)
        checks.one_of("input", self.input, ("rigid_body", "torque"))
        checks.one_of("rules", self.rules, tuple(TABLES))
        checks.one_of("sign", self.sign, ("smooth", "hard"))
        checks.integer("order_a", self.order_a, 2, "a joint is a double integrator; 3 suits it at 1 kHz")
        checks.integer("order_b", self.order_b, 2, "a joint is a double integrator; 2 suits it at 1 kHz")
        checks.integer("alarm_ticks", self.alarm_ticks, 1, "1 alarms at once")
        checks.integer("release_ticks", self.release_ticks, 1, "1 releases at once")
        checks.integer("transient_ticks", self.transient_ticks, 0, "0 switches the sensor check off")

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n

    @property
    def ticks(self) -> int:
        """Number of controller ticks in a simulation."""
        return checks.multiple("duration", self.duration or self.t_final, self.dt)

    @property
    def inputs(self) -> int:
        """Input signals that reach each joint's ARX model."""
        return 1 if self.input == "rigid_body" else self.n
