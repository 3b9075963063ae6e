"""Programs that share no code with the package: the same publications computed again, dense and dumb, for comparison.

They use NumPy and SciPy alone, and are written from the corrected equations of the publications. What they give stands
in text tables beside the studies, where rows of basis "reference" read it; `python tests/oracles/write.py` writes these
tables anew, and tests compare.
"""
