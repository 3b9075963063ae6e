"""Scenarios that test navigation without control: rotating platform, flight on a figure eight, vehicle at rest."""
