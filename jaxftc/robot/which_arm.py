"""Which chain of a robot file is the arm.

Without ``tip``: from the base outward, past every joint that has to be welded (locked, mimic, sliding). Where the tree
forks into branches that move, the arm goes on into the one with the most hinges, if it has at least as many as there were
before the fork; branches with fewer are fingers, a head or wheels. Several branches with equally many are fingers, too,
or, with more hinges than came before, several arms, and ``tip`` must say which. With ``tip``, a link, site or joint, the
arm is the chain from the base to there.
"""

from __future__ import annotations

import difflib

from jaxftc.robot.tree import HINGE, SLIDE, Joint, Tree


class Ends:
    """Where the arm ends if nobody says it."""

    def __init__(self, tree: Tree, lock: dict[str, float]) -> None:
        self.tree, self.lock = tree, lock
        self.below: list[list[int]] = [[] for _ in tree.bodies]
        self.roots = [b for b, body in enumerate(tree.bodies) if body.parent < 0]
        for b, body in enumerate(tree.bodies):
            if body.parent >= 0:
                self.below[body.parent].append(b)
        self.own = [sum(self.counts(joint) for joint in body.joints) for body in tree.bodies]
        self.most = list(self.own)  # hinges of the longest chain from the body on, its own included
        self.moves = [bool(body.joints) for body in tree.bodies]
        for b in reversed(range(len(tree.bodies))):
            parent = tree.bodies[b].parent
            if parent >= 0:
                self.most[parent] = max(self.most[parent], self.own[parent] + self.most[b])
                self.moves[parent] |= self.moves[b]

    def counts(self, joint: Joint) -> bool:
        """Whether a joint can be one of the arm's."""
        return joint.kind == HINGE and joint.name not in self.lock and joint.follows is None

    def without_tip(self) -> int:
        """The last body of the arm that the rule picks."""
        return self._follow(self.roots, 0, -1)

    def _follow(self, branches: list[int], before: int, last: int) -> int:
        """The last body of the arm from a body ``last`` on, with ``before`` hinges up to it."""
        while True:
            moving = [b for b in branches if self.moves[b]]
            longest = max((self.most[b] for b in moving), default=0)
            best = [b for b in moving if self.most[b] == longest]
            if not longest or (len(moving) > 1 and longest < before) or (len(best) > 1 and longest == before):
                return last
            if len(best) > 1:
                ends = [self.tree.bodies[self._follow([b], before, last)].name for b in best]
                raise ValueError(
                    f"holds {len(best)} arms of equal length, to {', '.join(map(repr, ends))}; say which by its last link: "
                    f"tip={ends[0]!r}, or --tip {ends[0]}"
                )
            last, before, branches = best[0], before + self.own[best[0]], self.below[best[0]]


def no_hinge(joints: dict[str, Joint], lock: dict[str, float]) -> str:
    """Why there is no arm, in words."""
    if not joints:
        return "has no joint; a serial arm of at least one hinge is needed"
    left = [f"{j.name!r} ({'locked' if j.name in lock else 'mimic' if j.follows else j.kind})" for j in joints.values()]
    return f"has no free hinge; only hinges are supported, and its joints are {', '.join(left[:8])}"


def tip_body(tree: Tree, tip: str) -> int:
    """The body of a link, site or joint, or a refusal with the names that are near."""
    names = {joint.name: b for b, body in enumerate(tree.bodies) for joint in body.joints}
    names |= {name: at.body for name, at in tree.sites.items()} | {body.name: b for b, body in enumerate(tree.bodies)}
    there("link, site or joint", tip, list(names))
    return names[tip]


def there(what: str, name: str, names: list[str]) -> None:
    """Refuse a name that is not there, with those that were probably meant; a large robot has hundreds."""
    if name not in names:
        near = difflib.get_close_matches(name, names, n=3, cutoff=0.4) or names[-3:]
        raise ValueError(f"has no {what} {name!r}; did you mean {' or '.join(map(repr, near))}?")


def path(tree: Tree, b: int) -> list[int]:
    """The bodies from the base to one, both included."""
    found: list[int] = []
    while b >= 0:
        found.append(b)
        b = tree.bodies[b].parent
    return found[::-1]


def refuse_within(tree: Tree, path: list[int], arm: list[Joint], lock: dict[str, float]) -> None:
    """Refuse what the arm itself cannot have: springs, and between its hinges joints that are no hinges."""
    begun, left = False, {joint.name for joint in arm}
    for b in path:
        body = tree.bodies[b]
        for joint in body.joints:
            if joint.name in left:
                begun = True
                left.discard(joint.name)
                if joint.spring:
                    raise ValueError(
                        f"joint {joint.name!r} has a spring (stiffness), which is not modelled here; remove it, or add its "
                        "torque to the command"
                    )
            elif joint.name not in lock and joint.kind != HINGE and (joint.kind != SLIDE or (begun and left)):
                raise ValueError(
                    f"joint {joint.name!r} is a {joint.kind} joint; only hinges are supported, so weld it: "
                    f"lock={{{joint.name!r}: 0.0}}, or --lock {joint.name}=0"
                )
        if begun and body.gravcomp:
            raise ValueError(
                f"body {body.name!r} has gravcomp, which is not modelled here; remove it, or add its torque to the command"
            )
