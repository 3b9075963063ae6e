"""Flight over the turning earth in local coordinates: the book's trims of the F-16, and the way there and back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from examples.my_jet import system
from trimtab.core.integrate import rk4
from trimtab.core.record import replace
from trimtab.design.local_flight import LocalFlightState, fly_locally
from trimtab.run.design_point import find_point, linearise_at
from trimtab.run.plant import plant_of_vehicle
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState
from trimtab.vehicles.rigid_body import RigidBody, Wrench

NORTH = ("climb=0", "attitude.yaw=0", "speed=502 ft/s")


def jet(centre):
    vehicle, x, u = system()
    return plant_of_vehicle("jet", replace(vehicle, centre=centre), x, u)


@pytest.fixture(scope="module")
def level():
    plant = jet(0.35)
    return plant, find_point(plant, (*NORTH, "attitude.roll=0"))


def values(plant, point):
    model = plant.model
    return dict(zip(model.outputs, np.asarray(model.h(point.x, point.u)), strict=True)) | dict(
        zip(model.inputs, point.u, strict=True)
    )


@pytest.mark.thorough
def test_f16_level_trim_matches_the_book(level):
    """Stevens, Lewis, Johnson, table 3.6-3, nominal: 502 ft/s at sea level, over a flat earth that stands still.

    Over the round and turning one it flies 0.2 % lighter.
    """
    found = values(*level)
    assert level[1].is_found
    assert found["angle_of_attack"] == pytest.approx(0.03691, rel=2e-3)
    assert np.degrees(found["elevator"]) == pytest.approx(-0.7588, rel=1e-3)


@pytest.mark.thorough
def test_f16_modes_match_the_book(level):
    linear = linearise_at(*level)
    assert len(linear.states) == 12
    (dutch,) = [m for m in linear.modes() if m.pole.imag > 1]
    assert {n for n, _ in dutch.states[:2]} == {"velocity.starboard", "rate[2]"}
    # Stevens, Lewis, Johnson, section 4.4, dutch roll and roll subsidence at this point
    assert dutch.pole == pytest.approx(-0.4224 + 3.063j, rel=2e-3)
    assert min(linear.poles().real) == pytest.approx(-3.616, rel=2e-3)


@pytest.mark.thorough
def test_f16_steady_turn_matches_the_book():
    """The same, fourth column: 0.3 rad/s, 4.5 g, centre of mass at 0.30."""
    plant = jet(0.30)
    words = (*NORTH, "sideslip=4.8e-4", "attitude.yaw'=0.3", "attitude.roll=60 deg..85 deg")
    found = values(plant, find_point(plant, words).require_trim())
    printed = {"angle_of_attack": 0.2485, "attitude.roll": 1.367, "attitude.pitch": 0.05185}
    printed |= {"rate[0]": -0.0155, "rate[1]": 0.2934, "rate[2]": 0.06071}
    for name, value in printed.items():
        assert found[name] == pytest.approx(value, rel=4e-3), name
    assert np.degrees(found["elevator"]) == pytest.approx(-6.256, rel=1e-3)


@pytest.mark.thorough
def test_local_derivative_matches_the_vehicle_itself():
    body = RigidBody(mass=2.0, inertia=np.array([0.1, 0.2, 0.25]))
    start = body.start(
        0.5, 0.2, 900.0, velocity=[40, 2, -3], angles=[0.2, 0.1, 1.0], rate=[0.1, 0.2, -0.3], over_ground=True
    )
    push = Wrench(np.array([5.0, 1.0, -15.0]), np.array([0.01, 0.02, 0.0]))
    local, x = fly_locally(body, start)
    assert isinstance(x, LocalFlightState)
    np.testing.assert_allclose([x.latitude, x.longitude, x.height], [0.5, 0.2, 900], rtol=1e-12)
    h = 1e-3

    def fly(t, length):
        return rk4(lambda t, s: body.dynamics(t, s, push), t, jax.tree.map(jnp.asarray, start), length)

    ends = [local.to_local(side * h, fly(0.0, side * h)) for side in (1, -1)]
    slope = jax.tree.map(lambda a, b: (a - b) / (2 * h), *ends)
    for wanted, own in zip(jax.tree.leaves(slope), jax.tree.leaves(local.dynamics(0.0, x, push)), strict=True):
        np.testing.assert_allclose(own, wanted, rtol=1e-5, atol=1e-6)
    back = local.to_inertial(0.0, x)
    np.testing.assert_allclose(back.position, start.position, rtol=1e-12)
    np.testing.assert_allclose(back.velocity, start.velocity, rtol=1e-9)


def test_vehicle_not_flying_over_earth_is_unchanged():
    craft, x = Hovercraft(), HovercraftState()
    assert fly_locally(craft, x) == (craft, x)
