"""An F-16 in trim, and with its autopilot: height, speed, course, track, and circles where longitudes meet.

The autopilot uses the true state.
"""

from collections.abc import Iterator
from pathlib import Path

from studies.nesc2015._rows import draw_cases, rows_of
from trimtab.study import Row

SECTION = "check-cases 11, 12, 13.1 to 13.4, 15, 16"
CASES = ("11", "12", "13p1", "13p2", "13p3", "13p4", "15", "16")


def rows() -> Iterator[Row]:
    """Yield each signal against the band of NASA's simulations."""
    yield from rows_of(CASES)


def figures(folder: Path) -> Iterator[Path]:
    """Plot each case."""
    yield from draw_cases(folder, CASES)
