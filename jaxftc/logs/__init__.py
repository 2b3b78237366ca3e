"""Recorded motions: read from files, checked, and diagnosed."""

from jaxftc.logs.diagnose import diagnose as diagnose
from jaxftc.logs.log import Log as Log
from jaxftc.logs.log import from_trace as from_trace
from jaxftc.logs.read import read as read
