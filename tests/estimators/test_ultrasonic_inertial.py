"""The hovercraft's navigation system flown in the loop: truth is known, every fault can be switched off."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import seconds
from trimtab.estimators.aided_inertial import Intake
from trimtab.estimators.aided_inertial_coupled import AidedInertialCoupled
from trimtab.estimators.ranging_position import RangingPosition
from trimtab.estimators.ultrasonic_inertial import PAIR, UltrasonicInertial
from trimtab.run.simulate import simulate_many
from trimtab.scenarios import catalogue

SIGNALS = ("surge_velocity", "sway_velocity", "heading", "north", "east")
SEEDS = range(16)


@pytest.fixture(scope="module")
def scenario():
    made, _ = catalogue.load("hovercraft/zero-velocity", {"navigation": "ins"})
    return replace(made, duration=seconds(8), initial=replace(made.initial, yaw_rate=np.float64(2.0)))


def flown(scenario, seeds=SEEDS):
    return simulate_many(scenario, seeds=seeds, signals=("truth", "estimate"))


def errors(log, signal):
    """Estimate less truth at the time of the estimate's newest sample, and the sigma."""
    then = np.interp(log.t - log["estimate.age"], log.t, log[f"truth.{signal}"])
    error = log[f"estimate.state.{signal}"] - then
    if signal == "heading":
        error = (error + np.pi) % (2 * np.pi) - np.pi
    return error, log[f"estimate.state.sigma_{signal}"]


def faultless(scenario):
    """All faults of the sensors off but collisions: then replies are missing, and none is wrong."""
    sensors = [n for n, where in scenario.imperfections().items() if any("sensors" in path for path, _ in where)]
    for name in set(sensors) - {"collisions", "cone-error"}:
        scenario = scenario.without(name)
    return scenario


def test_with_perfect_sensors_it_finds_the_truth(scenario):
    """What is left: the way from a start that knows nothing, which the filter's own noise takes seconds to forget."""
    (log,) = flown(faultless(scenario), [3])
    late = log.t > 7
    assert log["estimate.valid"][late].all()
    for signal, bound in zip(SIGNALS, (0.004, 0.004, 0.002, 0.002, 0.002), strict=True):
        assert np.abs(errors(log, signal)[0][late]).max() < bound, signal


def test_errors_are_as_large_as_it_says(scenario):
    """On sensors with all their faults, errors of survey and temperature constant over a flight among them."""
    logs = flown(scenario)
    for signal in SIGNALS:
        normalised = np.array([np.mean((e / s)[log.t > 3] ** 2) for log in logs for e, s in [errors(log, signal)]])
        print(signal, np.sqrt(normalised.mean()))
        assert 0.2 < normalised.mean() < 1.3, signal
        assert np.quantile(normalised, 0.9) < 4, signal


def test_it_starts_by_itself(scenario):
    """Heading and position unknown, turning at 2 rad/s: both fixes within 0.3 s, a hundredth of a turn within 3 s."""
    for log in flown(scenario, range(4)):
        assert log.t[np.argmax(log["estimate.valid"])] < 0.4
        assert np.abs(errors(log, "heading")[0][log.t > 3]).max() < 0.06


def test_a_beacon_moved_by_half_a_metre_is_left_out(scenario):
    n = len(scenario.world.sensors["ranging"].beacons.map)
    moved = np.zeros((n, 3))
    nearest = np.argmin(np.sum(scenario.world.sensors["ranging"].beacons.map[:, :2] ** 2, axis=1))
    moved[nearest] = (0.5, 0.0, 0.0)
    ranging = scenario.world.sensors["ranging"]
    wrong = replace(ranging, beacons=replace(ranging.beacons, moved=moved, fault_time=seconds(3)))
    world = replace(scenario.world, sensors=scenario.world.sensors | {"ranging": wrong})
    for log in flown(replace(scenario, world=world), range(6)):
        late = log.t > 3.5
        for signal in ("north", "east"):
            error, sigma = errors(log, signal)
            assert np.abs(error[late]).max() < 0.15
            assert np.abs(error / sigma)[late].max() < 8


def test_parts_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="one ultrasonic unit and no magnetometer"):
        UltrasonicInertial(positioning=RangingPosition()).check()
    one = UltrasonicInertial(positioning=RangingPosition(), inertial=AidedInertialCoupled())
    one.check()
    assert one.listens == ("imu", "ranging")
    assert UltrasonicInertial(magnetometer="compass").listens == ("imu", "ranging", "compass")
    blind = AidedInertialCoupled(intake=Intake(heading="", position=""))
    with pytest.raises(InputError, match="reads no positions"):
        UltrasonicInertial(inertial=blind).check()
    assert PAIR.shape == (2, 3)
