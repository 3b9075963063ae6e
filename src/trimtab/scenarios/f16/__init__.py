"""Scenarios of the F-16."""
