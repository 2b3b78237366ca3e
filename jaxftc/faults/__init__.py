"""Faults and scenarios: data, so that one compiled program serves every kind."""
