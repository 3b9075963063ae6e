"""Virtual test bench: simulated measurements for the calibration procedures of [1], for a craft with known parameters.

The data include the errors of a real bench: a force gauge with divisions of 0.1 N, read to half a division; a tether
with friction; a protractor read to half a degree; a linkage with play; a battery whose voltage sags between readings;
and a fan speed set by hand.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section 4.3.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import lax
from scipy.signal import lfilter

from trimtab.actuators.rudder import RudderGeometry, RudderServo
from trimtab.actuators.thruster import Thruster
from trimtab.core.integrate import rk4
from trimtab.core.record import replace, to_arrays
from trimtab.core.rotation import DEG
from trimtab.core.signals import PlanarForce
from trimtab.core.time import to_seconds
from trimtab.links.latency import TABLE
from trimtab.loop.calibration import Calibration, Entry
from trimtab.sensors.gyro_dynamics import TICK, IdentifiedGyro
from trimtab.vehicles.hovercraft import Friction, Hovercraft, HovercraftState

PAIR = "free2move/linksys 2.9/22.0"
GYRO_DELAY = 2
"""Delay of the gyro in samples, in addition to the model of [1] table 6.5."""
DIVISION, TETHER = 0.1, 0.02
"""Scale division of the force gauge (N), and largest friction force of the tether (N)."""
PROTRACTOR, PLAY = 0.5 * DEG, 0.4 * DEG
"""Standard deviation of a protractor reading (rad), and half the play of the linkage (rad)."""
SPIN_UP_FORCE, SPIN_UP_RUDDER = 1.1, -20 * DEG
Rows = tuple[Sequence[str], Sequence[Sequence[float]]]
"""Table of measurements: column headings with units, and rows of numbers."""


class BenchCraft(NamedTuple):
    """Craft on the virtual bench. delay: mean, standard deviation and minimum of the uplink latency (s)."""

    servo: RudderServo
    geometry: RudderGeometry
    thruster: Thruster
    vehicle: Hovercraft
    gyro: IdentifiedGyro
    delay: tuple[float, float, float]

    def true_calibration(self) -> Calibration:
        """Return the true parameters, with the names that a calibration uses."""
        t, g, f = self.thruster, self.gyro, self.vehicle.friction
        numbers = {
            "RudderServo.angles": (self.servo.angles, "rad"),
            "RudderGeometry.ratio": (self.geometry.ratio, "1"),
            "RudderGeometry.offset": (self.geometry.offset, "rad"),
            "Thruster.offset": (self.geometry.offset, "rad"),
            "Thruster.coefficient": (t.coefficient, "N/krpm^2"),
            "Thruster.reverse_ratio": (t.reverse_ratio, "1"),
            "Hovercraft.inertia": (self.vehicle.inertia, "kg m^2"),
            "Friction.torque_coulomb": (f.torque_coulomb, "N m"),
            "Friction.torque_viscous": (f.torque_viscous, "N m s"),
            "Friction.torque_quadratic": (f.torque_quadratic, "N m s^2"),
            "IdentifiedGyro.b0": (g.b0, "1"),
            "IdentifiedGyro.a1": (g.a1, "1"),
            "IdentifiedGyro.a2": (g.a2, "1"),
            "uplink.mean": (self.delay[0], "s"),
        }
        about: dict[str, Any] = {"source": "the virtual bench's craft", "procedure": "truth"}
        return Calibration({n: Entry(np.asarray(v, float).tolist(), unit, **about) for n, (v, unit) in numbers.items()})


def draw_craft(seed: int) -> BenchCraft:
    """Return a craft with random parameters near those of [1]. They scatter as among craft of one design."""
    g = np.random.default_rng([seed, 1])

    def near(value: float, share: float) -> float:
        return float(value) * (1 + share * g.uniform(-1, 1))

    servo, geometry, fan, craft, gyro = RudderServo(), RudderGeometry(), Thruster(), Hovercraft(), IdentifiedGyro()
    offset = near(geometry.offset, 0.8)
    angles = np.asarray(servo.angles) * near(1.0, 0.1) + 1.5 * DEG * g.uniform(-1, 1)
    row = TABLE[PAIR]["up"]
    friction = Friction(
        torque_coulomb=near(0.004, 0.5), torque_viscous=near(0.01, 0.5), torque_quadratic=near(0.004, 0.5)
    )
    return BenchCraft(
        servo=replace(servo, angles=angles, angle_min=float(angles[0]), angle_max=float(angles[-1])),
        geometry=replace(geometry, ratio=near(geometry.ratio, 0.1), offset=offset),
        thruster=replace(
            fan,
            coefficient=near(fan.coefficient, 0.15),
            offset=offset,
            reverse_ratio=fan.reverse_ratio * near(1.0, 0.1),
        ),
        vehicle=replace(craft, inertia=near(craft.inertia, 0.2), friction=friction),
        gyro=replace(gyro, b0=near(gyro.b0, 0.05), a1=near(gyro.a1, 0.05), a2=near(gyro.a2, 0.05), normalised=False),
        delay=(near(row.mean_ms / 1e3, 0.2), near(row.sd_ms / 1e3, 0.2), row.min_ms / 1e3 - 0.002),
    )


def run_bench(craft: BenchCraft, seed: int) -> dict[str, Rows]:
    """Simulate the measurements of every calibration procedure once. Return file name -> table."""
    g = np.random.default_rng([seed, 2])
    procedures: Mapping[str, Callable[[BenchCraft, np.random.Generator], Rows]] = {
        "servo.csv": _measure_servo,
        "hull.csv": _measure_hull,
        "thrust.csv": _measure_thrust,
        "reverse.csv": _measure_reverse,
        "trials.csv": _measure_trials,
        "spin-up.csv": _log_spin_up,
        "coast.csv": _log_coast_down,
        "sweep.csv": _log_sweep,
        "up.csv": _record_delays,
    }
    return {name: measure(craft, g) for name, measure in procedures.items()}


def write_bench(folder: Path, tables: Mapping[str, Rows]) -> list[Path]:
    """Write the tables as CSV files. Return the files' paths."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for name, (headings, rows) in tables.items():
        lines = [",".join(headings), *(",".join("" if np.isnan(v) else f"{v:.10g}" for v in row) for row in rows)]
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
        files.append(folder / name)
    return files


