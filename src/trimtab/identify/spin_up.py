"""Moment of inertia with its error, from a table of trials or from the log of one.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 4.3.3.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError, argument_name
from trimtab.core.rotation import DEG
from trimtab.identify.calibration import Calibration, Entry
from trimtab.identify.inertia import LinearPortion, lateral_force, moment_of_inertia
from trimtab.identify.measurements import MeasuredColumn, Measurements
from trimtab.identify.regression import LinearFit, fit_linear, student_reach
from trimtab.identify.rudder import source_of

TRIAL_COLUMNS = (
    MeasuredColumn("rudder", "rad", "rudder angle held", -np.pi / 2, np.pi / 2, most=2 * DEG, usual="deg"),
    MeasuredColumn("force", "N", "thrust held", -100, 100, most=0.02),
    MeasuredColumn("slope", "rad/s^2", "initial slope of the yaw rate", -1000, 1000),
)
SPIN_UP_COLUMNS = (
    MeasuredColumn("time", "s", "since any instant, before the release"),
    MeasuredColumn("yaw_rate", "rad/s", "rate of turn", -50, 50, most=0.05),
)


class InertiaOfTrials(NamedTuple):
    """each: J of each trial (n,), kg m².  J, standard_error: their mean.  fit: of that."""

    each: Any
    J: float
    standard_error: float
    fit: LinearFit

    def reach(self) -> float:
        """Half the 95 % interval of the mean."""
        return student_reach(self.fit.freedom) * self.standard_error


class ForceGeometry(NamedTuple):
    """Rudder angle to force angle, psi = (offset - theta)/ratio. arm: m.  covariance: of ratio and offset (2, 2).

    What is not known of it is the same in every trial, so that repeating them does not help.
    """

    arm: float
    ratio: float
    offset: float
    covariance: Any

    def lateral_force(self, force: Any, rudder: Any) -> Any:
        """FY (N) of a thrust with the rudder at an angle (rad)."""
        return lateral_force(force, (self.offset - rudder) / self.ratio)

    def variance(self, mean: Callable[["ForceGeometry"], float]) -> float:
        """Variance of a mean that is computed with this geometry, from what isn't known of it."""
        h = 1e-6
        ratio = mean(self._replace(ratio=self.ratio + h)) - mean(self._replace(ratio=self.ratio - h))
        offset = mean(self._replace(offset=self.offset + h)) - mean(self._replace(offset=self.offset - h))
        slope = np.array([ratio, offset]) / (2 * h)
        return float(slope @ np.asarray(self.covariance) @ slope)


def inertia_of_trials(rows: Measurements, geometry: ForceGeometry) -> InertiaOfTrials:
    """J = -d FY/r' of each trial of `TRIAL_COLUMNS` and their mean, [1] table 4.2.

    Args:
        rows: what was measured.
        geometry: where the force of each rudder angle points.
    """
    if len(rows) < 2:
        problem = f"{len(rows)} trial says nothing of how well J is known"
        raise InputError(f"file {rows.file!r}", problem, fix="repeat it, best three times to either side")
    flat = np.abs(rows["slope"]) < 1e-6
    if flat.any():
        problem = f"{rows.name_lines(flat)}: a slope of 0 gives no moment of inertia"
        raise InputError(f"file {rows.file!r}", problem, fix="leave it out")
    sides = [np.unique(np.sign(rows[name])) for name in ("rudder", "force", "slope")]
    if [len(side) for side in sides] == [2, 2, 1]:
        problem = "the force changes its sign with the rudder, the slope never does"
        fix = "are the headings 'force' and 'slope' swapped? The force is the thrust held, the same to both sides"
        raise InputError(f"file {rows.file!r}", problem, fix=fix)
    J = _each_inertia(rows, geometry)
    wrong = J <= 0
    if wrong.any():
        problem = f"{rows.name_lines(wrong)}: the craft turned against the force"
        fix = "angles and slopes are positive clockwise from above; correct the sign of one"
        raise InputError(f"file {rows.file!r}", problem, fix=fix)
    fit = fit_linear(np.ones((len(J), 1)), J)
    shared = geometry.variance(lambda g: float(np.mean(_each_inertia(rows, g)[fit.kept])))
    error = float(np.hypot(fit.standard_errors()[0], np.sqrt(shared)))
    return InertiaOfTrials(J, float(fit.value[0]), error, fit)


def _each_inertia(rows: Measurements, geometry: ForceGeometry) -> Any:
    FY = geometry.lateral_force(rows["force"], rows["rudder"])
    return moment_of_inertia(geometry.arm, FY, rows["slope"])


def inertia_of_spin_up(
    part: LinearPortion, force: float, rudder: float, geometry: ForceGeometry
) -> tuple[float, float, int]:
    """J (kg m²), its standard error from the slope's, and degrees of freedom, of one release.

    Args:
        part: of `find_linear_portion`.
        force, rudder: held (N, rad).
        geometry: where the force points.
    """
    slope, error = float(part.fit.slope), float(part.fit.standard_error)

    def inertia(g: ForceGeometry) -> float:
        return float(moment_of_inertia(g.arm, g.lateral_force(force, rudder), slope))

    J, FY = inertia(geometry), float(geometry.lateral_force(force, rudder))
    if J <= 0:
        problem = f"the yaw rate changes by {slope:.3g} rad/s², the force of {FY:.3g} N turns it the other way"
        raise InputError(
            "calibrate inertia", problem, fix=f"correct the sign of {argument_name('rudder')} or of the yaw rate"
        )
    return J, float(np.hypot(J * error / slope, np.sqrt(geometry.variance(inertia)))), int(part.fit.samples) - 2


def inertia_calibration(rows: Measurements, found: InertiaOfTrials) -> Calibration:
    """The mean of the trials."""
    about: dict[str, Any] = {"source": source_of(rows, found.fit), "procedure": "inertia", "freedom": found.fit.freedom}
    return Calibration({"Hovercraft.inertia": Entry(found.J, "kg m^2", found.standard_error, **about)})
