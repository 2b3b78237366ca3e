"""Benchmarks: what a user would otherwise pick, side by side in one run. Runs from a checkout or an editable install."""
