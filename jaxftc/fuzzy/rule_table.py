"""Table 1: the switching gain's rule base, as printed and mended, and its inference, Eqs. (32), (33).

Rows are joint position NB to PB, columns the sliding surface NB to PB, entries the output set: 0 = PS, 1 = PM, 2 = PB.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxftc.fuzzy.membership import grades
from jaxftc.numerics.barrier import unstack
from jaxftc.types import Array

PRINTED = np.array(
    [
        [2, 2, 2, 2, 1, 0, 0],
        [2, 2, 2, 1, 1, 0, 0],
        [2, 2, 2, 1, 0, 0, 0],
        [2, 2, 1, 0, 0, 0, 0],
        [1, 0, 0, 0, 1, 2, 2],
        [0, 0, 1, 1, 2, 2, 2],
        [0, 0, 1, 2, 2, 2, 2],
    ]
)


def _symmetric() -> np.ndarray:
    """The printed table with rows NS, Z, PS mended, so that (-q, -s) gives what (q, s) gives.

    PS becomes the point reflection of NS. Z, which must mirror itself, keeps its printed half for s <= 0.
    """
    table = PRINTED.copy()
    table[4] = table[2][::-1]
    table[3, 4:] = table[3, 2::-1]
    return table


def _s_only() -> np.ndarray:
    """Gain by distance from the surface alone: the mended Z row in every row."""
    return np.tile(_symmetric()[3], (7, 1))


TABLES = {"printed": PRINTED, "symmetric": _symmetric(), "s_only": _s_only()}


def infer(
    table: np.ndarray, q: Array, s: Array, q_sets: tuple[Array, Array], s_sets: tuple[Array, Array], outputs: Array
) -> Array:
    """Centre average of the 49 rules, [n, ...], from q [n, ...] rad and s [n, ...] rad/s, Eq. (33).

    X in Eq. (33) is read as the centre of the output set (as printed, max of a grade, it is 1 whatever the rule says).
    Separable: for each q set the s grades are first added up by output level. The commonest level is what the others are
    taken from, so that its rules cost nothing.
    """
    q_grades, s_grades, values = grades(q, *q_sets), grades(s, *s_sets), unstack(outputs)
    common, *others = np.argsort(np.bincount(table.ravel(), minlength=len(values)))[::-1]
    total = jnp.zeros_like(q_grades[0])
    for level in others:
        weight = jnp.zeros_like(total)
        for row, grade in zip(table, q_grades, strict=True):
            members = np.flatnonzero(row == level)
            if len(members):
                weight = weight + grade * sum(s_grades[j] for j in members)
        total = total + (values[level] - values[common]) * weight
    return values[common] + total / (sum(q_grades) * sum(s_grades))
