"""The page of a diagnosed recording: events, and the residuals that they come from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxftc.report.figures import COLOURS, Panel, finish, together
from jaxftc.report.page import embed, notes, page, table

POINTS = 2000  # blocks that a curve is kept in, at most


class Envelope:
    """Least and largest of a signal [T, n] in blocks of equal length, in memory that does not grow."""

    def __init__(self) -> None:
        self.size = 1  # ticks of a block
        self.low: list[np.ndarray] = []
        self.high: list[np.ndarray] = []
        self._rest: np.ndarray | None = None

    def add(self, signal: np.ndarray) -> None:
        """More ticks."""
        rest = signal if self._rest is None else np.concatenate([self._rest, signal])
        count = len(rest) // self.size
        blocks = rest[: count * self.size].reshape(count, self.size, *rest.shape[1:])  # none, of fewer ticks than a block
        self.low += [*blocks.min(1)]
        self.high += [*blocks.max(1)]
        self._rest = rest[count * self.size :]
        while len(self.low) > POINTS:
            if len(self.low) % 2:
                self.low.append(self.low[-1])
                self.high.append(self.high[-1])
            self.low = [np.minimum(a, b) for a, b in zip(self.low[::2], self.low[1::2], strict=True)]
            self.high = [np.maximum(a, b) for a, b in zip(self.high[::2], self.high[1::2], strict=True)]
            self.size *= 2

    @property
    def curve(self) -> np.ndarray:
        """Low and high of each block in turn, [2 blocks, n]."""
        return np.stack([self.low, self.high], axis=1).reshape(2 * len(self.low), -1)


def diagnosis_page(title: str, record: dict[str, Any], curves: dict[str, Envelope], levels: dict[str, np.ndarray],
                   joints: tuple[str, ...], remarks: tuple[str, ...],
                   ran: Mapping[str, Any]) -> str:  # fmt: skip
    """Timeline over the residuals; ``curves`` (of t in s, too) and ``levels`` by channel: tau in N m, q in rad."""
    tau, q = curves["tau"].curve, np.rad2deg(curves["q"].curve)
    duration = max(record["duration_s"], record["sample_time_s"])
    panels = [
        Panel("S, torque, N m", {"": (tau, {})}, levels["tau"]),
        Panel("encoder fault, deg", {"": (q, {})}, np.rad2deg(levels["q"])),
    ]
    figure = together(curves["t"].curve[:, 0], panels, joints)
    for event in record["events"]:
        colour = COLOURS[(event["joint"] - 1) % len(COLOURS)]
        figure.add_vrect(x0=event["start_s"], x1=event["end_s"], fillcolor=colour, opacity=0.2, line_width=0, layer="below")
    note = "Shaded in the joint's colour: its events. Dashed: thresholds. Curves go between their least and largest values."
    finish(figure, "Residuals and events", note, panels=2, together=True)
    rows = [
        [f"{e['start_s']:.2f}", f"{e['end_s']:.2f}", e["joint_name"], e["kind"], f"{e['size']:.3g} {e['unit']}"]
        for e in record["events"]
    ]
    said = (
        table(["start", "end", "joint", "kind", "size"], rows, units=["s", "s", "", "", ""], text=0)
        if rows
        else "<p>No event.</p>"
    )
    share = f"{duration:.4g} s, alarm in {100 * record['alarm_share']:.3g} % of the ticks, "
    share += f"{record['glitches']} glitches (shorter than an event)."
    return page(title, ["<h2>Events</h2>", notes([share]), said, notes(remarks), embed(figure)], joints, ran)