def _measure_servo(craft: BenchCraft, g: np.random.Generator) -> Rows:
    """Measure the servo's angle at rising and falling pulses, three times. The rudder lags by the linkage's play."""
    pulses, rows = 1.0e-3 + 50e-6 * np.arange(21), []
    for trial in range(1, 7):
        way = 1 if trial % 2 else -1
        angles = np.asarray(craft.servo.angles) - way * PLAY + PROTRACTOR * g.standard_normal(21)
        seen = zip(pulses[::way], angles[::way], strict=True)
        rows += [[1e6 * p, round(a / DEG * 2) / 2, way, trial] for p, a in seen]
    return ("pulse [us]", "angle [deg]", "way", "trial"), rows


def _measure_hull(craft: BenchCraft, g: np.random.Generator) -> Rows:
    """Measure the angle of the tethered hull at 13 rudder angles, approached from both sides."""
    rows = []
    for trial in (1, 2, 3, 4):
        theta = np.arange(-30, 31, 5) * DEG
        psi = (craft.geometry.offset - theta) / craft.geometry.ratio
        way = 1 if trial % 2 else -1
        seen = psi - way * PLAY + 0.7 * PROTRACTOR * g.standard_normal(len(psi))
        rows += [[t / DEG, round(p / DEG * 2) / 2, way, trial] for t, p in zip(theta, seen, strict=True)]
    return ("rudder [deg]", "hull [deg]", "way", "trial"), rows


def _read_gauge(force: Any, g: np.random.Generator) -> Any:
    """Return a gauge reading, rounded to half a division. Friction of the tether increases or reduces the force."""
    held = force + TETHER * g.uniform(-1, 1, np.shape(force)) + 0.02 * g.standard_normal(np.shape(force))
    return np.maximum(np.round(held / (DIVISION / 2)) * (DIVISION / 2), 0)


def _draw_speeds(steps: Any, g: np.random.Generator) -> Any:
    """Return tachometer readings (rpm) for intended speeds `steps`, with errors of manual setting and battery sag."""
    sag = 1 - 0.06 * np.linspace(0, 1, len(steps)) * (np.asarray(steps) / 12000) ** 2
    return np.round(np.asarray(steps) * sag * (1 + 0.01 * g.standard_normal(len(steps))), -1)


def _measure_thrust(craft: BenchCraft, g: np.random.Generator) -> Rows:
    """Measure the thrust twice at nine rudder angles and eight fan speeds."""
    rows = []
    for trial in (1, 2):
        for theta in np.arange(-40, 41, 10) * DEG:
            speed = np.minimum(_draw_speeds(np.arange(5000, 12001, 1000), g), 12000)
            force = craft.thruster.force(speed, theta)
            rows += [[theta / DEG, n, F, trial] for n, F in zip(speed, _read_gauge(force, g), strict=True)]
    return ("rudder [deg]", "speed [rpm]", "force [N]", "trial"), rows


