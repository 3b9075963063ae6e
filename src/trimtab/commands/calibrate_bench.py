"""`trimtab calibrate rudder|hull|thrust|reverse|inertia|friction|gyro`: calibrate from bench measurements."""

from pathlib import Path
from typing import Any

import click
import numpy as np

from trimtab.analysis.identify import coast_down, gyro_response, inertia, rudder, spin_up, thrust
from trimtab.analysis.identify.regression import LinearFit
from trimtab.commands.calibrate_files import CalibrationReport, finish_calibration
from trimtab.commands.calibrate_inputs import describe_assumed, find_error, find_geometry, find_number, parse_amount
from trimtab.commands.options import FILE, JSON, OUT, PLOT
from trimtab.core.errors import InputError
from trimtab.core.rotation import DEG
from trimtab.logs.measurements import Measurements, read_measurements, read_names, refuse_spikes, refuse_wrong_step
from trimtab.loop.calibration import Calibration, Entry, student_reach
from trimtab.plots.calibration import FitCurve, FitPanel
from trimtab.vehicles.hovercraft import Friction

SLIP = {"torque": float(Friction().slip_rate), "force": float(Friction().slip_speed)}
DATA = click.argument("data", type=FILE)
ADD = OUT("FILE.toml", "Write the parameters to this calibration file. Other parameters in the file are kept.")
DRAW = PLOT("Draw the fit and the residuals to this picture file.")


@click.command(name="rudder")
@DATA
@ADD
@DRAW
@JSON
def calibrate_rudder(data: Path, out: Path | None, plot: Path | None, as_json: bool) -> None:
    """Calibrate the servo. DATA has columns pulse [us] and angle [deg].

    Measure at pulses of 1.00, 1.05 … 2.00 ms in rising order, then in falling order. An optional column way
    (1: rising, -1: falling) states the direction, so that the play of the linkage is not taken for scatter.
    """
    rows = read_measurements(data, rudder.SERVO_COLUMNS)
    servo = rudder.fit_servo(rows)
    reach = servo.errors * student_reach(servo.fit.freedom)
    curve = _curve(
        1e3 * rows["pulse"], rows["angle"] / DEG, servo.fit, (1e3 * servo.pulses, servo.angles / DEG), 1 / DEG
    )
    note = "" if servo.play is None else f"play ±{servo.play / DEG:.2f}°"
    panel = FitPanel("Rudder servo", "pulse (ms)", "angle (°)", [curve._replace(band=reach / DEG)], note)
    finish_calibration(
        "rudder", rudder.servo_calibration(rows, servo), _report(rows, servo.fit, "angle", panel), out, plot, as_json
    )


@click.command(name="hull")
@DATA
@ADD
@DRAW
@JSON
def calibrate_hull(data: Path, out: Path | None, plot: Path | None, as_json: bool) -> None:
    """Calibrate the force direction. DATA has columns rudder [deg] and hull [deg].

    Tie the craft to a fixed point with a string, and turn the fan on. Column hull is the angle from the nose to the
    string, which is the angle of the force.
    """
    rows = read_measurements(data, rudder.HULL_COLUMNS)
    hull = rudder.fit_hull_angle(rows)
    line = np.linspace(rows["hull"].min(), rows["hull"].max(), 50)
    A = np.stack([-line, np.ones_like(line)], 1)
    curve = _curve(
        rows["hull"] / DEG, rows["rudder"] / DEG, hull.fit, (line / DEG, A @ hull.fit.value[:2] / DEG), 1 / DEG
    )
    curve = curve._replace(band=_band(A, hull.fit) / DEG)
    note = f"correlation {hull.correlation:.4f}"
    panel = FitPanel("Rudder angle against force angle", "force angle (°)", "rudder angle (°)", [curve], note)
    finish_calibration(
        "hull", rudder.hull_calibration(rows, hull), _report(rows, hull.fit, "rudder", panel), out, plot, as_json
    )


