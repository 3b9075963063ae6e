"""Faults over a live pair: a vehicle and an autopilot, two processes, and between them a line that is ours to spoil."""
