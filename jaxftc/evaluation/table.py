"""Scores as columns, one row a scenario: what was wrong, what was said of it, how well the arm did.

Angles are in degrees here: people read these numbers, in Parquet files too. Times are multiples of the sample time.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxftc.config import Config
from jaxftc.evaluation.online import LEVELS, Score
from jaxftc.scenarios.contact import Contact, no_contact
from jaxftc.scenarios.faults import Actuator, Fault, Kind, Sensor
from jaxftc.scenarios.scenario import Scenario
from jaxftc.types import KINDS, Verdict

CROSSINGS = tuple(f"delay_at_{level:.3f}_s" for level in LEVELS)  # delays with all thresholds times LEVELS


def _names(kinds: type[Kind]) -> np.ndarray:
    """Names by number, none of them empty."""
    return np.array(["", *(k.name.lower() for k in kinds if k > 0)])


def _faults() -> np.ndarray:
    """Names [kind, actuator fault, encoder fault], such as ``both bias + drift``."""
    tau, q = _names(Actuator), _names(Sensor)
    return np.array([[[f"{v} {' + '.join(filter(None, (a, b)))}".strip() for b in q] for a in tau] for v in KINDS])


FAULTS = _faults()
NAMES = np.array([Verdict(k).label for k in range(2 * Verdict.CONTACT)])  # of verdicts


def columns(config: Config, scenarios: Scenario, score: Score) -> dict[str, np.ndarray]:
    """Columns [scenarios] from scenarios with a leading axis and scores [..., scenarios].

    A delay is infinite where the fault was missed and not a number where there was none to find. A run that diverged
    has infinite errors.
    """
    drawn = _Drawn(config, scenarios)
    crossings = {name: _since(config, drawn, score, at) for name, at in zip(CROSSINGS, score.crossed, strict=True)}
    return drawn.columns() | _diagnosis(config, drawn, score) | _motion(config, score) | crossings


class _Drawn:
    """The faults of each scenario, as drawn."""

    def __init__(self, config: Config, scenarios: Scenario) -> None:
        self.id = np.asarray(scenarios.id, np.int64)
        self.tau, self.q = _Channel(config, scenarios.fault_tau, Actuator), _Channel(config, scenarios.fault_q, Sensor)
        self.contact = _Contact(config, scenarios.contact or no_contact(self.id.shape))
        # [n, scenarios], the verdict that is right
        self.wanted = Verdict.ACTUATOR * self.tau.faulty | Verdict.SENSOR * self.q.faulty | self.contact.wanted
        self.healthy = ~(self.wanted > 0).any(0)  # [scenarios]
        self.clear = np.maximum(np.maximum(self.tau.last, self.q.last), self.contact.last)  # [scenarios] s, last clearance

    def columns(self) -> dict[str, np.ndarray]:
        """Faults by name, joint, size and time."""
        tau, q, contact, healthy = self.tau, self.q, self.contact, self.healthy
        wanted, has_tau, pushed = _either(self.wanted), tau.faulty.any(0), contact.wanted.any(0)
        kind = np.where(pushed, KINDS.index("contact"), wanted & Verdict.BOTH)

        def own(of_tau: Any, of_contact: Any, of_q: Any) -> np.ndarray:
            return np.where(has_tau, of_tau, np.where(pushed, of_contact, of_q))

        return {
            "scenario_id": self.id,
            "kind": np.asarray(KINDS)[kind],
            "fault": FAULTS[kind, tau.code, q.code],
            "fault_tau": tau.name,
            "fault_q": q.name,
            "law": np.where(healthy, "", own(tau.law, contact.law, q.law)),
            "joint_tau": tau.joint,
            "joint_q": q.joint,
            "magnitude_tau": tau.magnitude,
            "magnitude_q": q.magnitude,
            "magnitude": own(tau.magnitude, contact.force, q.magnitude),
            "unit": own(tau.unit, "N", q.unit),
            "onset_s": np.where(healthy, np.nan, np.minimum(np.minimum(tau.onset, q.onset), contact.onset)),
            "clear_s": np.where(healthy, np.nan, self.clear),
            "link": contact.link,
        }


def _diagnosis(config: Config, drawn: _Drawn, score: Score) -> dict[str, np.ndarray]:
    """What was said of it, and when."""
    dt, healthy, wanted = config.dt, drawn.healthy, drawn.wanted
    verdict, settled = np.asarray(score.verdict), np.asarray(score.settled)

    def since(at: Any) -> np.ndarray:
        return _since(config, drawn, score, at)

    detected = np.isfinite(score.alarm_at) & ~healthy
    goes = detected & (drawn.clear < (config.ticks - 1) * dt)
    recovery = np.maximum(_double(score.quiet_at) - np.where(goes, drawn.clear, 0.0) - dt, 0.0)
    return {
        "detected": detected,
        "delay_s": since(score.alarm_at),
        "isolated_s": since(score.isolated_at),
        "recovery_s": np.where(goes, recovery, np.nan),
        "kind_hat": NAMES[_either(verdict)],
        "joint_hat": _first(verdict > 0),
        "joint_tau_hat": _first(verdict & Verdict.ACTUATOR > 0),
        "joint_q_hat": _first(verdict & Verdict.SENSOR > 0),
        "link_hat": (verdict & Verdict.CONTACT > 0).sum(0),
        "force_hat_n": np.where(healthy, np.nan, _double(score.force)),
        **_right("right", verdict, wanted),
        "unsure": detected & np.asarray(score.unsure),
        **_right("visible", np.asarray(score.visible), wanted),
        "kind_hat_settled": NAMES[_either(settled)],
        **_right("right_settled", settled, wanted),
        "unsure_settled": detected & np.asarray(score.unsure_late),
        **_right("visible_settled", np.asarray(score.visible_late), wanted),
        "complete_s": since(score.complete_at),
        "visible_s": since(score.visible_at),
        "false_alarm": np.asarray(score.false_ticks) > 0,
        "false_ticks": np.asarray(score.false_ticks, np.int64),
        "false_events": np.asarray(score.false_events, np.int64),
        "false_alarm_s": np.where(np.isfinite(score.false_at), np.rint(_double(score.false_at) / dt) * dt, np.nan),
        "healthy_ratio": _error(score, _double(score.healthy_ratio)),
    }


def _motion(config: Config, score: Score) -> dict[str, np.ndarray]:
    """How well the arm did."""
    ticks, dt, n = config.ticks, config.dt, config.n

    def error(value: np.ndarray) -> np.ndarray:
        return _error(score, value)

    def rms(total: Any) -> np.ndarray:
        return error(np.sqrt(_double(total) / (ticks * n)))

    return {
        "fault_tau_rmse_nm": rms(score.se_tau),
        "fault_q_rmse_deg": np.rad2deg(rms(score.se_q)),
        "tracking_rmse_deg": np.rad2deg(rms(score.ise)),
        "tracking_max_deg": np.rad2deg(error(_double(score.track_max))),
        "tracking_ise_deg2s": error(np.rad2deg(np.rad2deg(_double(score.ise))) * dt),
        "tracking_iae_degs": error(np.rad2deg(_double(score.iae)) * dt),
        "tracking_itae_degs2": error(np.rad2deg(_double(score.itae)) * dt),
        "effort": rms(score.effort),
        "peak": error(_double(score.peak)),
        "saturated_share": _double(score.saturated) / (ticks * n),
        "chattering": error(_double(score.travel) / (n * ticks * dt)),
        "rough": rms(score.rough),
        "diverged": np.asarray(score.lost),
    }


def _since(config: Config, drawn: _Drawn, score: Score, at: Any) -> np.ndarray:
    """From the first tick of the fault, s."""
    with np.errstate(invalid="ignore"):
        found = np.where(np.isfinite(at), np.rint((_double(at) - score.began) / config.dt) * config.dt, np.inf)
    return np.where(drawn.healthy, np.nan, found)


def _error(score: Score, value: np.ndarray) -> np.ndarray:
    """Values [scenarios], infinite where the run diverged."""
    return np.where(np.asarray(score.lost) | ~np.isfinite(value), np.inf, value)


def _double(x: Any) -> np.ndarray:
    return np.asarray(x, np.float64)


def _either(verdict: np.ndarray) -> np.ndarray:
    """One verdict [scenarios] from those of the joints [n, scenarios]: both if both channels are named anywhere."""
    return np.bitwise_or.reduce(np.asarray(verdict, np.int64), axis=0)


def _right(name: str, verdict: np.ndarray, wanted: np.ndarray) -> dict[str, np.ndarray]:
    """Whether a verdict [n, scenarios] names the channels, the joints, and both for every joint."""
    found = {"kind": _either(verdict) == _either(wanted), "joint": ((verdict > 0) == (wanted > 0)).all(0)}
    return {f"{part}_{name}": right for part, right in (found | {"verdict": (verdict == wanted).all(0)}).items()}


def _law(rise: Any, period: Any) -> np.ndarray:
    """How faults come and go, by name."""
    slow, coming = np.asarray(rise) > 0, np.isfinite(np.asarray(period))
    return np.select([slow, coming], ["incipient", "intermittent"], "abrupt")


def _first(where: np.ndarray) -> np.ndarray:
    """Number of the first joint [scenarios] that is there [n, scenarios], from 1; 0 if there is none."""
    return np.where(where.any(0), where.argmax(0) + 1, 0)


class _Contact:
    """The force on each scenario's arm, as drawn, as columns."""

    def __init__(self, config: Config, contact: Contact) -> None:
        onset, size = np.asarray(contact.onset), _double(contact.size)
        begins = onset <= np.asarray((config.ticks - 1) * config.dt, onset.dtype)  # as in online.truth
        there = begins & (size > 0)
        self.link = np.where(there, np.asarray(contact.link, np.int64), 0)
        self.wanted = Verdict.CONTACT * (np.arange(1, config.n + 1)[:, None] <= self.link)  # [n, scenarios]
        self.force = np.where(there, size, np.nan)
        self.law = _law(contact.rise, contact.period)
        self.onset = np.where(there, _double(onset), np.inf)
        self.last = np.where(there, _double(contact.clear), -np.inf)


