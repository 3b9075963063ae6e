"""Flexible-state estimation and tracking of a hypersonic vehicle, Aerospace 2022, 9(4), 206, 10.3390/aerospace9040206.

[1] in its files: "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic
flight vehicle", doi 10.3390/aerospace9040206. Its printed matrices, gain and settings, each beside what this package
computes. Its figures, commands and weights are not to be had: rows of basis "reference" compare with tests/oracles, a
program of the corrected equations that shares no code with the package, under settings chosen here.
"""
