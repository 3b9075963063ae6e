"""Vehicles as functions of vectors: the same numbers as the records, and names that are checked."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, part, quantity, record
from trimtab.core.signals import PlanarForce
from trimtab.design.model import (
    entry_names,
    find_indices,
    model_of_functions,
    model_of_vehicle,
    record_vector,
    unpack_record,
)
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

X = HovercraftState(0.3, -0.2, 0.1, 4.0, 5.0, 7.0)
U = PlanarForce(0.4, -0.1)


@record
class Bias:
    """Nested. Source: this test."""

    gyro: Scalar = quantity("rad/s", "A bias.", default=0.1)
    count: Scalar = quantity("1", "Not an entry of the vector.", kind="count", default=4)


@record
class State:
    """Vector, angle, a nested record and a mapping. Source: this test."""

    p: Any = quantity("m", "A vector.", default=np.array([1.0, 2.0]), shape=(2,))
    heading: Scalar = quantity("rad", "An angle.", kind="angle", default=3.0)
    bias: Bias = part("Nested.", default=Bias())
    more: Any = part("A mapping.", default={"a": Bias(0.5, 1)})
    valid: Scalar = quantity("1", "Not an entry of the vector.", kind="flag", default=True)


def test_record_entries_have_names():
    assert entry_names(State()) == ("p[0]", "p[1]", "heading", "bias.gyro", "more.a.gyro")
    assert entry_names(U) == ("FX", "FY")
    np.testing.assert_array_equal(record_vector(State()), [1.0, 2.0, 3.0, 0.1, 0.5])


def test_vehicle_model_matches_the_vehicle_dynamics():
    craft = Hovercraft()
    model = model_of_vehicle(craft, X, U)
    want = craft.dynamics(0.0, X, U)
    np.testing.assert_array_equal(model.f(model.x0, model.u0), [float(getattr(want, n)) for n in model.states])
    assert model.states == ("surge_velocity", "sway_velocity", "yaw_rate", "north", "east", "heading")
    assert model.inputs == ("FX", "FY")
    assert model.outputs == model.states
    assert float(unpack_record(X, record_vector(X)).heading) == 7.0  # not wrapped: a trim may turn
    assert float(model.state(model.x0).yaw_rate) == 0.1
    assert float(model.input(model.u0).FY) == -0.1


def test_outputs_are_chosen_by_name_or_function():
    model = model_of_vehicle(Hovercraft(), X, U, outputs=("east", "yaw_rate"))
    np.testing.assert_array_equal(model.h(model.x0, model.u0), [5.0, 0.1])
    made = model_of_vehicle(
        Hovercraft(), X, U, outputs={"speed": lambda x, u: jnp.hypot(x.surge_velocity, x.sway_velocity)}
    )
    np.testing.assert_allclose(made.h(made.x0, made.u0), [np.hypot(0.3, 0.2)], rtol=1e-15)
    assert made.outputs == ("speed",)


def test_points_accept_changes_records_and_vectors():
    model = model_of_vehicle(Hovercraft(), X, U)
    x, u = model.point({"north": 9.0}, [1.0, 2.0])
    np.testing.assert_array_equal(x, [0.3, -0.2, 0.1, 9.0, 5.0, 7.0])
    np.testing.assert_array_equal(u, [1.0, 2.0])
    np.testing.assert_array_equal(model.point(X, U)[0], model.x0)
    assert model.x0[3] == 4.0


def test_rejects_invalid_points_and_names():
    model = model_of_vehicle(Hovercraft(), X, U)
    with pytest.raises(InputError, match="unknown name 'hedding'") as error:
        model.point({"hedding": 1.0})
    assert "'heading'" in error.value.fix
    assert "yaw_rate" in error.value.choices
    with pytest.raises(InputError, match="all values must be finite, got north = nan"):
        model.point({"north": np.nan})
    with pytest.raises(InputError, match="shape"):
        model.point(np.zeros(5))
    with pytest.raises(InputError, match="twice"):
        find_indices("here", ("a", "a"), ("a", "b"))
    with pytest.raises(InputError, match="unknown name 'depth'"):
        model_of_vehicle(Hovercraft(), X, U, outputs=("depth",))
    with pytest.raises(InputError, match="must be a record"):
        model_of_vehicle(Hovercraft(), np.zeros(6), U)
    with pytest.raises(InputError, match=r"2 names for f\(x, u\)"):
        model_of_functions(lambda x, u: jnp.zeros(3), ("a", "b"), ("u",))
    with pytest.raises(InputError, match="contains a name twice"):
        model_of_functions(lambda x, u: x, ("a", "a"), ("u",))
    with pytest.raises(InputError, match=r"h\(x, u\)"):
        model_of_functions(lambda x, u: x, ("a", "b"), ("u",), h=lambda x, u: x[:1], outputs=("p", "q"))