@click.command(name="thrust")
@DATA
@ADD
@DRAW
@JSON
def calibrate_thrust(data: Path, out: Path | None, plot: Path | None, as_json: bool) -> None:
    """Calibrate the fan's thrust. DATA has columns rudder [deg], speed [rpm] and force [N] (or gf, ozf).

    The rudder angle of the largest thrust is read from the file in --out, if `trimtab calibrate hull` wrote it there.
    """
    rows = read_measurements(data, thrust.THRUST_COLUMNS)
    offset = find_number(out, "Thruster.offset")
    fit = thrust.fit_thrust(rows, offset)
    panels = [_thrust_panel(rows, fit, offset), _eta_panel(fit, offset)]
    report = _report(rows, fit.fit, "force", *panels)._replace(notes=describe_assumed(out, "Thruster.offset"))
    if len(fit.angles) < 3:
        angles = ", ".join(f"{a / DEG:.0f}°" for a in fit.angles)
        text = (
            f"the data has only rudder angles of {angles}; at others the thrust loss is that of the formula, untested"
        )
        report = report._replace(notes=(*report.notes, text))
    if not fit.follows_formula():
        text = f"thrust does not follow cos(rudder angle - offset) (p-value {fit.chance:.1e});"
        report = report._replace(notes=(*report.notes, f"{text} the calibration has measured tables instead"))
    finish_calibration("thrust", thrust.thrust_calibration(rows, fit), report, out, plot, as_json)


@click.command(name="reverse")
@DATA
@click.option(
    "--division", callback=parse_amount, default="0.1 N", show_default=True, help="Scale division of the force gauge."
)
@ADD
@DRAW
@JSON
def calibrate_reverse(data: Path, division: float, out: Path | None, plot: Path | None, as_json: bool) -> None:
    """Calibrate the ratio of reverse to forward thrust.

    DATA has columns speed [rpm], forward [N] and reverse [N].
    """
    rows = read_measurements(data, thrust.REVERSE_COLUMNS)
    fit = thrust.fit_reverse(rows, division / np.sqrt(12))
    n = np.linspace(rows["speed"].min(), rows["speed"].max(), 100) * 1e-3
    A = np.stack([n**3, n**2, n, np.ones_like(n)], 1)
    ratio, krpm = rows["reverse"] / rows["forward"], rows["speed"] * 1e-3
    fitted = np.polyval(fit.coefficients, krpm)
    curve = FitCurve(krpm, ratio, fitted, fit.fit.kept, n, A @ fit.coefficients, _band(A, fit.fit))
    panel = FitPanel("Ratio of reverse to forward thrust", "speed (krpm)", "ratio", [curve])
    report = CalibrationReport(
        rows.file, len(rows), _describe_outliers(rows, fit.fit, "reverse", ratio - fitted), (panel,)
    )
    finish_calibration("reverse", thrust.reverse_calibration(rows, fit), report, out, plot, as_json)


@click.command(name="inertia")
@DATA
@click.option(
    "--force", callback=parse_amount, metavar="'1.1 N'", help="Constant thrust, if DATA is the log of a spin-up."
)
@click.option(
    "--rudder",
    callback=parse_amount,
    metavar="'-20 deg'",
    help="Constant rudder angle, if DATA is the log of a spin-up.",
)
@click.option("--arm", callback=parse_amount, metavar="'0.32 m'", help="Distance from centre of mass to rudder pivot.")
@ADD
@DRAW
@JSON
def calibrate_inertia(
    data: Path,
    force: float | None,
    rudder: float | None,
    arm: float | None,
    out: Path | None,
    plot: Path | None,
    as_json: bool,
) -> None:
    """Calibrate the moment of inertia from a spin-up.

    DATA is a table of spin-ups, or, with --force and --rudder, the log of a spin-up.

    A table has columns rudder [deg], force [N] and slope [rad/s^2]. The log of a spin-up has columns time [s] and
    yaw_rate [deg/s], and begins before the craft is released. The linear rise of the yaw rate is found automatically.
    """
    geometry = find_geometry(out, arm)
    names = ("RudderGeometry.ratio", "RudderGeometry.offset", *(("Hovercraft.arm",) if arm is None else ()))
    assumed = describe_assumed(out, *names)
    if (force is None) != (rudder is None):
        raise InputError(
            "calibrate inertia", "--force and --rudder must be given together", fix="--force '1.1 N' --rudder '-20 deg'"
        )
    _check_kind_of_spin_ups(data, force is not None)
    if force is None:
        rows = read_measurements(data, spin_up.TRIAL_COLUMNS)
        found = spin_up.inertia_of_trials(rows, geometry)
        trial = np.arange(1, len(rows) + 1)
        mean = np.full(len(rows), found.J)
        curve = FitCurve(trial, found.each, mean, found.fit.kept, trial, mean, np.full(len(rows), found.reach()))
        panel = FitPanel("Moment of inertia", "trial", "J (kg m²)", [curve])
        report = CalibrationReport(
            rows.file, len(rows), _describe_outliers(rows, found.fit, "slope", found.each - found.J), (panel,), assumed
        )
        finish_calibration("inertia", spin_up.inertia_calibration(rows, found), report, out, plot, as_json)
        return
    assert rudder is not None
    rows = read_measurements(data, spin_up.SPIN_UP_COLUMNS, series=True)
    refuse_wrong_step(rows.file, rows["time"])
    refuse_spikes(rows, "yaw_rate")
    part = inertia.find_linear_portion(rows["time"], rows["yaw_rate"])
    J, error, freedom = spin_up.inertia_of_spin_up(part, force, rudder, geometry)
    since = rows["time"] - part.start
    used = (since >= 0) & (since <= part.window)
    line = float(part.fit.offset) + float(part.fit.slope) * since
    curve = FitCurve(since, rows["yaw_rate"], np.where(used, line, np.nan), np.ones_like(used), since[used], line[used])
    note = f"released at {part.start:.2f} s, linear for {part.window:.2f} s"
    panel = FitPanel("Spin-up", "time since release (s)", "yaw rate (rad/s)", [curve], note)
    about: dict[str, Any] = {"source": f"{rows.file}: {note}", "procedure": "inertia", "freedom": freedom}
    calibration = Calibration({"Hovercraft.inertia": Entry(J, "kg m^2", error, **about)})
    report = CalibrationReport(rows.file, len(rows), (), (panel,), (note, *assumed))
    finish_calibration("inertia", calibration, report, out, plot, as_json)


