"""Flights of the hovercraft, with the settings of the thesis's tables."""
