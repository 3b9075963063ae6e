"""The linearisation in normal coordinates, against first orders by hand; the hypersonic vehicle's: its own test."""

import jax.numpy as jnp
import numpy as np
import pytest
from design.published import G, vtol

from trimtab.core.errors import InputError
from trimtab.design.model import model_of_functions
from trimtab.design.normal_form import linear_normal_form
from trimtab.design.trim import trim


def curved():
    """Not affine in its input, with an internal state that the input moves."""

    def f(x, u):
        return jnp.stack([x[1] + x[0] ** 2, -x[0] + jnp.sinh(u[0]) * (2 + x[2]), -x[2] + x[0] + u[0]])

    return model_of_functions(f, ("a", "b", "c"), ("p",), h=lambda x, u: x[:1], outputs=("y",))


def test_against_the_first_order_by_hand():
    """y' = b + a^2, v = y'' = -a + sinh(p) (2 + c) + 2 a y' about zero: p = (v + a)/2, c' = -c + a + p."""
    got = linear_normal_form(curved(), {"y": 2}, ("c",))
    assert (got.states, got.inputs, got.outputs) == (("y", "y'", "c"), ("y''",), ("y",))
    np.testing.assert_allclose(got.A, [[0, 1, 0], [0, 0, 0], [1.5, 0, -1]], atol=1e-12)
    np.testing.assert_allclose(got.B, [[0], [1], [0.5]], atol=1e-12)
    np.testing.assert_allclose(got.C, [[1, 0, 0]])


def test_away_from_the_origin_curvature_of_the_coordinates_counts():
    """Trim a = 1, b = -1: Phi = [[1, 0, 0], [2, 1, 0], [0, 0, 1]]; v = y'' as below."""
    model = curved()
    found = trim(model, x={"a": 1.0, "b": -1.0}, free=("c", "p")).require_trim()
    p, c = float(found.u[0]), float(found.x[2])
    got = linear_normal_form(model, {"y": 2}, ("c",), found.x, found.u)
    # v = -a + sinh(p)(2 + c) + 2 a (b + a^2): with da = dy, db = dy' - 2 dy
    Wu, by_y = np.cosh(p) * (2 + c), -1 + 2 * (-2 + 2)
    row = np.array([1 - by_y / Wu, -2 / Wu, -1 - np.sinh(p) / Wu])
    np.testing.assert_allclose(got.A, [[0, 1, 0], [0, 0, 0], row], atol=1e-9)
    np.testing.assert_allclose(got.B, [[0], [1], [1 / Wu]], atol=1e-9)


def test_what_does_not_fit_is_refused():
    model = curved()
    with pytest.raises(InputError, match=r"no trim: b' = 1\.1"):
        linear_normal_form(model, {"y": 2}, ("c",), u={"p": 0.55})
    with pytest.raises(InputError, match="the inputs enter earlier"):
        linear_normal_form(model, {"y": 3}, ())
    with pytest.raises(InputError, match="singular"):
        linear_normal_form(model, {"y": 1}, ("b", "c"))
    with pytest.raises(InputError, match="name 1"):
        linear_normal_form(model, {"y": 2}, ())
    with pytest.raises(InputError, match="don't complete"):
        linear_normal_form(model, {"y": 2}, ("a",))
    with pytest.raises(InputError, match="give every output its degree"):
        linear_normal_form(model, {}, ("a", "b", "c"))


def test_vtol_has_no_degree_where_the_inputs_enter_as_one():
    """[2, 2] is its degree; internal dynamics of the roll as known: sin(theta) g / eps."""
    craft = vtol(0.3)
    got = linear_normal_form(craft, dict.fromkeys(craft.outputs, 2), craft.states[4:], u=craft.u0)
    np.testing.assert_allclose(got.A[5, 4], G / 0.3, rtol=1e-12)
