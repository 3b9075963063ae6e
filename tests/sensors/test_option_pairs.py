"""Options of the sensors that measure a motion, two at a time, against numpy written out: order and frames of each.

Each option alone is tested beside its sensor; in pairs it shows which comes first, and what is turned into which frame.
"""

from itertools import combinations

import jax
import numpy as np
import pytest

from trimtab.core.record import leaves, replace, to_arrays
from trimtab.core.rng import key
from trimtab.core.signals import Motion
from trimtab.environment.acoustics import Air, range_ratio, speed_of_sound
from trimtab.sensors.imu import AccelerometerErrors, GyroErrors, Imu
from trimtab.sensors.magnetometer import FloorSteel, Magnetometer, RunningMotor
from trimtab.sensors.time_of_flight import CEILING_SQUARE, Beacons, Medium, RangeErrors
from trimtab.sensors.ultrasonic_ranging import UltrasonicRanging, UnitClock

MOTION = Motion(
    5_000_000,
    np.array([0.4, -0.7, -0.1]),
    np.array([0.2, -0.3, 1.1]),
    np.array([0.9, -0.4, 0.2]),
    np.array([0.3, -0.5, 0.8]),
    np.array([0.6, 0.1, -0.7]),
    np.array([-1.5, 0.9, 2.0]),
)
DRAWS = np.array([0.3, -1.2, 0.8, 0.5, 1.1, -0.6, -0.9, 0.4, 1.3, -0.2, 0.7, -1.4])
WALK = np.array([0.02, -0.03, 0.05])


