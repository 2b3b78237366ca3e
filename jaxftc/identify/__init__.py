"""Models from logs: the arm's physical one (``dynamics``), and the ARX-Laguerre read-out of the paper's block 1.

``dynamics`` fits links, motor inertia, friction, torque offset and gain; ``judge`` says how well a model explains other
logs; ``link_torque`` and ``regressor`` are what it is made of. The rest finds the ARX-Laguerre read-out (kappa_a, kappa_b,
offset) from a log, Eqs. (4), (5), block 1.

A log is recorded angles and commanded torques (``log``). The banks' poles stay as given, so the model is linear in its
read-out (``readout``), which comes by batch least squares (``batch``), by recursive least squares with forgetting
(``recursive``), or by the simulation error over many ticks (``multistep``), where every model is judged too.

Which to take: ``fit_batch`` costs nothing and is a good start, but the encoder's noise in its regressors biases it, so its
model runs away when left alone. ``fit_multistep`` over the whole log mends that. Measured on the PUMA without dry friction,
encoder noise 3e-5 rad, one second of motion; largest error of any joint in deg, for one step, 50 steps and the free run:

===================== ==================== =======================
read-out              the motion fitted    another motion
===================== ==================== =======================
default (exact)       0.007 0.017 0.012    0.008 0.018 0.013
batch                 0.008 0.030 0.28     0.008 0.021 0.19
multistep, 50 ticks   0.010 0.016 0.58     0.014 0.013 0.55
multistep, whole log  0.007 0.018 0.007    0.008 0.016 0.012
torque form, batch    0.008 0.039 0.41     0.021 0.68  350
straight line         0.017 2.1            0.018 1.3
===================== ==================== =======================

Slower poles average the noise: at 0.95 batch reaches 0.03 deg in free run. What no linear read-out mends is a wrong arm:
with 2 % more mass and 10 % more damping, batch takes 50 steps from 0.37 to 0.04 deg, but the free run stays at 0.5 deg on
the motion fitted and 5 deg on another. The torque form knows its one motion only. Work is done in float64 whatever JAX is
set to; angles are in rad, torques in N m.
"""

from jaxftc.identify.batch import fit_batch as fit_batch
from jaxftc.identify.derivatives import Motion as Motion
from jaxftc.identify.derivatives import encoder as encoder
from jaxftc.identify.derivatives import motion as motion
from jaxftc.identify.linear_model import features as features
from jaxftc.identify.linear_model import regressors as regressors
from jaxftc.identify.linear_torque import link_torque as link_torque
from jaxftc.identify.linear_torque import regressor as regressor
from jaxftc.identify.multistep import Errors as Errors
from jaxftc.identify.multistep import Size as Size
from jaxftc.identify.multistep import errors as errors
from jaxftc.identify.multistep import fit_multistep as fit_multistep
from jaxftc.identify.multistep import predict as predict
from jaxftc.identify.physical import Identified as Identified
from jaxftc.identify.physical import Parameter as Parameter
from jaxftc.identify.physical import Share as Share
from jaxftc.identify.physical import dynamics as dynamics
from jaxftc.identify.physical import judge as judge
from jaxftc.identify.recursive import RlsState as RlsState
from jaxftc.identify.recursive import rls_init as rls_init
from jaxftc.identify.recursive import rls_step as rls_step
from jaxftc.logs.log import Log as Log
from jaxftc.logs.log import from_trace as from_trace
from jaxftc.logs.log import model_input as model_input
from jaxftc.observer.readout import with_kappa as with_kappa
