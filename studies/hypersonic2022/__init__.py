"""Flexible-state estimation and tracking of a hypersonic vehicle, Aerospace 2022, 9(4), 206, 10.3390/aerospace9040206.

The study's files cite it as [1]: "Angular-accelerometer-based flexible-state estimation and tracking controller design
for hypersonic flight vehicle". They compare its printed matrices, gain and settings with values computed by this
package. Its figures, commands and weights are not available. Rows of basis "reference" compare with tests/oracles, a
program of the corrected equations that shares no code with the package, under settings chosen here.
"""
