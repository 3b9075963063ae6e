"""Rudder and thrust: calibration and lookup tables.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 4.2.
"""

from collections.abc import Iterator

import jax
import numpy as np

from trimtab.actuators.lookup import BilinearTable, forward_speed_table, full_speed_table, thrust_table
from trimtab.actuators.rudder import DEG, RudderGeometry, RudderServo
from trimtab.actuators.thruster import Thruster
from trimtab.core.record import to_arrays
from trimtab.study import Row, inside, same, within

SECTION = "4.2"
RATIO = {6: 0.2313, 8: 0.3685, 10: 0.4304, 12: 0.4638}
"""Speed in krpm -> the cubic of [1] eq. 4.4 evaluated by hand."""
ROUND_TRIPS = 20_000


def rows() -> Iterator[Row]:
    """Rudder geometry, thrust law, table shapes, and the two tables in series."""
    yield from _rudder()
    yield from _thrust()
    yield from _tables()


def _rudder() -> Iterator[Row]:
    geometry = RudderGeometry()
    points = len(np.asarray(RudderServo().angles))
    yield same("servo/points", "points of the servo map, 1 to 2 ms in 50 µs", 21, points, "[1] fig. 4.2")
    for trial, psi, theta in ((1, 14.6, -20.0), (2, -17.4, 25.0)):
        got = np.degrees(geometry.rudder_angle(psi * DEG))
        what = f"rudder angle of a force at {psi}°, trial {trial}"
        yield within(f"rudder/trial-{trial}", what, theta, got, "[1] eq. 4.3, table 4.2", tolerance=0.5, unit="deg")
    stops = [np.degrees(geometry.force_angle(t * DEG)) for t in (30, -35)]
    note = "The rudder's stops are reconstructed (errata); both ends pass the axis by less than a quarter of its tick."
    off = max(-20.0 - stops[0], stops[1] - 25.0)
    yield within(
        "rudder/range",
        "force angles at the stops beyond the axis -20 … 25",
        0.0,
        off,
        "[1] fig. 4.3",
        tolerance=1.25,
        unit="deg",
        basis="axis",
        note=note,
    )


def _thrust() -> Iterator[Row]:
    fan = to_arrays(Thruster())
    for krpm, ratio in RATIO.items():
        what = f"reverse over forward thrust at {krpm} krpm"
        got = fan.ratio(np.float64(1000 * krpm))
        yield within(f"thrust/reverse-{krpm}", what, ratio, got, "[1] eq. 4.4", tolerance=5e-5, basis="reference")
    straight = 0.566 * DEG
    least = fan.force(np.float64(3000), straight)
    yield within(
        "thrust/least",
        "thrust at 3000 rpm, the least on the gauge",
        0.1,
        least,
        "[1] section 4.2",
        tolerance=0.005,
        unit="N",
    )
    span = 0.0, fan.force(np.float64(12000), straight)
    note = "The greatest thrust is weakly determined: 1.1 to 2.0 N fit the published runs about equally (errata)."
    yield inside(
        "thrust/greatest",
        "thrust at 0 and 12 krpm on the gauge's scale",
        (0.0, 2.0),
        span,
        "[1] section 4.2",
        basis="text",
        unit="N",
        note=note,
    )


def _tables() -> Iterator[Row]:
    fan = Thruster()
    forward, full, back = forward_speed_table(fan), full_speed_table(fan), thrust_table(fan)
    place = "[1] section 4.2"
    yield same("table/forward", "shape of the forward speed table", (14, 81), tuple(np.shape(forward.values)), place)
    yield same("table/full", "shape of the full speed table", (14, 161), tuple(np.shape(full.values)), place)
    draws = np.random.default_rng(0)
    theta = draws.uniform(-35, 30, ROUND_TRIPS) * DEG
    force = draws.uniform(-0.55, 1.1, ROUND_TRIPS)
    at = jax.jit(jax.vmap(BilinearTable.at, in_axes=(None, 0, 0)))
    error = np.abs(np.asarray(at(to_arrays(back), theta, at(to_arrays(full), theta, force))) - force).max()
    note = "Demands that the fan can give at every rudder angle; next to its top speed a cell mixes the limit in."
    yield within(
        "table/round-trip",
        "force after both tables, largest error",
        0.0,
        error,
        "[1] section 6.1",
        tolerance=1e-2,
        unit="N",
        basis="reference",
        note=note,
    )
