"""Calibration of a rudder: table of the servo's angle against pulse width, and thrust direction at each rudder angle.

The direction of the force is measured as the angle between hull and string when the thrust pulls the tethered hull.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any, NamedTuple

import numpy as np

from trimtab.analysis.identify.regression import LinearFit, fit_linear
from trimtab.core.errors import InputError
from trimtab.core.rotation import DEG
from trimtab.logs.measurements import MeasuredColumn, Measurements, name_lines
from trimtab.loop.calibration import Calibration, Covariance, Entry

RUDDER_MAX = 60 * DEG
"""Largest plausible rudder angle (rad). Beyond it, the formula for the loss of thrust is not valid."""
WAY = MeasuredColumn("way", "1", "approach of the angle: 1 from below, -1 from above", -1, 1, needed=False)
"""Column for the direction from which an angle was approached. With this column, the linkage's play is fitted."""
SERVO_COLUMNS = (
    MeasuredColumn("pulse", "s", "pulse width of the servo", 0.5e-3, 2.5e-3, usual="us"),
    MeasuredColumn("angle", "rad", "rudder angle on the protractor", -RUDDER_MAX, RUDDER_MAX, 2 * DEG, usual="deg"),
    WAY,
)
HULL_COLUMNS = (
    MeasuredColumn("rudder", "rad", "rudder angle", -RUDDER_MAX, RUDDER_MAX, most=2 * DEG, usual="deg"),
    MeasuredColumn(
        "hull", "rad", "angle of the thrust, from the hull's x axis", -np.pi / 2, np.pi / 2, most=1 * DEG, usual="deg"
    ),
    WAY,
)
PULSE_START, PULSE_STEP, PULSES = 1.0e-3, 50e-6, 21
"""Pulse widths in the table of the servo: 1.00 to 2.00 ms in steps of 0.05 ms. [1] figure 4.2."""


class ServoFit(NamedTuple):
    """Fitted table of a servo. pulses: pulse widths (21,), s.  angles, errors: angles, standard errors (21,), rad.

    play: half the play of the linkage (rad); None if the direction of approach was not recorded.
    """

    pulses: Any
    angles: Any
    errors: Any
    play: float | None
    fit: LinearFit


def fit_servo(data: Measurements) -> ServoFit:
    """Fit the table of a servo to readings: a piecewise linear curve of angle against pulse width, by least squares.

    Source: [1] figure 4.2.

    Args:
        data: readings with the columns `SERVO_COLUMNS`, at any pulse widths. Each pulse width of the table needs a
            reading nearby.

    Raises: InputError if a pulse width of the table has no reading nearby, or if the angles do not rise with the pulse.
    """
    position = (data["pulse"] - PULSE_START) / PULSE_STEP
    outside = (position < -1e-6) | (position > PULSES - 1 + 1e-6)
    if outside.any():
        problem = f"{data.name_lines(outside)}: the pulse must be within 1.00 to 2.00 ms"
        raise InputError(
            f"file {data.file!r}", problem, fix="leave these lines out; the table covers only 1.00 to 2.00 ms"
        )
    position = position.clip(0, PULSES - 1)
    A = np.maximum(1 - np.abs(position[:, None] - np.arange(PULSES)), 0)
    A = np.where(A < 1e-9, 0.0, A)
    bare = [k for k in range(PULSES) if A[:, k].max() < 0.5]
    if bare:
        pulses = ", ".join(f"{1e3 * (PULSE_START + k * PULSE_STEP):.2f}" for k in bare)
        problem = f"no angle was measured near {pulses} ms"
        raise InputError(f"file {data.file!r}", problem, fix="measure at 1.00, 1.05, … 2.00 ms, best three times each")
    if len(data) <= PULSES:
        problem = f"{len(data)} readings at {PULSES} pulses are too few for an uncertainty"
        fix = "measure again, up and down: two or three readings for each pulse, numbered in a column trial"
        raise InputError(f"file {data.file!r}", problem, fix=fix)
    A, both = _add_ways(A, data)
    fit = fit_linear(A, data["angle"], floor=0.05 * DEG)
    angles, errors = fit.value[:PULSES], fit.standard_errors()[:PULSES]
    falls = np.flatnonzero(np.diff(angles) <= 0)
    if len(falls):
        k = int(falls[0])
        near = (position >= k - 0.5) & (position <= k + 1.5)
        problem = f"the angle does not rise from {1e3 * (PULSE_START + k * PULSE_STEP):.2f} ms to the next pulse"
        problem += f"; see {name_lines([int(n) for n in data.lines[near]])}"
        fix = "count angles as positive in the direction in which the rudder turns for growing pulses"
        raise InputError(f"file {data.file!r}", problem, fix=fix)
    play = abs(float(fit.value[-1])) if both else None
    return ServoFit(PULSE_START + PULSE_STEP * np.arange(PULSES), angles, errors, play, fit)


