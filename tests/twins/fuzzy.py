"""Fuzzy gain alpha_online, Eqs. (32), (33) and Table 1."""

import numpy as np

from .cascade import gaussian

Array = np.ndarray

# Output level of a rule: 0 = PS, 1 = PM, 2 = PB. Rows joint position NB, NM, NS, Z, PS, PM, PB; columns surface alike.
TABLE_1 = np.array(
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


def alpha_online(
    q: float,
    s: float,
    q_centres: Array,
    q_widths: Array,
    s_centres: Array,
    s_widths: Array,
    outputs: Array,
    table: Array = TABLE_1,
) -> float:
    """Gain factor of one joint, unitless, Eq. (33): weighted mean of the output centres over the 49 rules.

    q and its centres [7], widths [7] share a unit, s and its own likewise; outputs [3] are the centres of PS, PM, PB.
    Both inputs saturate at their outer centres: beyond them every grade would fade and the quotient become 0 / 0.
    """
    q = min(max(q, q_centres[0]), q_centres[-1])
    s = min(max(s, s_centres[0]), s_centres[-1])
    numerator = 0.0
    denominator = 0.0
    for row in range(7):
        for column in range(7):
            weight = gaussian(q, q_centres[row], q_widths[row]) * gaussian(s, s_centres[column], s_widths[column])
            numerator += weight * outputs[table[row, column]]
            denominator += weight
    return float(numerator / denominator)
