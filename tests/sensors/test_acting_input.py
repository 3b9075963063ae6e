"""ActingInput and FlexibleTruth: their readings, and the quantity that the world passes to each sensor."""

import numpy as np
import pytest

from trimtab.actuators.allocation import DirectActuation
from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.rng import key
from trimtab.core.signals import Command
from trimtab.core.time import Instant, ms
from trimtab.links.wire import Wire
from trimtab.loop.world import World
from trimtab.sensors.angular_accelerometer import AngularAccelerometer
from trimtab.sensors.flight_state import ActingInput, FlexibleTruth, TrueState
from trimtab.vehicles.hypersonic import Hypersonic, HypersonicInput, HypersonicState

X = HypersonicState(85000.0, 7702.0, 0.028, 0.030, 0.001, 0.9, 0.1, 0.75, -0.2)
NEUTRAL, TICK = HypersonicInput(0.26, 0.217), ms(5)
SENSORS = {"actuators": ActingInput(), "truth": FlexibleTruth(), "felt": AngularAccelerometer(noise=0.0)}


def world(sensors=SENSORS):
    actuators = DirectActuation(neutral_input=NEUTRAL, period=TICK)
    links = {"downlink": Wire(period=TICK), "uplink": Wire(period=TICK)}
    return World(vehicle=Hypersonic(), sensors=sensors, actuators=actuators, max_step=TICK, **links)


def test_flexible_truth_reports_climb_rate_instead_of_pitch():
    seen = FlexibleTruth().measure(X)
    np.testing.assert_allclose(seen.h_rate, 7702.0 * np.sin(0.002), rtol=1e-12)
    names = ("h", "V", "alpha", "q", "eta1", "eta1_rate", "eta2", "eta2_rate")
    assert [float(getattr(seen, n)) for n in names] == [float(getattr(X, n)) for n in names]


def test_true_state_sensor_returns_any_vehicle_state():
    made = world({"truth": TrueState(period=TICK)})
    _, frame = made.sense(Instant(0), made.init(key(0), X))
    seen = frame.samples["truth"].value
    assert type(seen) is HypersonicState
    assert (float(seen.h), float(seen.eta2_rate)) == (85000.0, -0.2)


def test_sample_holds_the_input_before_the_new_command():
    """[1] eq. 9: the acceleration is sampled while u(k-1) acts, and the filter needs that u."""
    made = world()
    clock = [Instant(k * TICK, frozenset((TICK,))) for k in range(2)]
    s = made.init(key(0), X)
    s, frame = made.sense(clock[0], s)
    asked = Command(t=0, valid=np.asarray(True), value=HypersonicInput(0.5, 0.1))
    s = made.connect(key(0), s, asked)
    assert float(frame.samples["actuators"].value.Phi) == 0.26
    s = made.act(clock[0], s, asked, np.asarray(True))
    s = made.advance(0, s, TICK)
    _, frame = made.sense(clock[1], s)
    assert float(frame.samples["actuators"].value.Phi) == 0.5
    q_rate = made.vehicle.coupled_accelerations(0.0, s.x, HypersonicInput(0.5, 0.1))[0]
    np.testing.assert_allclose(frame.samples["felt"].value.pitch_acceleration, q_rate, rtol=1e-12)


def test_rejects_sensor_of_unknown_quantity():
    class Sixth(ActingInput):
        FEELS = "mood"

    with pytest.raises(InputError, match=r"FEELS = 'mood', which is not a quantity that the world provides"):
        world({"odd": Sixth()}).init(key(0), X)


def test_motion_sensor_still_receives_the_motion():
    made = world({"felt": AngularAccelerometer(noise=0.0)})
    _, frame = made.sense(Instant(0, frozenset((TICK,))), made.init(key(0), replace(X, q=0.0)))
    wanted = made.vehicle.coupled_accelerations(0.0, replace(X, q=0.0), NEUTRAL)[0]
    np.testing.assert_allclose(frame.samples["felt"].value.pitch_acceleration, wanted, rtol=1e-12)
