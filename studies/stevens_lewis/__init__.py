"""Stevens, Lewis, Johnson, "Aircraft control and simulation": the F-16's printed numbers.

[1] is B. L. Stevens, F. L. Lewis, E. N. Johnson, 3rd ed., Wiley 2015, chapters 3 to 5: the check case of its program,
its trims, its linear models and its lateral regulator. [2] is P. Heidlauf, A. Collins, M. Bolender, S. Bak,
"Verification challenges in F-16 ground collision avoidance and other automated maneuvers", ARCH 2018, whose model is
that of [1], with its authors' programs AeroBenchVV: their gains and two of their flights.
"""
