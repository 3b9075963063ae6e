"""Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.

[1] in its files. Numbers of tables, statements of the text, and what the axes of its plots say, each beside what this
package computes. Where the source prints nothing that can be compared, a row of basis "reference" follows from its
printed equations and settings by tests/oracles/hovercraft.py, which shares no code with the package.
"""
