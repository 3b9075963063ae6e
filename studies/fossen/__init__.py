"""Marine vehicles of Fossen's handbook and its sources, recomputed: REMUS, CyberShip II, the Mariner.

[1] T. Prestero, "Verification of a six-degree of freedom simulation model for the REMUS autonomous underwater vehicle",
MIT and WHOI, 2001. [2] R. Skjetne, Ø. N. Smogeli, T. I. Fossen, Modeling, Identification and Control 25 (2004) 3-27.
[3] T. I. Fossen, "Handbook of marine craft hydrodynamics and motion control". [4] M. S. Chislett, J. Strøm-Tejsen,
report Hy-5, Lyngby, 1965. Printed values are from public transcriptions, two at least for each coefficient.
"""
