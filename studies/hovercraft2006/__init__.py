"""Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.

The study's files cite it as [1]. They compare its tables, statements of its text and axis limits of its plots with
values computed by this package. Where the thesis prints nothing that can be compared, a row of basis "reference" is
computed from its equations and settings by tests/oracles/hovercraft.py, which shares no code with the package.
"""