class _Channel:
    """Faults of one channel, [scenarios, n] as sampled, as columns; magnitude and law are the first faulty joint's."""

    def __init__(self, config: Config, fault: Fault, kinds: type[Kind]) -> None:
        onset = np.asarray(fault.onset)
        begins = onset <= np.asarray((config.ticks - 1) * config.dt, onset.dtype)  # as in online.truth
        kind = np.where(begins, np.asarray(fault.kind), 0).T
        self.faulty = kind > 0  # [n, scenarios]
        at = self.faulty.argmax(0)[None]

        def own(leaf: Any) -> np.ndarray:
            return np.take_along_axis(np.asarray(leaf).T, at, 0)[0]

        self.code, size = kind[at[0], np.arange(kind.shape[1])], _double(own(fault.magnitude))
        self.name = _names(kinds)[self.code]
        self.unit = np.array([kind.unit.replace("rad", "deg") for kind in kinds])[self.code]
        size = np.where(np.char.startswith(self.unit, "deg"), np.rad2deg(size), size)
        self.magnitude = np.where(self.unit == "", np.nan, size)
        self.joint = _first(self.faulty)
        self.law = _law(own(fault.rise), own(fault.period))
        self.onset = np.where(self.faulty, _double(fault.onset).T, np.inf).min(0)
        self.last = np.where(self.faulty, _double(fault.clear).T, -np.inf).max(0)
