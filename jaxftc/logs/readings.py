"""What is wrong with angles as they were read: degrees, wraps, rows of another message."""

from __future__ import annotations

import numpy as np

from jaxftc.robot.model import Robot

TURN = 2 * np.pi
FAST, JUMP = 30.0, 0.5  # rad/s and rad between two rows that no joint makes
NEAR = 0.3  # rad, of a whole turn, that still pass as a wrap
MOST_TURNS = 2  # at once
BRIEF, BEYOND = 2, 100.0  # rows of one joint with a number that is no angle; rad, where the model has no limits
STRONG = 20.0  # times the limit, that no torque is
TURNS = 0.05  # rad, by which a joint surely turns
SLOW = 0.02  # rad/s; slower joints say nothing of the time
FAR = 20.0  # rad; three turns and more are degrees where the model has no limits


def in_degrees(robot: Robot, q: np.ndarray) -> str | None:
    """Why the angles [T, n] must be degrees, or None."""
    size = np.nanmax(np.abs(q), axis=0)
    ranges = _ranges(robot)
    beyond = size > np.maximum(1.5 * ranges, TURN + 0.5)
    if beyond.any() and (np.deg2rad(size) <= 1.1 * ranges).all():
        j = int((size / ranges).argmax())
        alone = beyond.sum() == 1 and ((np.ptp(q, axis=0) > TURNS) & ~beyond).any()
        only = "; no other joint shows it, so name the units in the head if they differ" if alone else ""
        return f"joint {j + 1} ({robot.joint_names[j]}) reaches {size[j]:.4g}, its range ends at {ranges[j]:.3g} rad{only}"
    if not np.isfinite(ranges).any() and size.max() > FAR:
        return f"joint {size.argmax() + 1} reaches {size.max():.4g}"
    return None


def _ranges(robot: Robot) -> np.ndarray:
    return np.maximum(np.abs(robot.q_low), np.abs(robot.q_high))


def no_angles(robot: Robot, q: np.ndarray) -> str | None:
    """Why most of a joint's numbers [T, n] cannot be rad, or None."""
    size, ranges = np.nanquantile(np.abs(q), 0.5, axis=0), _ranges(robot)
    beyond = np.flatnonzero(size > 2 * ranges + 2 * TURN)
    if not len(beyond):
        return None
    j = beyond[0]
    return (
        f"angles of joint {j + 1} ({robot.joint_names[j]}) are {size[j]:.4g} and more in half of the rows, its range ends "
        f"at {ranges[j]:.3g} rad: counts, milliradians, or the motor's side of the gear? Turn them into rad, or name their "
        "unit in the head, such as q1 [mrad]"
    )


def no_readings(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Rows and joints [T, n] of numbers such as -999 that stand for a reading that was lost: far off, for a row or two."""
    ranges = _ranges(robot)
    far = np.abs(q) > np.where(np.isfinite(ranges), ranges + 2 * TURN, BEYOND)
    far &= far.sum(1, keepdims=True) == 1  # several at once are rows of something else
    for j in np.flatnonzero(far.any(0)):
        edges = np.flatnonzero(np.diff(np.r_[False, far[:, j], False]))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if stop - start > BRIEF or np.ptp(np.r_[q[max(start - 1, 0), j], q[min(stop, len(q) - 1), j]]) > JUMP:
                far[start:stop, j] = False
    return far


def still(robot: Robot, q: np.ndarray) -> list[str]:
    """A line for each joint whose angle [T, n] never changes while another turns."""
    travel = np.ptp(q, axis=0)
    return [
        f"joint {j + 1} ({robot.joint_names[j]}) reads {q[0, j]:.4g} rad in every row: it stood still, or its column is dead"
        for j in np.flatnonzero(travel == 0)
        if travel.max() > TURNS
    ]


def no_torques(tau: np.ndarray, limit: np.ndarray) -> str | None:
    """Why most of the numbers [T, n] cannot be N m, or None."""
    size = np.nanquantile(np.abs(tau), 0.5, axis=0)
    beyond = np.flatnonzero(size > STRONG * np.where(limit > 0, limit, np.inf))
    if not len(beyond):
        return None
    j = beyond[0]
    return (
        f"torques of joint {j + 1} are {size[j]:.4g} and more in half of the rows, its limit is {limit[j]:.4g} N m: another "
        "unit? Name it in the head, such as tau1 [mNm], or give --torque-per-ampere"
    )


def timing_error(q: np.ndarray, dt: float) -> float:
    """Standard deviation in s of the time at which angles [T, n] were read, every ``dt`` if it is 0.

    A reading that comes late is off by its joint's speed. Fourth differences leave little of the motion itself.
    """
    error = np.abs(np.diff(q, 4, axis=0)) / np.sqrt(70)
    speed = np.abs(q[4:] - q[:-4]) / (4 * dt)
    moving = speed > SLOW
    return 1.4826 * float(np.median(error[moving] / speed[moving])) if moving.any() else 0.0


def unwrapped(t: np.ndarray, q: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Angles [T, n] without steps of whole turns, within segments."""
    steps = np.diff(q, axis=0)
    turns = np.round(steps / TURN)
    wraps = (turns != 0) & (np.abs(turns) <= MOST_TURNS) & (np.abs(steps - TURN * turns) < NEAR)
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
    strong = np.zeros(q.shape, bool) if tau is None else np.abs(tau) > STRONG * np.where(limit > 0, limit, np.inf)
    forced = strong.sum(1) > 1
    if not wild.any() and not forced.any():
        return None
    first, last = np.flatnonzero(wild | forced)[[0, -1]]
    if tau is not None and forced[first] and not wild[first]:
        j = int(np.flatnonzero(strong[first])[0])
        what = (
            f"column of torque {j + 1}: {tau[first, j]:.6g} N m, the limit is {limit[j]:.4g} N m, and other joints exceed "
            f"theirs with it; {(wild | forced).sum()} such rows, the last is row {rows[last] + 1}: "
        )
        rest = "another unit, or no readings of this arm; name the unit in the head, such as tau1 [mNm], or cut them out"
    else:
        j = int(steps[max(first - 1, 0)].argmax())
        what = (
            f"column of joint {j + 1}: {q[first, j]:.6g} rad after {q[max(first - 1, 0), j]:.6g} rad, and other joints jump "
            f"with it; {(wild | forced).sum()} such rows, the last is row {rows[last] + 1}: "
        )
        rest = "they are no readings of this arm, so cut them out of the file"
    return f"row {rows[first] + 1}, {what}{rest}"
