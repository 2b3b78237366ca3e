"""Fault-tolerant control, blocks 8 and 9."""
