"""Scenarios of an underwater vehicle with fins and a propeller: control of depth and heading."""
