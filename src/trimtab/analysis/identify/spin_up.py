"""Moment of inertia with its standard error, from a table of spin-up trials or from the log of one trial.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 4.3.3.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from trimtab.analysis.identify.inertia import LinearPortion, lateral_force, moment_of_inertia
from trimtab.analysis.identify.regression import LinearFit, fit_linear
from trimtab.analysis.identify.rudder import RUDDER_MAX, source_of
from trimtab.core.errors import InputError, argument_name
from trimtab.core.rotation import DEG
from trimtab.logs.measurements import MeasuredColumn, Measurements
from trimtab.loop.calibration import Calibration, Entry, student_reach

TRIAL_COLUMNS = (
    MeasuredColumn("rudder", "rad", "constant rudder angle", -RUDDER_MAX, RUDDER_MAX, most=2 * DEG, usual="deg"),
    MeasuredColumn("force", "N", "constant thrust", -100, 100, most=0.02),
    MeasuredColumn("slope", "rad/s^2", "initial slope of the yaw rate", -1000, 1000, most=0.01),
)
SPIN_UP_COLUMNS = (
    MeasuredColumn("time", "s", "time; the log must start before the craft is released"),
    MeasuredColumn("yaw_rate", "rad/s", "yaw rate", -50, 50, most=0.05),
)


class InertiaOfTrials(NamedTuple):
    """Moment of inertia J from several trials. each: J of each trial (n,), kg m².

    J, standard_error: mean of all trials and standard error of the mean, kg m².  fit: fit of the mean.
    """

    each: Any
    J: float
    standard_error: float
    fit: LinearFit

    def reach(self) -> float:
        """Return half the width of the 95 % interval of the mean inertia (kg m²)."""
        return student_reach(self.fit.freedom) * self.standard_error


class ForceGeometry(NamedTuple):
    """Direction psi of the thrust at a rudder angle theta: psi = (offset - theta)/ratio.

    arm: distance from the centre of mass to the rudder pivot (m).  covariance: covariance of ratio and offset (2, 2).
    The errors of ratio and offset are the same in every trial, so repeated trials do not reduce the effect of these
    errors.
    """

    arm: float
    ratio: float
    offset: float
    covariance: Any

    def lateral_force(self, force: Any, rudder: Any) -> Any:
        """Return the lateral force FY (N) of a thrust (N) at a rudder angle (rad)."""
        return lateral_force(force, (self.offset - rudder) / self.ratio)

    def variance(self, mean: Callable[["ForceGeometry"], float]) -> float:
        """Return the variance that errors of ratio and offset cause in a result computed with this geometry."""
        h = 1e-6
        ratio = mean(self._replace(ratio=self.ratio + h)) - mean(self._replace(ratio=self.ratio - h))
        offset = mean(self._replace(offset=self.offset + h)) - mean(self._replace(offset=self.offset - h))
        slope = np.array([ratio, offset]) / (2 * h)
        return float(slope @ np.asarray(self.covariance) @ slope)


def inertia_of_trials(rows: Measurements, geometry: ForceGeometry) -> InertiaOfTrials:
    """Compute the moment of inertia J = -d FY/r' of each trial, and the mean, as in [1] table 4.2.

    Args:
        rows: table with the columns `TRIAL_COLUMNS`, one row for each trial.
        geometry: direction of the thrust for each rudder angle.
    """
    if len(rows) < 2:
        problem = f"at least 2 trials are needed for an uncertainty of J, got {len(rows)}"
        raise InputError(f"file {rows.file!r}", problem, fix="repeat the trial, if possible three times to each side")
    flat = np.abs(rows["slope"]) < 1e-6
    if flat.any():
        problem = f"{rows.name_lines(flat)}: the slope is 0, so the moment of inertia cannot be computed"
        raise InputError(f"file {rows.file!r}", problem, fix="leave this line out")
    sides = [np.unique(np.sign(rows[name])) for name in ("rudder", "force", "slope")]
    if [len(side) for side in sides] == [2, 2, 1]:
        problem = "the force changes its sign with the rudder, but the slope never does"
        fix = (
            "check if the headings 'force' and 'slope' are swapped; the force is the constant "
            "thrust, the same for trials to both sides"
        )
        raise InputError(f"file {rows.file!r}", problem, fix=fix)
    J = _each_inertia(rows, geometry)
    wrong = J <= 0
    if wrong.any():
        problem = f"{rows.name_lines(wrong)}: the craft turned against the force"
        fix = "angles and slopes are positive clockwise seen from above; correct the sign of the angle or of the slope"
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
    """Compute J (kg m²), its standard error, and the slope's degrees of freedom, from the log of one spin-up.

    Args:
        part: result of `find_linear_portion`.
        force, rudder: constant thrust (N) and rudder angle (rad).
        geometry: direction of the thrust for each rudder angle.
    """
    slope, error = float(part.fit.slope), float(part.fit.standard_error)

    def inertia(g: ForceGeometry) -> float:
        return float(moment_of_inertia(g.arm, g.lateral_force(force, rudder), slope))

    J, FY = inertia(geometry), float(geometry.lateral_force(force, rudder))
    if J <= 0:
        problem = (
            f"the yaw rate changes by {slope:.3g} rad/s², but the force of {FY:.3g} N turns the craft the other way"
        )
        raise InputError(
            "calibrate inertia", problem, fix=f"correct the sign of {argument_name('rudder')} or of the yaw rate"
        )
    return J, float(np.hypot(J * error / slope, np.sqrt(geometry.variance(inertia)))), int(part.fit.samples) - 2


def inertia_calibration(rows: Measurements, found: InertiaOfTrials) -> Calibration:
    """Return a calibration with the mean inertia of the trials."""
    about: dict[str, Any] = {"source": source_of(rows, found.fit), "procedure": "inertia", "freedom": found.fit.freedom}
    return Calibration({"Hovercraft.inertia": Entry(found.J, "kg m^2", found.standard_error, **about)})
