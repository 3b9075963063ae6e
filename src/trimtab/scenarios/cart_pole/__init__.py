"""Scenarios of a pole on a cart."""
