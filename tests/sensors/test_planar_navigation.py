import jax
import numpy as np

from trimtab.core.imperfections import imperfections
from trimtab.core.interfaces import Sensor
from trimtab.core.rng import key
from trimtab.core.signals import PlanarForce
from trimtab.core.time import ms
from trimtab.sensors.navigation_errors import PlanarNavigation
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

STATE = HovercraftState(
    surge_velocity=0.4, sway_velocity=-0.3, yaw_rate=2.0, north=5.0, east=-7.0, heading=9.5
)  # more than a turn


def test_reading_equals_the_vehicle_state():
    sensor = PlanarNavigation()
    motion = Hovercraft().motion(ms(7), jax.tree.map(np.asarray, STATE), PlanarForce(1.0, 0.2))
    state, sample = sensor.step(ms(7), sensor.init(key(0)), motion)
    for name in ("surge_velocity", "sway_velocity", "yaw_rate", "heading"):
        assert getattr(sample.value, name) == getattr(STATE, name)
        assert getattr(sensor.measure(motion), name) == getattr(STATE, name)
    assert (state, sample.t, sample.age, sample.fresh, sample.valid) == ((), ms(7), 0.0, True, True)


def test_sensor_has_no_imperfections():
    assert isinstance(PlanarNavigation(), Sensor)
    assert PlanarNavigation().period == ms(1)
    assert imperfections(PlanarNavigation()) == {}
