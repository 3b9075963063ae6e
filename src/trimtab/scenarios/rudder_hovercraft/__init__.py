"""Scenarios of a hovercraft as sold by model shops: one propeller that pushes forward only, and rudders."""
