"""The true pose in the plane, against the vehicle's own state."""

import jax
import numpy as np
import pytest

from trimtab.core.imperfections import imperfections, without
from trimtab.core.interfaces import Sensor
from trimtab.core.rng import key
from trimtab.core.signals import PlanarForce
from trimtab.core.time import ms
from trimtab.sensors.planar_pose import NoisyPlanarPose, PlanarPose
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState


def test_pose_equals_the_vehicle_state():
    x = HovercraftState(0.3, -0.4, 1.5, 2.0, -3.0, 7.0)
    sensor = PlanarPose()
    _, sample = sensor.step(ms(5), sensor.init(key(0)), Hovercraft().motion(ms(5), x, PlanarForce(FX=1.0, FY=0.5)))
    for name in ("surge_velocity", "sway_velocity", "yaw_rate", "north", "east", "heading"):
        assert float(getattr(sample.value, name)) == getattr(x, name)
    assert bool(sample.valid)


def test_pose_sensor_has_no_imperfections():
    assert isinstance(PlanarPose(), Sensor)
    assert imperfections(PlanarPose()) == {}
    assert jax.tree.leaves(PlanarPose().init(key(0))) == []


@pytest.mark.thorough
def test_noisy_pose_has_given_deviations_unless_switched_off():
    sensor, motion = NoisyPlanarPose(), Hovercraft().motion(0, HovercraftState(), PlanarForce(0.0, 0.0))
    instants = np.arange(4000) * sensor.period
    draw = jax.jit(jax.vmap(lambda t: sensor.step(t, sensor.init(key(0)), motion)[1].value))
    noise = draw(instants)
    for name, size in (
        ("surge_velocity", sensor.velocity_noise),
        ("sway_velocity", sensor.velocity_noise),
        ("yaw_rate", sensor.rate_noise),
        ("heading", sensor.heading_noise),
        ("north", sensor.position_noise),
        ("east", sensor.position_noise),
    ):
        x = np.asarray(getattr(noise, name))
        assert x.std() == pytest.approx(size, rel=4 / np.sqrt(2 * len(x)))
        assert abs(x.mean()) < 4 * size / np.sqrt(len(x))
    assert np.abs(np.corrcoef(np.array(jax.tree.leaves(noise))) - np.eye(6)).max() < 4.5 / np.sqrt(len(instants))
    _, sample = without(sensor, "navigation-error").step(0, key(0), motion)
    assert not np.array(jax.tree.leaves(sample.value)).any()
