"""The fault library without our loop: any simulator's commands and readings, with JAX, NumPy or as a gymnasium wrapper."""

from jaxftc.faults.inject import Faults as Faults
from jaxftc.faults.inject import Injector as Injector
from jaxftc.faults.inject import deliver as deliver
from jaxftc.faults.inject import healthy as healthy
from jaxftc.faults.inject import init as init
from jaxftc.faults.inject import read as read
from jaxftc.scenarios.faults import Actuator as Actuator
from jaxftc.scenarios.faults import Fault as Fault
from jaxftc.scenarios.faults import Sensor as Sensor
