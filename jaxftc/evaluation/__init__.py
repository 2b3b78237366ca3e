"""Figures of merit: of a trace, kept online, and of many runs with their intervals."""
