"""Words of columns: what loggers call angles, torques, currents and times, and what they put before or behind that."""

from __future__ import annotations

import re

ANGLE = tuple(
    [
        "q",
        "y",
        "actualq",
        "stateq",
        "qactual",
        "measuredq",
        "qmeas",
        "qpos",
        "position",
        "positions",
        "pos",
        "jointposition",
        "jointpositions",
        "jointpos",
        "jointangle",
        "angle",
        "theta",
        "actualposition",
        "presentposition",
        "observationstate",
        "angles",
        "jointangles",
        "qmeasured",
        "qmsr",
        "rax",
        "robax",
    ]
)
TORQUE = tuple(
    [
        "tau",
        "torque",
        "effort",
        "efforts",
        "tauj",
        "statetauj",
        "taumeasured",
        "actualtau",
        "actualtorque",
        "jointtorque",
        "jointtorques",
        "jointeffort",
        "actualjointtorques",
        "measuredtorque",
        "observationeffort",
        "observationtorque",
        "presenttorque",
        "torques",
        "moment",
        "moments",
    ]
)
CURRENT = tuple(
    [
        "actualcurrent",
        "current",
        "i",
        "currents",
        "jointcurrent",
        "motorcurrent",
        "presentcurrent",
        "measuredcurrent",
        "observationcurrent",
        "load",
        "presentload",
    ]
)
TIME = tuple(
    [
        "t",
        "time",
        "timestamp",
        "stamp",
        "seconds",
        "headerstamp",
        "times",
        "timestamps",
        "datetime",
        "elapsed",
        "elapsedtime",
        "timeelapsed",
        "simtime",
        "robottime",
        "rostime",
        "logtime",
        "unixtime",
        "systemtime",
        "epoch",
    ]
)
WANTED = re.compile(r"target|desired|command|cmd|goal|reference|setpoint|(^|[^a-z])ref([^a-z]|$)", re.IGNORECASE)
PARTIAL = re.compile(r"ext|frict|grav|coriolis|contact|err|lim|max|min", re.IGNORECASE)  # no whole torque or angle
BESIDE = frozenset(  # says nothing of the quantity
    [
        "joint",
        "joints",
        "axis",
        "actuator",
        "actuators",
        "actual",
        "act",
        "measured",
        "meas",
        "msr",
        "present",
        "state",
        "states",
        "feedback",
        "fbk",
        "robot",
        "arm",
    ]
)
_PARTS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")


def core(path: str) -> str:
    """A name less the words that say nothing of the quantity, in lower case: ``measuredJointPosition`` is ``position``."""
    return "".join(part for part in map(str.lower, _PARTS.findall(path)) if part not in BESIDE)
