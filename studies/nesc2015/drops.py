"""Falling balls: gravity, rotation, drag and wind, added one by one.

The earth is round or an ellipsoid, rotating or not. The air is still or moves.
"""

from collections.abc import Iterator
from pathlib import Path

from studies.nesc2015._rows import draw_cases, rows_of
from trimtab.study import Row

SECTION = "check-cases 1, 4, 5, 6, 7, 8"
CASES = ("01", "04", "05", "06", "07", "08")


def rows() -> Iterator[Row]:
    """Yield each signal against the band of NASA's simulations."""
    yield from rows_of(CASES)


def figures(folder: Path) -> Iterator[Path]:
    """Plot each case."""
    yield from draw_cases(folder, CASES)
