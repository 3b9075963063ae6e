"""The filter of a vehicle's linear model: consistency, a dense reference filter, and unobservable modes."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.stats

from examples.my_tank import FIRST, Push, Tank, TankState, scenario
from trimtab import simulate, simulate_batch
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, quantity, record, replace
from trimtab.core.signals import no_motion
from trimtab.core.time import ms
from trimtab.design.linearise import linearise
from trimtab.design.model import model_of_vehicle
from trimtab.loop.linear_filter import design_filter, measure_channels, unseen_modes
from trimtab.sensors.flight_state import ActingInput, TrueState
from trimtab.sensors.planar_pose import NoisyPlanarPose
from trimtab.vehicles.quadrotor import Multirotor, MultirotorState, RotorSpeeds

NAMES = tuple(FIRST)
RUNS = 1000
POSE = NoisyPlanarPose(position_noise=0.002, period=ms(10))


def fly_many(changed):
    """Return errors (runs, times, n), covariances and NIS of RUNS flights, started with the filter's covariance."""
    start = np.random.default_rng(0).normal(size=(RUNS, 4)) * list(FIRST.values())
    spread = {f"initial.{n}": start[:, i] for i, n in enumerate(NAMES)}
    signals = (*(f"{w}.{n}" for w in ("truth", "estimate.state") for n in NAMES), "estimate.P", "estimate.nis")
    log = simulate_batch(changed, seeds=range(RUNS), spread=spread, signals=signals, log=True, log_period="1 s").log
    e = np.stack([log[f"estimate.state.{n}"] - log[f"truth.{n}"] for n in NAMES], axis=-1)
    return e, log["estimate.P"].reshape(*e.shape[:2], 4, 4), log["estimate.nis"]


def mean_nees(e, P):
    return np.einsum("rti,rtij,rtj->rt", e, np.linalg.inv(P), e).mean(axis=0)


def band(times, degrees):
    """Return the 99 % band of the mean over RUNS at all the given times together."""
    p = 0.005 / times
    return scipy.stats.chi2.ppf([p, 1 - p], degrees * RUNS) / RUNS


@pytest.mark.thorough
def test_estimation_error_is_consistent_with_the_covariance():
    e, P, nis = fly_many(scenario())
    low, high = band(e.shape[1], 4)
    found = mean_nees(e, P)
    assert ((low < found) & (found < high)).all(), found
    low, high = band(e.shape[1], 1)
    assert ((low < nis.mean(axis=0)) & (nis.mean(axis=0) < high)).all()
    assert np.sqrt(P[0, -1, 2, 2]) < 0.01 * FIRST["slosh"]


@pytest.mark.thorough
def test_nees_exceeds_its_band_with_a_wrong_model():
    wrong = design_filter(
        Tank(water=0.4), TankState(), Push(), {"pose": POSE}, {"pose.north": 0.002}, FIRST, period=ms(10)
    )
    flown = scenario()
    e, P, _ = fly_many(replace(flown, autopilot=replace(flown.autopilot, estimator=wrong)))
    assert (mean_nees(e, P)[3:] > band(1, 4)[1]).all()


@pytest.mark.thorough
def test_estimate_matches_a_dense_kalman_filter():
    flown = scenario()
    log, s = simulate(flown, duration="300 ms", seed=3), flown.autopilot.estimator
    linear = linearise(model_of_vehicle(Tank(), TankState(), Push()))
    M = scipy.linalg.expm(np.block([[linear.A, linear.B], [np.zeros((1, 5))]]) * 0.01)
    e, P, H = np.zeros(4), np.diag(np.square(list(FIRST.values()))), np.array([[1.0, 0, 0, 0]])
    for k in range(len(log)):
        if k:
            e, P = M[:4, :4] @ e + M[:4, 4] * log["actuators.u.force"][k - 1], M[:4, :4] @ P @ M[:4, :4].T
        L = P @ H.T / (H @ P @ H.T + s.R[0])
        e, P = e + L[:, 0] * (log["downlink.pose.value.north"][k] - e[0]), (np.eye(4) - L @ H) @ P
        np.testing.assert_allclose([log[f"estimate.state.{n}"][k] for n in NAMES], e, atol=1e-10)
    np.testing.assert_allclose(log["estimate.P"][-1].reshape(4, 4), P, atol=1e-12)


