"""Moment of inertia from two spin-up trials.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 4.3.3.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from studies.hovercraft2006._pictures import Panel, draw_panels
from studies.hovercraft2006._source import reference_row
from trimtab.actuators.rudder import DEG, RudderGeometry
from trimtab.analysis.identify.inertia import SpinUpTrial, fit_slope, lateral_force, moment_of_inertia, trial_inertia
from trimtab.core.integrate import rk4
from trimtab.core.signals import PlanarForce
from trimtab.study import Row, within
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

SECTION = "4.3.3"
PLACE = "[1] table 4.2"
CRAFT = Hovercraft()
PSI = RudderGeometry().force_angle


class PrintedTrial(NamedTuple):
    """Row of [1] table 4.2: rudder and force angle (deg), thrust and lateral force (N), slope (rad/s²), J (kg m²)."""

    theta: float
    psi: float
    force: float
    FY: float
    slope: float
    J: float


TRIALS = (PrintedTrial(-20, 14.6, 1.1, -0.28, 0.9412, 0.0952), PrintedTrial(25, -17.4, 1.05, 0.31, -1.026, 0.0967))


def rows() -> Iterator[Row]:
    """Yield both trials, with the lateral force as printed and unrounded, the mean of both, and a simulated spin-up."""
    found = []
    for n, trial in enumerate(TRIALS, 1):
        measured = SpinUpTrial(trial.theta * DEG, trial.force, trial.slope)
        FY, J = trial_inertia(measured, CRAFT.arm, PSI, decimals=2)
        found.append(J)
        yield within(f"table-4.2/FY-{n}", f"lateral force, trial {n}", trial.FY, FY, PLACE, tolerance=0.005, unit="N")
        what = f"J, trial {n}, lateral force rounded as printed"
        yield within(f"table-4.2/J-{n}", what, trial.J, J, PLACE, tolerance=1e-4, unit="kg m²")
        exact = moment_of_inertia(CRAFT.arm, lateral_force(trial.force, trial.psi * DEG), trial.slope)
        note = "The printed J follows only from the lateral force rounded to two digits."
        yield within(
            f"table-4.2/J-{n}-exact",
            f"J, trial {n}, lateral force not rounded",
            trial.J,
            exact,
            PLACE,
            tolerance=1e-4,
            unit="kg m²",
            must_hold=False,
            note=note,
        )
    mean, text = float(np.mean(found)), "[1] section 4.3.3"
    yield within("J/mean", "mean of both trials", 0.096, mean, text, tolerance=5e-4, unit="kg m²")
    pounds = CRAFT.inertia / (0.45359237 * 0.3048**2)
    what = "J of the simulated vehicle"
    yield within("J/pounds", what, 2.3, pounds, text, tolerance=0.05, unit="lb ft²", basis="input")
    t, rate = _fly_spin_up()
    what = "slope of a spin-up at 1.0 N, rudder -30°"
    slope = float(fit_slope(t, rate).slope)
    yield reference_row("fig-4.6/slope", what, slope, "[1] fig. 4.6", tolerance=1e-6, unit="rad/s²")


def figures(folder: Path) -> Iterator[Path]:
    """Plot figure 4.6: the spin-up whose slope gives J."""
    t, rate = _fly_spin_up()
    fit = fit_slope(t, rate)
    curves = (t, rate, "simulated", "."), (t, float(fit.slope) * t, f"slope {float(fit.slope):.4f} rad/s²", "-")
    title = "[1] fig. 4.6: spin-up, 1.0 N, rudder at -30°"
    yield draw_panels(folder / "fig-4.6.png", title, [Panel("", "t (s)", "yaw rate (rad/s)", curves)])


def _fly_spin_up() -> tuple[Any, Any]:
    """Return times (s) and yaw rates (rad/s) of a release under a constant force, by the published method."""
    psi = PSI(-30 * DEG)
    push, h, x, rate = PlanarForce(np.cos(psi), lateral_force(1.0, psi)), 0.02, HovercraftState(), []
    for _ in range(25):
        x = rk4(lambda t, x: CRAFT.dynamics(t, x, push), 0.0, x, h)
        rate.append(float(x.yaw_rate))
    return h * np.arange(1, 26), np.array(rate)
