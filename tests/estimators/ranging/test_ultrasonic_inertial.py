"""The hovercraft's navigation system flown in the loop: truth is known, every fault can be switched off."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from contracts import parts
from trimtab.core.errors import InputError
from trimtab.core.record import part, quantity, record, replace
from trimtab.core.time import ms, seconds
from trimtab.estimators.inertial.aided import Intake
from trimtab.estimators.inertial.coupled import AidedInertialCoupled
from trimtab.estimators.inertial.mechanisation import LeverArms
from trimtab.estimators.ranging.position import PAIR, RangingPosition
from trimtab.estimators.ranging.ultrasonic_inertial import UltrasonicInertial
from trimtab.links.wire import Wire
from trimtab.logs.navigation import innovations
from trimtab.loop.structure import strengthen_types
from trimtab.run.simulate import simulate_many
from trimtab.scenarios import catalogue

SIGNALS = ("surge_velocity", "sway_velocity", "heading", "north", "east")
SEEDS = range(16)


@pytest.fixture(scope="module")
def scenario():
    made, _ = catalogue.load_scenario("hovercraft/zero-velocity", {"navigation": "ins"})
    ranging = made.world.sensors["ranging"]
    none_moved = np.zeros_like(ranging.beacons.map)  # one a beacon: with and without it is the same program
    ranging = replace(ranging, beacons=replace(ranging.beacons, moved=none_moved))
    made = replace(made, world=replace(made.world, sensors=made.world.sensors | {"ranging": ranging}))
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
    sensors = [n for n, where in scenario.imperfections().items() if any("sensors" in path for path in where)]
    for name in set(sensors) - {"collisions", "cone-error"}:
        scenario = scenario.without(name)
    return scenario


@pytest.mark.thorough
def test_perfect_sensors_converge_to_the_truth(scenario):
    """What is left: the way from a start that knows nothing, which the filter's own noise takes seconds to forget."""
    (log,) = flown(replace(faultless(scenario), duration=seconds(12)), [3])
    late = log.t > 11
    assert log["estimate.valid"][late].all()
    for signal, bound in zip(SIGNALS, (0.004, 0.004, 0.002, 0.002, 0.002), strict=True):
        assert np.abs(errors(log, signal)[0][late]).max() < bound, signal


@pytest.mark.thorough
def test_errors_are_consistent_with_sigmas(scenario):
    """On sensors with all their faults, errors of survey and temperature constant over a flight among them.

    64 flights, for a constant error is one draw a flight.
    """
    logs = flown(scenario, range(64))
    for signal in SIGNALS:
        normalised = np.array([np.mean((e / s)[log.t > 3] ** 2) for log in logs for e, s in [errors(log, signal)]])
        print(signal, np.sqrt(normalised.mean()), np.quantile(normalised, 0.9))
        assert 0.35 < normalised.mean() < 1.0, signal
        assert np.quantile(normalised, 0.9) < 2.5, signal


@pytest.mark.thorough
def test_innovations_are_consistent_without_outliers():
    """Of six flights: NIS near 1 a number, and no heading far out where one unit's beacons lie badly."""
    made, _ = catalogue.load_scenario("hovercraft/forward", {"navigation": "ins"})
    logs = simulate_many(made, seeds=range(6), signals=("truth", "estimate"))
    for name in ("heading", "position"):
        of_all = [(t, nis / dof) for log in logs for t, nis, dof in [innovations(log)[name]]]
        late = np.concatenate([nis[t > 2] for t, nis in of_all])
        assert len(late) > 700
        assert 0.7 < late.mean() < 1.15, name
        assert np.mean(late > 9) < 0.005, name


@pytest.mark.thorough
def test_filter_starts_from_unknown_heading_and_position(scenario):
    """Heading and position unknown, turning at 2 rad/s: both fixes within 0.3 s, a hundredth of a turn within 3 s."""
    for log in flown(scenario, range(4)):
        assert log.t[np.argmax(log["estimate.valid"])] < 0.4
        assert np.abs(errors(log, "heading")[0][log.t > 3]).max() < 0.06


@pytest.mark.thorough
def test_beacon_moved_by_half_a_metre_is_excluded(scenario):
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
            print(np.abs(error[late]).max(), np.abs(error / sigma)[late].max())
            assert np.abs(error[late]).max() < 0.08
            assert np.abs(error / sigma)[late].max() < 5


FAULTS = ("frozen", "ahead", "back", "nan", "twice")


