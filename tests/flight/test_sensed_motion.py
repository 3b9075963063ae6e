"""A vehicle's motion measured by its sensors: speeds, distances, means, from samples set by the test."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from trimtab.core.time import ms, seconds
from trimtab.flight.sensed_motion import SensedMotion
from trimtab.loop.vehicle_limits import VehicleLimits

SENSORS = {
    "imu": {"angular_rate": 3},
    "doppler": {"surge_velocity": 1, "sway_velocity": 1},
    "gps": {"north": 1, "east": 1},
}


class Body:
    """Samples in a vector, as a compiled world has them."""

    def __init__(self, sensors=SENSORS):
        self.samples, writes, k = dict.fromkeys(sensors), {}, 0
        for sensor, fields in sensors.items():
            for name, size in {"t": 1, "valid": 1, **{f"value.{f}": n for f, n in fields.items()}}.items():
                writes[f"downlink.{sensor}.{name}"] = slice(k, k + size) if size > 1 else k
                k += size
        self.world = SimpleNamespace(writes=writes, outputs=np.zeros(k))

    def set(self, sensor, **values):
        for name, value in {"valid": 1, **{f"value.{n}": v for n, v in values.items()}}.items():
            self.world.outputs[self.world.writes[f"downlink.{sensor}.{name}"]] = value


@pytest.fixture
def body():
    body = Body()
    body.set("imu", angular_rate=[0.0, 0.3, 0.4])
    body.set("doppler", surge_velocity=-3.0, sway_velocity=4.0)
    body.set("gps", north=6.0, east=8.0)
    return body


def test_motion_quantities_are_norms_of_sensor_values(body):
    motion = SensedMotion(body, VehicleLimits())
    values = {name: motion.value(name) for name in ("rate", "speed", "distance", "angle")}
    assert [values[n] for n in ("rate", "speed", "distance")] == pytest.approx([0.5, 5.0, 10.0])
    assert math.isnan(values["angle"])
    assert [motion.sensor(n) for n in values] == ["imu", "doppler", "gps", ""]
    body.world.outputs[body.world.writes["downlink.gps.valid"]] = 0
    assert math.isnan(motion.value("distance"))


def test_breach_needs_patience_and_resets_inside_the_limit(body):
    motion = SensedMotion(body, VehicleLimits(distance=9.0, patience=ms(100)))
    assert motion.find_breach(0, {}) is None
    assert motion.find_breach(ms(99), {}) is None
    assert motion.find_breach(ms(100), {}) == ("fence", "distance 10 m, at most 9, by gps")
    body.set("gps", north=0.0)
    assert motion.find_breach(ms(110), {}) is None
    body.set("gps", north=6.0)
    assert motion.find_breach(ms(120), {}) is None  # it begins anew
    assert motion.find_breach(ms(130), {"imu": 2.0}) is None  # which tells nothing of the distance
    assert motion.find_breach(ms(130), {"gps": 0.5}) == ("fence", "distance not known, no data from gps for 0.5 s")


@pytest.mark.parametrize("sign", [1, -1])
def test_angle_of_attack_breaches_its_limit_after_the_patience(sign):
    body = Body({"vane": {"alpha": 1}})
    motion = SensedMotion(body, VehicleLimits(angle=0.2, patience=ms(100)))
    body.set("vane", alpha=sign * 0.2)
    assert (motion.find_breach(0, {}), motion.find_breach(seconds(1), {})) == (None, None)
    body.set("vane", alpha=sign * 0.21)
    assert (motion.find_breach(seconds(2), {}), motion.find_breach(seconds(2) + ms(99), {})) == (None, None)
    breach = "envelope", "angle 0.21 rad, at most 0.2, by vane"
    assert motion.find_breach(seconds(2) + ms(100), {}) == breach
    silent = "envelope", "angle not known, no data from vane for 0.5 s"
    assert motion.find_breach(seconds(3), {"vane": 0.5}) == silent
    body.set("vane", alpha=math.nan)
    assert motion.find_breach(seconds(3), {}).text.startswith("angle nan rad")


def test_rest_is_mean_motion_over_the_rest_time(body):
    motion = SensedMotion(body, VehicleLimits(rest_time=seconds(1)))
    assert motion.mean_motion() == (math.inf, math.inf)
    for k in range(9):
        motion.note_moment(k * ms(100))
    assert motion.mean_motion() == (math.inf, math.inf)  # not for long enough
    body.set("doppler", surge_velocity=0.0, sway_velocity=0.0)
    for k in range(9, 14):
        motion.note_moment(k * ms(100))
    assert motion.mean_motion() == pytest.approx((5.0 * 6 / 11, 0.5))


def test_mean_motion_is_nan_without_motion_sensors():
    body = Body()
    del body.samples["doppler"], body.samples["imu"]
    motion = SensedMotion(body, VehicleLimits())
    for k in range(12):
        motion.note_moment(k * ms(100))
    assert all(map(math.isnan, motion.mean_motion()))
