"""Error of ultrasonic ranges off the beacon's axis, table 5.2.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 5.5.4.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from trimtab.environment.acoustics import LINEAR, QUADRATIC, fit_range_ratio, range_ratio
from trimtab.estimators.ranging.range_model import compensate_range
from trimtab.study import Row, within

SECTION = "5.5.4"
PLACE = "[1] table 5.2"
HEIGHT = 270.48
"""Of the beacon (cm)."""


class CalibrationRow(NamedTuple):
    """A row of [1] table 5.2: angle (deg), true and measured range (cm), their ratio."""

    angle: float
    true_range: float
    measured: float
    ratio: float


TABLE_5_2 = (
    CalibrationRow(0, 270.48, 270.48, 1.0),
    CalibrationRow(10, 274.65, 274.83, 0.99935),
    CalibrationRow(20, 287.84, 288.83, 0.99657),
    CalibrationRow(30, 312.32, 315.07, 0.99127),
    CalibrationRow(35, 330.20, 334.25, 0.98788),
)


def rows() -> Iterator[Row]:
    """The fit at each angle, the range that it gives back, and the fit made anew."""
    for row in TABLE_5_2:
        at = f"{row.angle:g}°"
        ratio = range_ratio(np.radians(row.angle))
        what = f"true over measured range, {at}"
        yield within(f"table-5.2/{row.angle:g}/ratio", what, row.ratio, ratio, PLACE, tolerance=1.2e-4)
        back, _, _ = compensate_range(np.array([row.measured / 100]), np.array([HEIGHT / 100]))
        yield within(
            f"table-5.2/{row.angle:g}/range",
            f"range compensated, {at}",
            row.true_range,
            100 * float(back[0]),
            PLACE,
            relative=1.6e-4,
            unit="cm",
        )
    table = np.array(TABLE_5_2)
    quadratic, linear = fit_range_ratio(np.radians(table[:, 0]), table[:, 3])
    text = "[1] section 5.5.4"
    yield within("fit/quadratic", "coefficient of the squared angle", QUADRATIC, quadratic, text, tolerance=5e-4)
    yield within("fit/linear", "coefficient of the angle", LINEAR, linear, text, tolerance=1e-4)
