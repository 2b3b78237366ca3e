# The public names for type checkers; __init__.py loads them on first use.
from tuning.held_out import Comparison as Comparison
from tuning.held_out import compare as compare
from tuning.loop import Progress as Progress
from tuning.loop import Result as Result
from tuning.loop import fit as fit
from tuning.problem import Problem as Problem
from tuning.settings import Settings as Settings
from tuning.terms import OBJECTIVE as OBJECTIVE
from tuning.terms import Run as Run
from tuning.terms import Term as Term
from tuning.terms import alarms as alarms
from tuning.transform import tunable as tunable
