"""The tick without Python: as C99 and as StableHLO, written from the program that ``jaxftc.step`` traces to."""

from jaxftc.export.folder import write as write
from jaxftc.export.stablehlo import Loaded as Loaded
from jaxftc.export.stablehlo import load as load
