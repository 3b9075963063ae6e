"""State ± error: retract and local undo each other, angles go the short way round."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.core.manifold import dimension, error_names, local_error, retract
from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.signals import PlanarState


@record
class Bias:
    """Nested. Source: this test."""

    gyro: Scalar = quantity("rad/s", "A bias.", default=0.1)
    count: Scalar = quantity("1", "Not part of the error.", kind="count", default=4)


@record
class State:
    """Vector, angle, a nested record and a mapping. Source: this test."""

    p: Any = quantity("m", "A vector.", default=np.array([1.0, 2.0]), shape=(2,))
    heading: Scalar = quantity("rad", "An angle.", kind="angle", default=3.0)
    bias: Bias = part("Nested.", default=Bias())
    more: Any = part("A mapping.", default={"a": Bias(0.5, 1)})
    valid: Scalar = quantity("1", "Not part of the error.", kind="flag", default=True)


def test_names_and_dimension():
    assert error_names(State()) == ("p[0]", "p[1]", "heading", "bias.gyro", "more.a.gyro")
    assert dimension(State()) == 5
    assert error_names(PlanarState(0.0, 0.0, 0.0, 0.0)) == ("surge_velocity", "sway_velocity", "yaw_rate", "heading")


def test_retract_moves_what_it_names_and_leaves_the_rest():
    moved = retract(State(), jnp.array([0.1, 0.2, 0.05, -0.1, 1.0]))
    np.testing.assert_allclose(moved.p, [1.1, 2.2])
    assert float(moved.heading) == pytest.approx(3.05)
    assert float(moved.bias.gyro) == pytest.approx(0.0)
    assert float(moved.more["a"].gyro) == pytest.approx(1.5)
    assert (moved.bias.count, moved.more["a"].count, moved.valid) == (4, 1, True)


def test_angles_wrap_and_go_the_short_way():
    moved = retract(State(), jnp.array([0, 0, 0.5, 0, 0.0]))
    assert float(moved.heading) == pytest.approx(3.5 - 2 * np.pi)
    error = local_error(State(heading=3.0), State(heading=-3.0))
    np.testing.assert_allclose(error[2], 2 * np.pi - 6.0)


ERROR = st.lists(st.floats(-3.0, 3.0), min_size=5, max_size=5)


@given(ERROR, st.floats(-20, 20))
def test_local_undoes_retract(error, heading):
    x = State(heading=heading)
    np.testing.assert_allclose(local_error(x, retract(x, jnp.asarray(error))), error, atol=1e-12)


@given(ERROR, st.floats(-3, 3), st.floats(-3, 3))
def test_retract_undoes_local(values, a, b):
    x = State(heading=a)
    y = State(p=np.array(values[:2]), heading=b, bias=Bias(values[2], 4), more={"a": Bias(values[3], 1)})
    again = retract(x, local_error(x, y))
    np.testing.assert_allclose(again.p, y.p, atol=1e-12)
    assert float(again.bias.gyro) == pytest.approx(values[2], abs=1e-12)
    assert np.cos(float(again.heading) - b) == pytest.approx(1.0, abs=1e-12)


def test_zero_error_changes_nothing_but_the_turns():
    x = State(heading=1.0)
    np.testing.assert_array_equal(local_error(x, x), np.zeros(5))
    assert float(retract(x, jnp.zeros(5)).heading) == pytest.approx(1.0)


def test_differentiates_to_the_identity():
    slope = jax.jacfwd(lambda e: local_error(State(), retract(State(), e)))(jnp.zeros(5))
    np.testing.assert_allclose(slope, np.eye(5), atol=1e-15)


def test_states_of_different_structure_are_refused():
    with pytest.raises(ValueError, match="zip"):
        local_error(State(), Bias())
