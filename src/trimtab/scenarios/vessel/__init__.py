"""Scenarios of a surface vessel with rudders and propellers: path following."""
