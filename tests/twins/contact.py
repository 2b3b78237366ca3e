"""The rule that tells a contact from motors' faults, one arm at a time, with the matrices written out."""

import itertools

import numpy as np


def frames(robot, q):
    """Origins, axes and ends [n, 3] of the links in the base frame."""
    rotation, origin, origins, axes = np.eye(3), np.zeros(3), [], []
    for link, angle in zip(robot.links, q - robot.q_zero, strict=True):
        c, s = np.cos(angle), np.sin(angle)
        origin = origin + rotation @ link.offset
        rotation = rotation @ link.rotation @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        origins.append(origin)
        axes.append(rotation[:, 2])
    return np.array(origins), np.array(axes), np.array([*origins[1:], origin + rotation @ robot.payload_link.moment])


def levers(robot, q, link):
    """[n, 6] torques of a unit force, and of a unit force at the link's reach, in the middle of a link from 1."""
    origins, axes, ends = frames(robot, q)
    middle = 0.5 * (origins[link - 1] + ends[link - 1])
    reach = 0.1 + 0.5 * np.linalg.norm(ends[link - 1] - origins[link - 1])
    rows = np.hstack([np.cross(axes, middle - origins), reach * axes])
    rows[link:] = 0
    return rows


def judge(robot, q, statistic, threshold, verdict, motors):
    """(verdict [n], force [n] N) for q, statistic, threshold and verdict [n]."""
    none = verdict, np.zeros(robot.n)
    x = statistic / threshold
    parts = np.flatnonzero((verdict & 1 > 0) & (np.abs(x) >= 0.1 * np.abs(x).max()))
    if (verdict & 2).any() or len(parts) <= motors:
        return none
    link = int(parts[-1]) + 1
    a = levers(robot, q, link) / threshold[:, None]
    k = 0.01 * np.trace(a @ a.T) / link
    weights = np.linalg.solve(a @ a.T + k * np.eye(robot.n), x)
    pull = a.T @ weights
    left = ((x - a @ pull) ** 2).sum()
    by_motors = min((np.delete(x, some) ** 2).sum() for some in itertools.combinations(range(robot.n), motors))
    if left > 0.5 * by_motors:
        return none
    force = np.zeros(robot.n)
    force[link - 1] = np.linalg.norm(pull[:3])
    return np.where(np.arange(robot.n) < link, 8, 0), force
