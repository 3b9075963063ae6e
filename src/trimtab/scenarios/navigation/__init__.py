"""Scenarios of navigation alone: the thesis's rotating platform, flight on a figure eight, vehicle at rest."""
