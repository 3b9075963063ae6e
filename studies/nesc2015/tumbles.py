"""A brick that tumbles: torque-free, and damped by the air.

The damped brick comes to rest.
"""

from collections.abc import Iterator
from pathlib import Path

from studies.nesc2015._rows import draw_cases, rows_of
from trimtab.study import Row

SECTION = "check-cases 2, 3"
CASES = ("02", "03")


def rows() -> Iterator[Row]:
    """Yield each signal against the band of NASA's simulations."""
    yield from rows_of(CASES)


def figures(folder: Path) -> Iterator[Path]:
    """Plot each case."""
    yield from draw_cases(folder, CASES)
