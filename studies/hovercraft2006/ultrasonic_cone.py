"""Ultrasonic ranges off the beacon's axis, table 5.2, and fixes at rest, figure 5.8.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, sections
5.5.3 and 5.5.4.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from studies.hovercraft2006._pictures import Panel, draw_panels
from trimtab.environment.acoustics import fit_range_ratio, range_ratio
from trimtab.estimators.ranging.multilateration import solve_bancroft
from trimtab.estimators.ranging.range_model import compensate_range
from trimtab.sensors.time_of_flight import CEILING_SQUARE, RangeErrors
from trimtab.study import Row, within

SECTION = "5.5.4"
PLACE = "[1] table 5.2"
HEIGHT = 270.48
"""Height of the beacon (cm)."""


class CalibrationRow(NamedTuple):
    """Row of [1] table 5.2: angle (deg), true and measured range (cm), their ratio."""

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
    """Yield rows on the fit at each angle, the range compensated with it, and a new fit to the table's data."""
    for row in TABLE_5_2[1:]:  # at 0°, the ratio is 1 and the range is the height by definition
        at = f"{row.angle:g}°"
        ratio = range_ratio(np.radians(row.angle))
        what = f"true range divided by measured range, {at}"
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
    yield within("fit/quadratic", "coefficient of the squared angle", -0.038, quadratic, text, tolerance=5e-4)
    yield within("fit/linear", "coefficient of the angle", 0.0032, linear, text, tolerance=1e-4)
    circle = float(np.median(np.hypot(*_fix_at_rest().T)))
    note = (
        "The range noise was chosen to match this. The text says half of the ranges, but must mean positions (errata)."
    )
    what = "radius that contains half of the fixes at rest"
    given: dict[str, Any] = {"unit": "cm", "basis": "input", "note": note}
    yield within("fig-5.8/circle", what, 0.52, circle, "[1] fig. 5.8", tolerance=0.05, **given)


def _fix_at_rest() -> Any:
    """Return the errors (cm) of 20 000 fixes midway between four beacons, (runs, 2)."""
    plan, height = CEILING_SQUARE[:, :2], -CEILING_SQUARE[:, 2]
    noise = np.random.default_rng(0).normal(0, RangeErrors().noise, (20_000, 4))
    ranges = np.sqrt((plan**2).sum(axis=1) + height**2) + noise
    used = np.ones(4, bool)
    return 100 * np.asarray(jax.jit(jax.vmap(lambda r: solve_bancroft(plan, height, r, used).place))(ranges))


def figures(folder: Path) -> Iterator[Path]:
    """Plot figure 5.8, fixes at rest, and table 5.2."""
    angle = np.linspace(0, 45, 91)
    printed = np.array(TABLE_5_2)
    curves = (angle, range_ratio(np.radians(angle)), "fit", "-"), (printed[:, 0], printed[:, 3], "table 5.2", "o")
    panel = Panel("", "angle off the axis (deg)", "true range divided by measured range", curves)
    yield draw_panels(folder / "table-5.2.png", "[1] table 5.2: error of ranges", [panel])
    fixes, turn = _fix_at_rest()[:500], np.linspace(0, 2 * np.pi, 100)
    circle = (0.52 * np.cos(turn), 0.52 * np.sin(turn), "0.52 cm", "-")
    curves = (fixes[:, 1], fixes[:, 0], "500 fixes", "."), circle
    panel = Panel("", "east (cm)", "north (cm)", curves, equal=True)
    yield draw_panels(folder / "fig-5.8.png", "[1] fig. 5.8: fixes at rest", [panel])
