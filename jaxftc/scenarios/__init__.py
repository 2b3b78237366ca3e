"""What happens in a run, as data: faults, motions, and how presets draw them."""
