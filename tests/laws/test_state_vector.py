"""State errors as vectors: plain, quaternion and body-axis errors; and input vectors added to their record."""

import jax.numpy as jnp
import numpy as np
import pytest
from design.test_coordinates import Dart, DartInput, steady_turn

from trimtab.core.record import replace
from trimtab.core.signals import PlanarForce, PlanarState
from trimtab.design.coordinates import error_model
from trimtab.laws.state_vector import add_to_input, state_error
from trimtab.vehicles.quadrotor import MultirotorState


def test_error_lists_plain_fields_in_the_given_order():
    state = PlanarState(1.0, 2.0, 3.0, 4.0)
    np.testing.assert_array_equal(state_error(state, ("heading", "surge_velocity"), np.array([0.5, 3.0])), [3.5, -2])


@pytest.mark.thorough
def test_quaternion_error_matches_the_linear_model_coordinates():
    """The error equals the deviation of `design.coordinates`."""
    x, u = steady_turn()
    model = error_model(Dart(), x, u)
    change = 0.1 * np.random.default_rng(2).normal(size=13)
    moved = model.state(model.x0 + change)
    names = ("p_W", "v_W", "q_WB", "w", "fuel")
    point = np.concatenate([np.ravel(getattr(x, n)) for n in names])
    # the place of a moving reference is taken in the reference's axes, here as it is: turned by that
    R = np.asarray(model.state(model.x0).q_WB)
    found = np.asarray(state_error(moved, names, point, "q_WB", ("v_W",)))
    np.testing.assert_allclose(found[3:], change[3:], atol=1e-12)
    assert R.shape == (4,)
    np.testing.assert_allclose(np.linalg.norm(found[:3]), np.linalg.norm(change[:3]), rtol=1e-12)
    flipped = replace(moved, q_WB=-moved.q_WB)
    np.testing.assert_allclose(state_error(flipped, names, point, "q_WB", ("v_W",)), found, atol=1e-12)


def test_position_error_is_in_axes_of_wanted_attitude():
    """A craft tilted at its reference position has zero position error, at any distance from the origin."""
    x, _ = steady_turn()
    names, far = ("p_W", "q_WB"), np.array([1.5, 0.0, -3.0])
    here = replace(x, p_W=far, q_WB=np.array([np.cos(0.1), np.sin(0.1), 0.0, 0.0]))
    point = np.concatenate([far, [1.0, 0.0, 0.0, 0.0]])
    e = np.asarray(state_error(here, names, point, "q_WB", (), ("p_W",)))
    np.testing.assert_allclose(e, [0, 0, 0, 0.2, 0, 0], atol=1e-12)
    turned = np.concatenate([far, [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]])  # its nose to the east
    moved = replace(x, p_W=far + np.array([0.0, 1.0, 0.0]), q_WB=turned[3:])
    e = np.asarray(state_error(moved, names, turned, "q_WB", (), ("p_W",)))
    np.testing.assert_allclose(e, [1.0, 0, 0, 0, 0, 0], atol=1e-12)


def test_four_element_field_with_unit_is_not_a_quaternion():
    state = MultirotorState(rotor_speed=np.array([1.0, 2.0, 3.0, 4.0]))
    np.testing.assert_array_equal(state_error(state, ("rotor_speed",), np.ones(4)), [0, 1, 2, 3])


def test_adds_a_vector_to_the_input_record():
    new = add_to_input(PlanarForce(1.0, 2.0), jnp.array([0.5, -0.5]))
    assert (float(new.FX), float(new.FY)) == (1.5, 1.5)
    wrench = add_to_input(DartInput(np.ones(3), np.zeros(3)), jnp.arange(6.0))
    np.testing.assert_array_equal(wrench.force, [1, 2, 3])
    np.testing.assert_array_equal(wrench.moment, [3, 4, 5])
