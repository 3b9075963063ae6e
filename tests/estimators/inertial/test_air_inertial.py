"""Estimate for the F-16's law from IMU, GNSS and air data: truth with ideal sensors, invalid before a fix."""

import jax
import numpy as np
import pytest

from trimtab import build
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.rotation import DEG
from trimtab.core.time import ms
from trimtab.run.simulate import simulate
from trimtab.scenarios.f16._navigation import STATION
from trimtab.sensors.flight_instruments import FlightInstruments
from trimtab.vehicles.f16 import F16Controls
from trimtab.vehicles.f16_flat_earth import GRAVITY, F16State

pytestmark = [pytest.mark.thorough, pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")]
NUMBERS = {
    "alpha": 1e-9,
    "beta": 1e-9,
    "altitude": 0.6,
    "roll": 0.6 * DEG,
    "pitch": 0.6 * DEG,
    "roll_rate": 0.02 * DEG,
    "pitch_rate": 0.02 * DEG,
    "yaw_rate": 0.02 * DEG,
    "normal_load": 0.005,
    "side_load": 0.005,
}
"""What the law reads, and how far it may be off: the start is one sigma wrong, no sensor errs."""


@pytest.fixture(scope="module")
def flight():
    """Without sensor errors, but with the start errors that the filter assumes."""
    scenario = build("f16/gcas", {"navigation": "gnss-inertial"})
    for name in ("imu-noise", "imu-turn-on-bias", "imu-bias-walk", "gnss-noise", "gnss-latency"):
        scenario = scenario.without(name)
    for name in ("pressure-noise", "pressure-bias", "vane-noise", "vane-bias"):
        scenario = scenario.without(f"air-data-{name}")
    return scenario, simulate(scenario, seed=0, log_period=ms(5))


def test_estimate_equals_truth_with_ideal_sensors(flight):
    """Oracle: ideal flight instruments, which compute the same numbers from the motion."""
    scenario, log = flight
    rows = np.arange(200, len(log), 2)  # from 1 s on, when it samples; surfaces as they acted up to there
    truth = F16State(**{n: log[f"truth.{n}"][rows] for n in F16State.__dataclass_fields__})
    acts = F16Controls(**{n: log[f"actuators.u.{n}"][rows - 1] for n in F16Controls.__dataclass_fields__})
    oracle, vehicle = FlightInstruments(lever_arm=STATION, gravity=GRAVITY), scenario.world.vehicle
    read = jax.jit(jax.vmap(lambda x, u: oracle.measure(vehicle.motion(0, x, u))))(truth, acts)
    for name, most in NUMBERS.items():
        off = np.abs(log[f"estimate.state.{name}"][rows] - np.asarray(getattr(read, name)))
        print(f"{name}: {off.max():.2g}, allowed {most:.2g}")
        assert off.max() < most
    assert np.abs(log["estimate.state.speed"][rows] - truth.speed).max() < 0.5  # of another atmosphere's table


def test_estimate_is_invalid_before_the_first_fix(flight):
    _, log = flight
    valid, used = log["estimate.valid"], log["estimate.state.inertial.gnss_fix.used"]
    assert not valid[0]
    assert np.array_equal(valid, used > 0)