def _check_kind_of_spin_ups(data: Path, is_log: bool) -> None:
    """Raise InputError for the log of a spin-up without --force and --rudder, or a table of spin-ups with them."""
    names = read_names(data, spin_up.SPIN_UP_COLUMNS if is_log else spin_up.TRIAL_COLUMNS)
    if is_log and "slope" in names and "yaw_rate" not in names:
        fix = "leave --force and --rudder out; the log of a spin-up has columns time [s] and yaw_rate [deg/s]"
        raise InputError("--force", f"is only for a log, but file '{data}' is a table of spin-ups", fix=fix)
    if not is_log and "yaw_rate" in names and "slope" not in names:
        fix = "--force '1.1 N' --rudder '-20 deg', with the force and the rudder angle of this spin-up"
        raise InputError("calibrate inertia", f"file '{data}' is the log of one spin-up; it needs --force", fix=fix)


@click.command(name="friction")
@DATA
@click.option(
    "--mass", callback=parse_amount, metavar="'2.6 kg'", help="Mass of the craft, if DATA has the speed of a glide."
)
@ADD
@DRAW
@JSON
def calibrate_friction(data: Path, mass: float | None, out: Path | None, plot: Path | None, as_json: bool) -> None:
    """Calibrate friction from coast-downs.

    DATA has columns time [s], yaw_rate [rad/s] or speed [m/s], and optionally trial.
    """
    names = read_names(data, coast_down.SPIN_COLUMNS)
    if "speed" in names and "yaw_rate" in names:
        fix = "remove column 'speed' for a spin, or column 'yaw_rate' for a glide"
        raise InputError(f"file '{data}'", "has both a column 'yaw_rate' and a column 'speed'", fix=fix)
    kind, speed = ("force", "speed") if "speed" in names else ("torque", "yaw_rate")
    if kind == "torque" and mass is not None:
        fix = "leave --mass out for a spin; the log of a glide has a column speed [m/s]"
        raise InputError("--mass", f"is only for a glide, but file '{data}' has no column 'speed'", fix=fix)
    columns = coast_down.GLIDE_COLUMNS if kind == "force" else coast_down.SPIN_COLUMNS
    rows = read_measurements(data, columns)
    size_name = "Hovercraft.mass" if kind == "force" else "Hovercraft.inertia"
    size, error = (find_number(out, size_name), find_error(out, size_name)) if mass is None else (mass, 0.0)
    fit = coast_down.fit_coast_down(coast_down.split_trials(rows, speed), size, kind, SLIP[kind], error)
    assumed = describe_assumed(out, size_name) if mass is None else ()
    curves = [
        FitCurve(t, v, fitted, np.ones(len(t), bool), t, fitted, label=f"trial {k}" if len(fit.trials) > 1 else "")
        for k, (t, v, fitted) in enumerate(fit.trials, 1)
    ]
    unit = "m/s" if kind == "force" else "rad/s"
    panel = FitPanel(f"Coast-down: {kind}", "time (s)", f"{speed.replace('_', ' ')} ({unit})", curves)
    notes = [
        f"{name} friction is not significantly different from zero in this data: at most {1.96 * error:.3g} {unit}"
        for name, value, error, unit in zip(
            coast_down.NAMES, fit.coefficients, fit.standard_errors(), coast_down.UNITS[kind], strict=True
        )
        if value < 1.96 * error
    ]
    report = CalibrationReport(rows.file, len(rows), (), (panel,), (*notes, *assumed))
    finish_calibration("friction", coast_down.friction_calibration(rows.file, fit), report, out, plot, as_json)