def _measure_reverse(craft: BenchCraft, g: np.random.Generator) -> Rows:
    """Measure forward and reverse thrust three times at thirteen fan speeds, with the rudder straight."""
    rows, straight = [], craft.thruster.offset
    for trial in (1, 2, 3):
        for n in np.arange(6000, 12001, 500):
            forward, back = (craft.thruster.force(np.float64(s * n), straight) for s in (1, -1))
            rows.append([n, *(float(_read_gauge(abs(F), g)) for F in (forward, back)), trial])
    return ("speed [rpm]", "forward [N]", "reverse [N]", "trial"), rows


def _measure_trials(craft: BenchCraft, g: np.random.Generator) -> Rows:
    """Measure the initial slope of the yaw rate in ten spin-ups, five to each side."""
    rows = []
    for trial in range(1, 11):
        theta = (-20 if trial % 2 else 25) * DEG
        force = 1.05 + 0.1 * g.uniform()
        FY = -force * np.sin((craft.geometry.offset - theta) / craft.geometry.ratio)
        slope = -craft.vehicle.arm * FY / craft.vehicle.inertia
        read = force + 0.02 * g.standard_normal()
        rows.append([theta / DEG, round(read, 2), slope * (1 + 0.01 * g.standard_normal()), trial])
    return ("rudder [deg]", "force [N]", "slope [rad/s^2]", "trial"), rows


def _log_spin_up(craft: BenchCraft, g: np.random.Generator) -> Rows:
    """Log the yaw rate every 20 ms. The craft is held for a second and then released at constant thrust."""
    psi = (craft.geometry.offset - SPIN_UP_RUDDER) / craft.geometry.ratio
    push = PlanarForce(SPIN_UP_FORCE * np.cos(psi), -SPIN_UP_FORCE * np.sin(psi))
    rate = _spin(craft.vehicle, push, 0.0, 0.02, 150)
    held = np.concatenate([np.zeros(50), rate]) + 0.01 * g.standard_normal(200)
    return ("time [s]", "yaw_rate [rad/s]"), list(zip(0.02 * np.arange(200), held, strict=True))


def _log_coast_down(craft: BenchCraft, g: np.random.Generator) -> Rows:
    """Log the yaw rate of three spins that coast down."""
    rows = []
    for trial, start in enumerate((6.0, -4.0, 2.0), 1):
        rate = _spin(craft.vehicle, PlanarForce(0.0, 0.0), start, 0.05, 240)
        seen = np.concatenate([[start], rate[:-1]]) + 0.01 * g.standard_normal(240)
        rows += [[0.05 * k, r, trial] for k, r in enumerate(seen)]
    return ("time [s]", "yaw_rate [rad/s]", "trial"), rows


def _log_sweep(craft: BenchCraft, g: np.random.Generator) -> Rows:
    """Log the gyro on a turntable that oscillates at a frequency rising to 40 Hz in 20 s."""
    T = to_seconds(TICK)
    t = T * np.arange(3000)
    u = 2.0 * np.sin(np.pi * (40 / t[-1]) * t**2)
    late = np.concatenate([np.full(GYRO_DELAY, u[0]), u[:-GYRO_DELAY]])
    y = np.asarray(lfilter([craft.gyro.b0], [1.0, craft.gyro.a1, craft.gyro.a2], late))
    y = y + 0.01 + 0.013 * g.standard_normal(len(t))
    return ("time [s]", "reference [rad/s]", "gyro [rad/s]"), list(zip(t, u, y, strict=True))


def _record_delays(craft: BenchCraft, g: np.random.Generator) -> Rows:
    """Record the delays of three hundred packets, as `link-test` does. One packet in a hundred is lost."""
    mean, sd, shift = craft.delay
    shape = ((mean - shift) / sd) ** 2
    delays = shift + g.gamma(shape, sd**2 / (mean - shift), 300)
    lost = g.uniform(size=300) < 0.01
    return ("sent_s", "latency_s"), [[0.1 * k, np.nan if lost[k] else d] for k, d in enumerate(delays)]


@jax.jit(static_argnums=(4,))
def _spin(vehicle: Hovercraft, push: PlanarForce, start: Any, dt: Any, n: int) -> Any:
    """Return yaw rates (n,) at dt, 2 dt, … n dt (s), from the initial rate `start` (rad/s). Integration step: dt/20."""
    parts = 20

    def advance(x: HovercraftState, _: Any) -> Any:
        def part(x: HovercraftState, _: Any) -> Any:
            return rk4(lambda t, x: vehicle.dynamics(t, x, push), 0.0, x, dt / parts), None

        x, _ = lax.scan(part, x, None, length=parts)
        return x, x.yaw_rate

    return lax.scan(advance, replace(to_arrays(HovercraftState()), yaw_rate=start * 1.0), None, length=n)[1]