def _add_ways(A: Any, data: Measurements) -> tuple[Any, bool]:
    """Add a column for the direction of approach to the regression matrix, if the data has both directions."""
    way = np.sign(data["way"]) if "way" in data else np.zeros(len(data))
    both = bool((way > 0).any() and (way < 0).any())
    return (np.concatenate([A, way[:, None]], 1), True) if both else (A, False)


class HullFit(NamedTuple):
    """Fitted line theta = -ratio psi + offset, with rudder angle theta and force angle psi.

    covariance: covariance of ratio and offset (2, 2).  correlation: correlation of theta and psi.
    """

    ratio: float
    offset: float
    covariance: Any
    correlation: float
    fit: LinearFit


def fit_hull_angle(data: Measurements) -> HullFit:
    """Fit a line to rudder angle against force angle, [1] eq. 4.3. data: readings with the columns `HULL_COLUMNS`."""
    refuse_few(data, 2, "a line")
    psi, theta = data["hull"], data["rudder"]
    if np.ptp(psi) < 1 * DEG:
        raise InputError(f"file {data.file!r}", "the hull has only one angle", fix="measure several rudder angles")
    A, _ = _add_ways(np.stack([-psi, np.ones_like(psi)], 1), data)
    fit = fit_linear(A, theta, floor=0.05 * DEG)
    ratio, offset = (float(v) for v in fit.value[:2])
    if ratio <= 0:
        problem = f"the force turns with the rudder (ratio {ratio:.3g}), but must turn against it"
        fix = "measure both angles clockwise from the hull's x axis: change the sign of a column, or swap the headings"
        raise InputError(f"file {data.file!r}", problem, fix=fix)
    if ratio < 1:
        problem = f"the force turns more than the rudder (ratio {ratio:.3g}), which is impossible"
        fix = "check if the headings 'rudder' and 'hull' are swapped, or if a column has another unit than its heading"
        raise InputError(f"file {data.file!r}", problem, fix=fix)
    kept = fit.kept
    return HullFit(ratio, offset, fit.covariance[:2, :2], float(np.corrcoef(psi[kept], theta[kept])[0, 1]), fit)


def refuse_few(data: Measurements, numbers: int, what: str) -> None:
    """Raise InputError unless there are more readings than coefficients to fit. what: name of the fitted curve."""
    if len(data) <= numbers:
        problem = f"{len(data)} readings for {what} of {numbers} coefficients do not give an uncertainty"
        raise InputError(
            f"file {data.file!r}", problem, fix=f"measure at least {numbers + 1} readings, better {3 * numbers}"
        )


def source_of(data: Measurements, fit: LinearFit) -> str:
    """Return a description of the fitted data: file, number of readings, lines left out."""
    out = ~fit.kept
    left = f", {data.name_lines(out)} left out" if out.any() else ""
    return f"{data.file}: {len(data)} readings{left}"


def servo_calibration(data: Measurements, servo: ServoFit) -> Calibration:
    """Return a calibration with the fitted table of the servo."""
    about = {"freedom": servo.fit.freedom, "source": source_of(data, servo.fit), "procedure": "servo"}
    return Calibration({"RudderServo.angles": Entry(servo.angles.tolist(), "rad", servo.errors.tolist(), **about)})


def hull_calibration(data: Measurements, hull: HullFit) -> Calibration:
    """Return a calibration with the rudder's ratio and offset.

    `Thruster.offset` gets the same value, because the thrust is largest where the force points straight ahead.
    """
    error = np.sqrt(np.diagonal(hull.covariance))
    about = {"freedom": hull.fit.freedom, "source": source_of(data, hull.fit), "procedure": "hull"}
    names = ("RudderGeometry.ratio", "RudderGeometry.offset")
    entries = {
        names[0]: Entry(hull.ratio, "1", float(error[0]), **about),
        names[1]: Entry(hull.offset, "rad", float(error[1]), **about),
        "Thruster.offset": Entry(hull.offset, "rad", float(error[1]), **about),
    }
    return Calibration(entries, (Covariance(names, hull.covariance.tolist(), "hull"),))