@click.command(name="gyro")
@DATA
@ADD
@DRAW
@JSON
def calibrate_gyro(data: Path, out: Path | None, plot: Path | None, as_json: bool) -> None:
    """Calibrate the dynamics of a gyro from a sweep.

    DATA has columns time [s], reference [rad/s] and gyro [rad/s].
    """
    rows = read_measurements(data, gyro_response.COLUMNS, series=True)
    fit = gyro_response.fit_gyro(rows)
    t, good = rows["time"] - rows["time"][0], np.ones(len(rows), bool)
    curve = FitCurve(t, rows["gyro"], fit.fitted, good, t, fit.fitted)
    back = fit.inverse(rows["gyro"])
    late = np.concatenate([rows["reference"][:1].repeat(fit.delay), rows["reference"][: len(rows) - fit.delay]])
    inverse = FitCurve(t, late, back, good, t, back)
    note = f"delay {fit.delay} samples, rms error {fit.deviation:.2g} rad/s"
    panels = (
        FitPanel("Gyro and its model", "time (s)", "rate (rad/s)", [curve], note),
        FitPanel("Reference, and output of the inverse model", "time (s)", "rate (rad/s)", [inverse]),
    )
    notes = (f"{note}; static gain {fit.gain():.4f}; valid up to {fit.highest:.3g} Hz, where the sweep ends",)
    report = CalibrationReport(rows.file, len(rows), (), panels, notes)
    finish_calibration("gyro", gyro_response.gyro_calibration(rows, fit), report, out, plot, as_json)


PROCEDURES = (
    calibrate_rudder,
    calibrate_hull,
    calibrate_thrust,
    calibrate_reverse,
    calibrate_inertia,
    calibrate_friction,
    calibrate_gyro,
)


def _report(rows: Measurements, fit: LinearFit, column: str, *panels: FitPanel) -> CalibrationReport:
    return CalibrationReport(rows.file, len(rows), _describe_outliers(rows, fit, column, fit.residuals), panels)


def _describe_outliers(rows: Measurements, fit: LinearFit, column: str, rest: Any) -> tuple[str, ...]:
    """Describe each rejected reading: file line, column, value and deviation from the fit."""
    return tuple(
        f"line {rows.lines[i]}, column {column!r}: {rows[column][i]:.6g} deviates by {abs(rest[i]):.3g} from the fit"
        for i in np.flatnonzero(~fit.kept)
    )


def _curve(x: Any, y: Any, fit: LinearFit, line: tuple[Any, Any], scale: float) -> FitCurve:
    return FitCurve(x, y, y - fit.residuals * scale, fit.kept, *line)


def _band(A: Any, fit: LinearFit) -> Any:
    """Return half the width of the 95 % confidence interval of each fitted value, one for each matrix row of A."""
    P = fit.covariance[: A.shape[1], : A.shape[1]]
    return student_reach(fit.freedom) * np.sqrt(np.einsum("ij,jk,ik->i", A, P, A))


def _thrust_panel(rows: Measurements, fit: thrust.ThrustFit, offset: float) -> FitPanel:
    curves = []
    for angle in fit.angles:
        of = np.abs(rows["rudder"] - angle) < 0.06 * DEG
        n = np.linspace(0, rows["speed"].max(), 60) * 1e-3
        c = fit.coefficient * np.cos(angle - offset)
        fitted = c * (rows["speed"][of] * 1e-3) ** 2
        curves.append(
            FitCurve(
                rows["speed"][of] * 1e-3,
                rows["force"][of],
                fitted,
                fit.fit.kept[of],
                n,
                c * n * n,
                label=f"{angle / DEG:.0f}°",
            )
        )
    return FitPanel("Thrust", "speed (krpm)", "force (N)", curves, f"{fit.coefficient:.5f} N/krpm²")


def _eta_panel(fit: thrust.ThrustFit, offset: float) -> FitPanel:
    line = np.linspace(fit.angles.min(), fit.angles.max(), 60)
    at_angles, at_line = (fit.coefficient * np.cos(a - offset) for a in (fit.angles, line))
    curve = FitCurve(fit.angles / DEG, fit.by_angle, at_angles, np.ones(len(fit.angles), bool), line / DEG, at_line)
    return FitPanel(
        "Loss of thrust with the rudder", "rudder (°)", "force/speed² (N/krpm²)", [curve], f"p = {fit.chance:.2g}"
    )
