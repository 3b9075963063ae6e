"""Consistency: accuracy of the covariance of a filter that was tuned on the other log.

Errors of one drive are correlated in time. So the 95 % band for the average over 9658 instants is that of the effective
number of independent draws (`trimtab.logs.consistency`), about a hundred.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from studies.ranges2009._data import NAMES
from studies.ranges2009._flights import CAUSAL, FILTERS, TAIL, fly
from studies.ranges2009._pictures import draw_errors
from trimtab.logs.navigation import assess_navigation
from trimtab.study import Row, at_most, band, direction

SECTION = "data sets, part 3"
PLACE = "[1] the data"
RARE = 13.816
"""99.9 % quantile of chi-square with two degrees of freedom."""
BACKWARDS = (
    "Overconfident for about ten seconds, twice: at 1406 s and 1928 s the vehicle backs up, and its unsigned odometry "
    "shows forward motion. The average cannot show this, because the filter is too cautious in between."
)


def rows() -> Iterator[Row]:
    """Yield the NEES of the position over the whole drive, the NIS of the ranges, and whiteness of the innovations."""
    for name in NAMES:
        for kind in FILTERS:
            flight = fly(name, kind)
            nees, what = flight.consistency(), f"{name}, {kind} filter"
            yield band(
                f"{name}/{kind}/nees", f"{what}: NEES of the position", 2.0, nees.mean, PLACE, low=nees.low,
                high=nees.high, basis="input", note=f"The drive has {nees.draws:.0f} effective draws.",
            )  # fmt: skip
            beyond = float(np.mean(np.sum(flight.normalised**2, axis=1) > RARE))
            yield at_most(
                f"{name}/{kind}/rare", f"{what}: share of instants beyond 99.9 % of chi-square", 0.001, beyond, PLACE,
                high=0.01, basis="input", must_hold=name == "Plaza2", note="" if name == "Plaza2" else BACKWARDS,
            )  # fmt: skip
            if kind not in CAUSAL:
                continue
            navigation = assess_navigation(flight.log, 1 - 2 * TAIL)
            assert navigation is not None
            ranges = navigation.aiding["range"]
            yield band(
                f"{name}/{kind}/nis", f"{what}: NIS of the ranges", 1.0, ranges.nis.mean, PLACE, low=ranges.nis.low,
                high=ranges.nis.high, basis="input",
            )  # fmt: skip
            yield direction(
                f"{name}/{kind}/white", f"{what}: innovations are white, p-value", "white", ranges.p, PLACE, above=TAIL,
                basis="input",
            )  # fmt: skip


def figures(folder: Path) -> Iterator[Path]:
    """Plot errors with three sigmas, NEES over time, and innovations."""
    for name in NAMES:
        for kind in FILTERS:
            yield draw_errors(folder / f"errors-{name}-{kind}.png", f"{name}, {kind} filter", fly(name, kind))
