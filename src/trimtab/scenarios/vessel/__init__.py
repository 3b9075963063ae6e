"""Scenarios of path following with a surface vessel with rudders and propellers."""
