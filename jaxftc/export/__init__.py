"""The tick without Python: as C99 and as StableHLO, written from the program that ``jaxftc.step`` traces to."""
