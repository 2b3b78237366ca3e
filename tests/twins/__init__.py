"""Plain NumPy twins of the controller: one robot, float64, the form that is most obviously right.

They are written from the equations alone and share no line with the package they check. Joints come first in every
array: [n] is one value a joint. Angles are rad, torques N m, times s; numbers of equations are those of the paper,
doi 10.3390/en12071281.

laguerre   Eqs. (4), (5)         banks, predictor, the exact predictor of a rigid joint
cascade    Eqs. (6) to (10), (13), (15)  one tick of the observer
threshold  Eqs. (14), (17), (18) statistic, alarm, verdict
fuzzy      Eqs. (32), (33), Table 1
control    Eqs. (19), (24), (30) SMC, ESMC, AFESMC
reference  Eqs. (34) to (36)
printed    what the paper prints where the modules above deviate from it
"""
