"""The closed loop: plant, faults, encoder noise and the tick, as one scan."""