def euler(roll, pitch, yaw):
    """Body to world, as the product of three turns."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (roll, pitch, yaw))
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return z @ y @ x


def converted(output, most, step):
    """Clipped, then rounded to steps; whether an axis is at its limit."""
    clipped = np.clip(output, -most, most) if most else output
    return (np.round(clipped / step) * step if step else clipped), bool(most and np.abs(output).max() >= most)


UNIT = {
    "lever": {"lever_arm": (0.4, -0.3, 0.2)},
    "mounting": {"mounting": (0.5, -0.2, 0.9)},
    "earth": {"earth_rate": (0.3, -0.2, 0.4)},
    "gravity": {"gravity": (1.0, -2.0, 9.0)},
    "bias": {"bias": (0.11, -0.07, 0.05)},
    "turn-on": {"turn_on_bias": 0.06},
    "scale": {"scale_factor": 0.05},
    "misalignment": {"misalignment": 0.04},
    "saturation": {"range": 1.3},
    "steps": {"resolution": 0.25},
}


def unit_of(options):
    own = {k: v for k, v in options.items() if k in ("lever_arm", "mounting", "earth_rate", "gravity")}
    errors = {k: v for k, v in options.items() if k not in own}
    return Imu(accelerometer=AccelerometerErrors(**errors), gyro=GyroErrors(**errors), **own)


def expected_triad(true, o):
    distortion = np.eye(3) + np.diag(o.get("scale_factor", 0.0) * DRAWS[3:6])
    off = iter(o.get("misalignment", 0.0) * DRAWS[6:])
    for i in range(3):
        for j in range(3):
            if i != j:
                distortion[i, j] = next(off)
    bias = np.array(o.get("bias", (0, 0, 0))) + o.get("turn_on_bias", 0.0) * DRAWS[:3] + WALK
    return converted(distortion @ true + bias, o.get("range", 0.0), o.get("resolution", 0.0))


def expected_unit(o):
    R_WB, S_B = euler(*MOTION.attitude), euler(*o.get("mounting", (0, 0, 0))).T
    earth, arm = R_WB.T @ o.get("earth_rate", (0, 0, 0)), np.array(o.get("lever_arm", (0, 0, 0)))
    w, gravity = MOTION.w_WB_B, R_WB.T @ o.get("gravity", (0, 0, 9.80665))
    a = MOTION.a_WB_B + 2 * np.cross(earth, MOTION.v_WB_B) + np.cross(MOTION.alpha_WB_B, arm)
    a = a + np.cross(w, np.cross(w, arm)) - gravity
    force, full = expected_triad(S_B @ a, o)
    rate, gyro_full = expected_triad(S_B @ (w + earth), o)
    return force, rate, full, gyro_full


@jax.jit
def _unit_reading(imu):
    state = imu.init(key(0))
    triads = {name: replace(getattr(state, name), draws=DRAWS, walk=WALK) for name in ("accelerometer", "gyro")}
    return imu.step(MOTION.t, replace(state, **triads), MOTION)[1].value


@pytest.mark.parametrize(("one", "other"), list(combinations(UNIT, 2)))
def test_imu_option_pairs_match_numpy_reference(one, other):
    options = UNIT[one] | UNIT[other]
    reading = _unit_reading(to_arrays(unit_of(options)))
    force, rate, full, gyro_full = expected_unit(options)
    np.testing.assert_allclose(reading.specific_force, force, atol=1e-13)
    np.testing.assert_allclose(reading.angular_rate, rate, atol=1e-13)
    assert (bool(reading.accelerometer_saturated), bool(reading.gyro_saturated)) == (full, gyro_full)


MOTOR = {"position": (-0.2, 0.1, 0.05), "moment": (0.1, 0.3, -0.2), "duty": -0.6}
STEEL = {"position": (1.0, 0.5, 0.3), "moment": (20.0, -10.0, 40.0)}
COMPASS = {
    "mounting": {"mounting": (0.5, -0.2, 0.9)},
    "place": {"position": (0.1, -0.2, 0.3)},
    "hard": {"hard_iron": (1e-5, -2e-5, 3e-5)},
    "soft": {"soft_iron": ((1.1, 0.2, 0.0), (-0.1, 0.9, 0.05), (0.0, 0.3, 1.2))},
    "motor": {"motor": MOTOR},
    "steel": {"steel": STEEL},
    "saturation": {"range": 3e-5},
    "steps": {"resolution": 7e-6},
}


def compass_of(options):
    near = []
    if "motor" in options:
        motor = options["motor"]
        near.append(RunningMotor(motor["position"], motor["moment"], 0.0, (0,), (motor["duty"],)))
    if "steel" in options:
        near.append(FloorSteel(**options["steel"], size=0.0))
    own = {k: v for k, v in options.items() if k not in ("motor", "steel")}
    return Magnetometer(earth_field=(2.1e-5, -0.4e-5, 4.6e-5), disturbances=tuple(near), **own)


def dipole(moment, away):
    r = np.linalg.norm(away)
    return 1e-7 * (3 * np.dot(moment, away) * away / r**2 - moment) / r**3


def expected_field(o):
    R_WB, S_B = euler(*MOTION.attitude), euler(*o.get("mounting", (0, 0, 0))).T
    place = np.array(o.get("position", (0, 0, 0)))
    field = R_WB.T @ (2.1e-5, -0.4e-5, 4.6e-5)
    if "motor" in o:
        motor = o["motor"]
        field = field + dipole(motor["duty"] * np.array(motor["moment"]), place - motor["position"])
    if "steel" in o:
        away = MOTION.p_WB + R_WB @ place - o["steel"]["position"]
        field = field + R_WB.T @ dipole(np.array(o["steel"]["moment"]), away)
    output = np.array(o.get("soft_iron", np.eye(3))) @ (S_B @ field) + o.get("hard_iron", (0, 0, 0))
    return converted(output, o.get("range", 0.0), o.get("resolution", 0.0))


@jax.jit
def _field_reading(sensor):
    return sensor.step(MOTION.t, sensor.init(key(0)), MOTION)[1].value


@pytest.mark.parametrize(("one", "other"), list(combinations(COMPASS, 2)))
def test_magnetometer_option_pairs_match_numpy_reference(one, other):
    options = COMPASS[one] | COMPASS[other]
    reading = _field_reading(to_arrays(compass_of(options)))
    field, full = expected_field(options)
    np.testing.assert_allclose(reading.field, field, atol=1e-18)
    assert bool(reading.saturated) == full


PLACE, LEVEL, TILTED = np.array([0.3, -0.4, -0.05]), (0.0, 0.0, 0.8), (0.15, -0.2, 0.8)
RANGING = {
    "lever": {"units": ((0.25, -0.1, 0.06),)},
    "tilt": {"attitude": TILTED},
    "moved": {"moved": np.array([[0.3, -0.2, 0.1], [0, 0, 0], [0, 0.4, 0], [-0.1, 0, 0.2]])},
    "dead": {"dead": np.array([False, True, False, False])},
    "later": {"fault_time": 10_000_000},
    "warm": {"actual": 303.15, "assumed": 285.15},
    "no cone error": {"cone_error": False},
    "reach": {"reach": 3.3},
    "cone": {"cone": 0.6},
}
BEACONS = ("moved", "dead", "fault_time", "reach", "cone")
SHAPES = {"units": ((0.0, 0.0, 0.0),), "moved": np.zeros((4, 3)), "dead": np.zeros(4, bool)}
"""Neutral values of the arrays. With them all sensors have one structure, so that two programs serve all pairs."""


def ranging_of(o):
    o = SHAPES | o
    quiet = RangeErrors(**{name: 0.0 for name, _, _ in leaves(RangeErrors())})
    beacons = Beacons(map=CEILING_SQUARE, survey_error=0.0, crystal=0.0, **{k: o[k] for k in BEACONS if k in o})
    medium = Medium(Air(temperature=o.get("actual", 293.15)), Air(temperature=o.get("assumed", 293.15)))
    clock = UnitClock(**dict.fromkeys(("residual", "drift", "tick"), 0.0))
    own = {k: o[k] for k in ("units", "cone_error") if k in o}
    return UltrasonicRanging(beacons=beacons, errors=quiet, medium=medium, clock=clock, collisions=False, **own)


ratio_of = jax.jit(range_ratio)
speed_in = jax.jit(lambda temperature: speed_of_sound(Air(temperature=temperature)))


def expected_ranges(o):
    happened = MOTION.t >= o.get("fault_time", 0)
    beacons = CEILING_SQUARE + (o.get("moved", 0.0) if happened else 0.0)
    unit = PLACE + euler(*o.get("attitude", LEVEL)) @ o.get("units", ((0, 0, 0),))[0]
    line = unit - beacons
    distance = np.linalg.norm(line, axis=1)
    beta = np.arccos(line[:, 2] / distance)
    hears = (distance <= o.get("reach", Beacons().reach)) & (beta <= o.get("cone", Beacons().cone))
    hears &= ~(o.get("dead", np.zeros(4, bool)) & happened)
    told = distance / np.asarray(ratio_of(beta)) if o.get("cone_error", True) else distance
    assumed, actual = (float(speed_in(o.get(w, 293.15))) for w in ("assumed", "actual"))
    return np.where(hears, told * assumed / actual, 0.0), hears


@pytest.mark.parametrize(("one", "other"), list(combinations(RANGING, 2)))
def test_ultrasonic_option_pairs_match_numpy_reference(one, other):
    options = RANGING[one] | RANGING[other]
    sensor = to_arrays(ranging_of(options))
    motion = replace(MOTION, p_WB=PLACE, attitude=np.array(options.get("attitude", LEVEL)))
    replies, _ = _replies(sensor, motion)
    ranges, hears = expected_ranges(options)
    np.testing.assert_array_equal(replies.arrived, hears)
    np.testing.assert_allclose(replies.range, ranges, rtol=1e-12, atol=1e-12)


@jax.jit
def _replies(sensor, motion):
    return sensor.ping(motion.t, key(0), motion)
