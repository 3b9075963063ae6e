"""Scenarios of depth and heading control of an underwater vehicle with fins and a propeller."""
