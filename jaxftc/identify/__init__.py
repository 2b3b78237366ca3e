"""Identification of the ARX-Laguerre read-out (kappa_a, kappa_b, offset) from a log, Eqs. (4), (5), block 1.

A log is recorded angles and commanded torques (``log``). The banks' poles stay as given, so the model is linear in its
read-out (``readout``), which comes by batch least squares (``batch``), by recursive least squares with forgetting
(``recursive``), or by the simulation error over many ticks (``multistep``), where every model is judged too.

Which to take: ``fit_batch`` costs nothing and is a good start. Encoder noise in its regressors biases it, though, so its
model runs away when left alone; ``fit_multistep`` with the horizon that matters, the whole log for a model that is to run
alone, mends that. Angles are in rad, torques in N m, and the work is done in float64 whatever JAX is set to.
"""

from jaxftc.identify.batch import fit_batch as fit_batch
from jaxftc.identify.log import Log as Log
from jaxftc.identify.log import from_trace as from_trace
from jaxftc.identify.log import model_input as model_input
from jaxftc.identify.multistep import Errors as Errors
from jaxftc.identify.multistep import Size as Size
from jaxftc.identify.multistep import errors as errors
from jaxftc.identify.multistep import fit_multistep as fit_multistep
from jaxftc.identify.readout import features as features
from jaxftc.identify.readout import regressors as regressors
from jaxftc.identify.readout import with_kappa as with_kappa
from jaxftc.identify.recursive import RlsState as RlsState
from jaxftc.identify.recursive import rls_init as rls_init
from jaxftc.identify.recursive import rls_step as rls_step