@record
class TwinState:
    """Two liquids in one truck. Source: this test."""

    position: Scalar = quantity("m", "Of the truck.", default=0.0)
    velocity: Scalar = quantity("m/s", "Its derivative.", default=0.0)
    fore: Scalar = quantity("m", "Of the water before.", default=0.0)
    fore_rate: Scalar = quantity("m/s", "Its derivative.", default=0.0)
    aft: Scalar = quantity("m", "Of the water behind.", default=0.0)
    aft_rate: Scalar = quantity("m/s", "Its derivative.", default=0.0)


@record
class TwinTank:
    """For `apart` zero, both liquids have one frequency, and their differential mode is unobservable."""

    apart: Scalar = quantity("1", "How much stiffer the one behind is, in parts.", default=0.0)
    damping: Scalar = quantity("1/s", "Of both.", default=0.1)

    def dynamics(self, t, x, u):
        fore = 25.0 * x.fore + self.damping * x.fore_rate
        aft = 25.0 * (1 + self.apart) * x.aft + self.damping * x.aft_rate
        a = u.force + 0.2 * (fore + aft)
        return TwinState(x.velocity, a, x.fore_rate, -fore - a, x.aft_rate, -aft - a)

    def motion(self, t, x, u):
        return replace(no_motion(), t=t, p_WB=jnp.stack([x.position, 0.0, 0.0]))


def twin_filter(vehicle, sensors, noise):
    first = dict.fromkeys(("position", "velocity", "fore", "fore_rate", "aft", "aft_rate"), 0.1)
    return design_filter(vehicle, TwinState(), Push(), sensors, noise, first, period=ms(10))


@pytest.mark.thorough
def test_unobservable_mode_is_rejected_with_its_states():
    sensors = {"pose": POSE, "state": TrueState(), "actuators": ActingInput()}
    with pytest.raises(InputError) as refused:
        twin_filter(TwinTank(), sensors, {"pose.north": 0.002})
    text = str(refused.value)
    assert "pose.north cannot observe the mode with pole -0.05 ± 5i 1/s, which appears in" in text
    assert {"fore", "aft"} <= set(text.split(" in ")[1].split("\n")[0].rstrip(".").split(", "))
    assert "state.fore" in text
    twin_filter(TwinTank(), sensors, {"pose.north": 0.002, "state.fore": 0.01})
    twin_filter(TwinTank(apart=0.1), sensors, {"pose.north": 0.002})
    twin_filter(TwinTank(damping=6.0), sensors, {"pose.north": 0.002})  # unseen, but it dies away by itself


def test_unseen_modes_are_listed_with_their_states():
    linear = linearise(model_of_vehicle(TwinTank(), TwinState(), Push()))
    assert unseen_modes(linear) == ()
    (slow,) = unseen_modes(linear.part(outputs=["velocity", "fore", "aft"]))
    assert (slow.states, slow.stays) == (("position",), True)
    assert abs(slow.pole) < 1e-6


def test_rejects_invalid_filter_designs():
    words = (Tank(), TankState(), Push(), {"pose": POSE})
    with pytest.raises(InputError, match=r"no sensor measures 'pose.nord'") as refused:
        design_filter(*words, {"pose.nord": 0.1}, FIRST, period=ms(10))
    assert "pose.north" in str(refused.value)
    with pytest.raises(InputError, match="the initial standard deviation of slosh, slosh_rate is missing"):
        design_filter(*words, {"pose.north": 0.1}, {"position": 1.0, "velocity": 1.0}, period=ms(10))
    with pytest.raises(InputError, match="quaternion"):
        design_filter(Multirotor(), MultirotorState(), RotorSpeeds(), {}, {}, {}, period=ms(10))
    good = design_filter(*words, {"pose.north": 0.1}, FIRST, period=ms(10))
    with pytest.raises(InputError, match="must have"):
        replace(good, C=np.zeros((2, 4))).check()
    assert set(measure_channels(Tank(), TankState(), Push(), {"actuators": ActingInput()})) == set()
