"""Fault diagnosis, blocks 5 to 7: residuals, thresholds, decision logic."""
