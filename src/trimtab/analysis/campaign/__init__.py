"""Campaigns: many runs of one scenario with varied parameters, the workers that fly them, and statistics."""
