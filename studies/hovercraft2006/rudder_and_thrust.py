"""Rudder and thrust: calibration and lookup tables.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 4.3.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from studies.hovercraft2006._pictures import Panel, draw_panels
from studies.hovercraft2006._source import reference_row
from trimtab.actuators.lookup import BilinearTable, forward_speed_table, full_speed_table, thrust_table
from trimtab.actuators.rudder import DEG, RudderGeometry, RudderServo
from trimtab.actuators.thruster import Thruster
from trimtab.core.record import to_arrays
from trimtab.study import Row, direction, overlaps, same, within

SECTION = "4.3"
PLACE = "[1] section 4.3"
ROUND_TRIPS = 20_000
GEOMETRY, SERVO, FAN = RudderGeometry(), RudderServo(), Thruster()
FIT = "The model was chosen to fit this value. The thesis shows only a plot (errata)."


def rows() -> Iterator[Row]:
    """Yield rows on rudder geometry, thrust law, shapes of the tables, and the two tables in series."""
    yield from _rudder()
    yield from _thrust()
    yield from _tables()


def _rudder() -> Iterator[Row]:
    for trial, psi, theta in ((1, 14.6, -20.0), (2, -17.4, 25.0)):
        angle = np.degrees(GEOMETRY.rudder_angle(psi * DEG))
        what = f"rudder angle of a force at {psi}°, trial {trial}"
        yield within(f"rudder/trial-{trial}", what, theta, angle, "[1] eq. 4.3, table 4.2", tolerance=0.5, unit="deg")
    low, high = (np.degrees(GEOMETRY.force_angle(stop)) for stop in (SERVO.angle_max, SERVO.angle_min))
    about: dict[str, Any] = {"tolerance": 1.25, "unit": "deg", "basis": "input", "note": FIT}
    axis = "[1] fig. 4.3, axis"
    yield within(
        "rudder/range-least", "force angle at one rudder stop: lower end of the plot's axis", -20.0, low, axis, **about
    )
    yield within(
        "rudder/range-greatest", "force angle at the other stop: upper end of the axis", 25.0, high, axis, **about
    )


def _thrust() -> Iterator[Row]:
    fan = to_arrays(FAN)
    for krpm in (6, 8, 10, 12):
        what = f"reverse divided by forward thrust at {krpm} krpm"
        ratio = fan.ratio(np.float64(1000 * krpm))
        yield reference_row(f"thrust/reverse-{krpm}", what, ratio, "[1] eq. 4.4", tolerance=1e-9)
    force = {n: float(fan.force(np.float64(n), 0.566 * DEG)) for n in (3000, 12000)}
    given: dict[str, Any] = {"unit": "N", "basis": "input", "note": FIT}
    what = "thrust at 3000 rpm, the smallest force on the gauge"
    yield within("thrust/least", what, 0.1, force[3000], PLACE, tolerance=0.005, **given)
    what = "greatest thrust, just above the last tick of the axis at 1.5"
    both = force[12000], force[12000]
    yield overlaps("thrust/greatest", what, (1.5, 2.0), both, "[1] fig. 4.5, axis", **given)
    trial = min(float(fan.force(np.float64(12000), theta * DEG)) - f for theta, f in ((-20, 1.1), (25, 1.05)))
    what = "thrust at full speed minus that of the two trials for J"
    yield direction("thrust/trials", what, "1.1 and 1.05 N", trial, "[1] table 4.2", above=0.0, unit="N")


def _tables() -> Iterator[Row]:
    forward, full, back = forward_speed_table(FAN), full_speed_table(FAN), thrust_table(FAN)
    given: dict[str, Any] = {"basis": "input"}
    yield same(
        "table/forward", "shape of the forward speed table", (14, 81), tuple(np.shape(forward.values)), PLACE, **given
    )
    yield same("table/full", "shape of the full speed table", (14, 161), tuple(np.shape(full.values)), PLACE, **given)
    draws = np.random.default_rng(0)
    theta = draws.uniform(-35, 30, ROUND_TRIPS) * DEG
    force = draws.uniform(-0.55, 1.1, ROUND_TRIPS)
    at = jax.jit(jax.vmap(BilinearTable.at, in_axes=(None, 0, 0)))
    error = np.abs(np.asarray(at(to_arrays(back), theta, at(to_arrays(full), theta, force))) - force).max()
    note = "Demands are within the fan's range at every rudder angle. Table cells at its top speed include the limit."
    yield direction(
        "table/round-trip",
        "force after both tables minus the demand, largest of 20 000",
        "reverse table",
        error,
        "[1] section 6.1",
        below=1e-2,
        unit="N",
        note=note,
    )


def figures(folder: Path) -> Iterator[Path]:
    """Plot figures 4.2, 4.3 and 4.5, and the ratio of eq. 4.4."""
    pulse = np.linspace(1e-3, 2e-3, 201)
    angle = np.degrees(np.array([float(SERVO.angle(p)) for p in pulse]))
    points = 1e3 * (SERVO.pulse_start + SERVO.pulse_step * np.arange(21)), np.degrees(np.asarray(SERVO.angles))
    panel = Panel("", "pulse (ms)", "rudder angle (deg)", ((1e3 * pulse, angle, "", "-"), (*points, "21 points", "o")))
    yield draw_panels(folder / "fig-4.2.png", "[1] fig. 4.2: rudder servo, reconstructed", [panel])
    psi = np.linspace(-20, 25, 100)
    theta = np.degrees(GEOMETRY.rudder_angle(psi * DEG))
    trials = [14.6, -17.4], [-20, 25], "trials of table 4.2", "o"
    panel = Panel("", "force angle ψ (deg)", "rudder angle θ (deg)", ((psi, theta, "eq. 4.3", "-"), trials))
    yield draw_panels(folder / "fig-4.3.png", "[1] fig. 4.3: rudder and force", [panel])
    n = np.linspace(0, 12, 121)
    curves = tuple((n, FAN.force(1e3 * n, t * DEG), f"θ = {t}°", "-") for t in (-30, -20, -10, 0, 10, 20))
    forward = Panel("forward", "speed (krpm)", "thrust (N)", curves, (0, 2))
    reverse = Panel(
        "reverse / forward, eq. 4.4", "speed (krpm)", "", ((n[60:], FAN.ratio(1e3 * n[60:]), "", "-"),), (0, 0.5)
    )
    title = "[1] fig. 4.5: thrust, reconstructed"
    yield draw_panels(folder / "fig-4.5.png", title, [forward, reverse], columns=2)
