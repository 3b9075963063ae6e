"""Scenarios of a car with a minimum turning radius."""
