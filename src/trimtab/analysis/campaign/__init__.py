"""Campaigns: many runs of one scenario with varied parameters, their workers and their statistics."""
