"""Balls shot from the sea: eastward and northward.

The earth's rotation deflects the northward shot.
"""

from collections.abc import Iterator
from pathlib import Path

from studies.nesc2015._rows import draw_cases, rows_of
from trimtab.study import Row

SECTION = "check-cases 9, 10"
CASES = ("09", "10")


def rows() -> Iterator[Row]:
    """Yield each signal against the band of NASA's simulations."""
    yield from rows_of(CASES)


def figures(folder: Path) -> Iterator[Path]:
    """Plot each case."""
    yield from draw_cases(folder, CASES)