@record
class Spoiled:
    """A ranging sensor whose samples go wrong from 3 s on. Source: this test."""

    sensor: Any = part("The sensor.")
    fault: Any = quantity("1", "What happens to them, by its number in FAULTS.")

    LATE = True

    @property
    def period(self):
        return self.sensor.period

    def init(self, key):
        state = self.sensor.init(key)
        _, sample = self.sensor.step(np.int64(0), state, parts.motion(np.int64(0)))
        return state, strengthen_types(sample.value)

    def measure(self, motion):
        return self.sensor.measure(motion)

    def step(self, t, state, motion):
        inner, kept = state
        inner, sample = self.sensor.step(t, inner, motion)
        frozen, ahead, back, nan, twice = ((self.fault == k) & (t >= seconds(3)) for k in range(5))
        value = jax.tree.map(lambda old, new: jnp.where(frozen, old, new), kept, sample.value)
        value = replace(value, range=jnp.where(nan, jnp.nan, value.range))
        shift = jnp.where(ahead & (t < seconds(3.1)), seconds(3600), jnp.where(back, -seconds(2), 0))
        fresh = jnp.where(twice, sample.valid & (t // ms(10) % 2 == 0), sample.fresh)
        return (inner, strengthen_types(value)), replace(sample, value=value, t=sample.t + shift, fresh=fresh)


@pytest.mark.thorough
@pytest.mark.parametrize("fault", FAULTS)
def test_ranging_faults_are_flagged_and_sigmas_stay_consistent(scenario, fault):
    ranging = Spoiled(scenario.world.sensors["ranging"], np.float64(FAULTS.index(fault)))
    positioning = scenario.autopilot.estimator.positioning
    world = replace(scenario.world, sensors=scenario.world.sensors | {"ranging": ranging}, downlink=Wire())
    log = simulate_many(replace(scenario, world=world), seeds=[1], signals=("truth", "estimate"))[0]
    late = log.t > 4.5
    for signal in ("north", "east"):
        error, sigma = errors(log, signal)
        assert np.abs(error / sigma)[late].max() < 5, (fault, signal)
    used = log["estimate.state.position_fix.used"]
    sigma = log["estimate.state.sigma_north"]
    if fault in ("frozen", "nan", "back"):  # nothing usable comes any more, or for two seconds
        blind = (log.t > 3.8) & (log.t < 4.8)
        assert np.ptp(used[blind]) == 0
        assert (np.diff(sigma[blind]) >= 0).all()
        assert sigma[blind][-1] > 1.5 * sigma[log.t < 3][-1]
    else:
        assert used[-1] > used[log.t < 4][-1] + 20  # it goes on
        assert sigma[-1] < 0.03
    assert positioning.frozen_after == 3
    watch = {n: log[f"estimate.state.position_sensor.{n}"] for n in ("frozen", "invalid", "disordered")}
    assert watch["frozen"][late].all() == (fault == "frozen")
    assert (watch["invalid"][-1] > 0) == (fault == "nan")
    assert (watch["disordered"][-1] > 0) == (fault in ("ahead", "back", "twice"))


@pytest.mark.thorough
def test_single_unit_on_lever_arm_stays_consistent(scenario):
    """Heading unknown at first, and no sensor for it: what the lever arm hides is not noise that averages away."""
    made = scenario.autopilot.estimator
    lever = PAIR[:1]
    ranging = replace(scenario.world.sensors["ranging"], units=lever, clients=1)
    inertial = AidedInertialCoupled(
        noise=made.inertial.noise,
        start=replace(made.inertial.start, sigma_heading=0.5),
        intake=Intake(heading=""),
        arms=LeverArms(aiding=lever[0, :2]),
    )
    estimator = replace(made, positioning=replace(made.positioning, units=lever), inertial=inertial)
    world = replace(scenario.world, sensors=scenario.world.sensors | {"ranging": ranging})
    autopilot = replace(scenario.autopilot, estimator=estimator)
    logs = flown(replace(scenario, world=world, autopilot=autopilot), range(8))
    for signal in ("north", "east"):
        normalised = [np.sqrt(np.mean((e / s)[log.t > 3] ** 2)) for log in logs for e, s in [errors(log, signal)]]
        assert np.median(normalised) < 1.5, (signal, normalised)


def test_rejects_inconsistent_parts():
    three = RangingPosition(units=np.vstack([PAIR, PAIR[:1] + 0.1]))
    with pytest.raises(InputError, match="number of ultrasonic units must be 1 or 2, got 3"):
        UltrasonicInertial(positioning=three).check()
    with pytest.raises(InputError, match="one ultrasonic unit and no magnetometer"):
        UltrasonicInertial(positioning=RangingPosition()).check()
    one = UltrasonicInertial(positioning=RangingPosition(), inertial=AidedInertialCoupled())
    one.check()
    ahead = RangingPosition(units=PAIR[:1])
    with pytest.raises(InputError, match=r"arms\.aiding must be \[0\.2 0\. \] with 1 ultrasonic unit, got"):
        replace(one, positioning=ahead).check()
    replace(one, positioning=ahead, inertial=replace(one.inertial, arms=LeverArms(aiding=PAIR[0, :2]))).check()
    assert one.listens == ("imu", "ranging")
    assert UltrasonicInertial(magnetometer="compass").listens == ("imu", "ranging", "compass")
    blind = AidedInertialCoupled(intake=Intake(heading="", position=""))
    with pytest.raises(InputError, match="must read positions"):
        UltrasonicInertial(inertial=blind).check()
    assert PAIR.shape == (2, 3)
