"""Faults of a live pair: a vehicle and an autopilot as two processes, joined by a link that the study disturbs."""
