"""What is wrong with angles as they were read: degrees, wraps, rows of another message."""

from __future__ import annotations

import numpy as np

from jaxftc.robot.model import Robot

TURN = 2 * np.pi
FAST, JUMP = 30.0, 0.5  # rad/s and rad between two rows that no joint makes
NEAR = 0.3  # rad, of a whole turn, that still pass as a wrap
FAR = 20.0  # rad; three turns and more are degrees where the model has no limits


def in_degrees(robot: Robot, q: np.ndarray) -> str | None:
    """Why the angles [T, n] must be degrees, or None."""
    size = np.abs(q).max(0)
    ranges = np.maximum(np.abs(robot.q_low), np.abs(robot.q_high))
    beyond = size > np.maximum(1.5 * ranges, TURN + 0.5)
    if beyond.any() and (np.deg2rad(size) <= 1.1 * ranges).all():
        j = int((size / ranges).argmax())
        return f"joint {j + 1} ({robot.joint_names[j]}) reaches {size[j]:.4g}, its range ends at {ranges[j]:.3g} rad"
    if not np.isfinite(ranges).any() and size.max() > FAR:
        return f"joint {size.argmax() + 1} reaches {size.max():.4g}"
    return None


def unwrapped(t: np.ndarray, q: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Angles [T, n] without steps of whole turns, within segments."""
    steps = np.diff(q, axis=0)
    turns = np.round(steps / TURN)
    wraps = (turns != 0) & (np.abs(steps - TURN * turns) < NEAR)
    wraps[starts[1:] - 1] = False
    if not wraps.any():
        return q, []
    out = q.copy()
    out[1:] -= np.cumsum(np.where(wraps, TURN * turns, 0.0), axis=0)
    counts = [f"{wraps[:, j].sum()} in joint {j + 1}" for j in np.flatnonzero(wraps.any(0))]
    return out, [f"steps of a whole turn undone: {', '.join(counts)}"]


def other_rows(t: np.ndarray, q: np.ndarray, tau: np.ndarray | None, rows: np.ndarray, limit: np.ndarray) -> str | None:
    """What says that rows hold something else than readings of this arm, or None.

    One joint that jumps may be a faulty encoder, which is for the diagnosis. Two at once are not.
    """
    steps = np.abs(np.diff(q, axis=0))
    jumps = (steps > JUMP) & (steps > FAST * np.diff(t)[:, None])
    wild = np.zeros(len(t), bool)
    wild[1:] = jumps.sum(1) > 1
    if tau is not None:
        wild |= (np.abs(tau) > 20 * np.where(limit > 0, limit, np.inf)).sum(1) > 1
    if not wild.any():
        return None
    first, last = np.flatnonzero(wild)[[0, -1]]
    j = int(steps[max(first - 1, 0)].argmax())
    return (
        f"row {rows[first] + 1}, column of joint {j + 1}: {q[first, j]:.6g} rad after {q[max(first - 1, 0), j]:.6g} rad, "
        f"and other joints jump with it; {wild.sum()} such rows, the last is row {rows[last] + 1}: they are no readings of "
        "this arm, so cut them out of the file"
    )
