"""Relative degrees that are known: published systems, and by hand."""

import jax.numpy as jnp
import numpy as np
import pytest
from design.published import BALL, G, ball_and_beam, hovercraft, vtol, with_centripetal

from trimtab.core.errors import InputError
from trimtab.design.lie import (
    affine_fields,
    curved_inputs,
    equilibrate,
    extend_inputs,
    lie_derivative,
    output_derivatives,
    relative_degree,
)
from trimtab.design.model import model_of_functions
from trimtab.vehicles.hovercraft import Hovercraft

X = np.array([0.7, -0.2, 0.4, 1.3])


def test_ball_and_beam_lie_derivatives_match_publication():
    """Hauser, Sastry, Kokotovic 1992, eq. 3.1-3.3."""
    f, (g,) = affine_fields(ball_and_beam())
    r, rd, th, w = X
    wanted = [r, rd, BALL * (r * w**2 - G * np.sin(th)), BALL * (rd * w**2 - G * w * np.cos(th))]
    for order, value in enumerate(wanted):
        np.testing.assert_allclose(lie_derivative(lambda x: x[0], f, order)(X), value, rtol=1e-14)
    np.testing.assert_allclose(lie_derivative(lie_derivative(lambda x: x[0], f, 2), g)(X), 2 * BALL * r * w, rtol=1e-14)
    assert float(lie_derivative(lie_derivative(lambda x: x[0], f), g)(X)) == 0.0


@pytest.mark.thorough("x0", "x1")
@pytest.mark.parametrize("x", [(0.0, 0.1, 0.2, 0.5), (0.5, 0.1, 0.2, 0.0), (0.0, 0.0, 0.0, 0.0)])
def test_ball_and_beam_has_no_relative_degree_at_zero_rw(x):
    """Hauser, Sastry, Kokotovic 1992, section 3: L_g L_f^2 h = 2 B r w."""
    found = relative_degree(ball_and_beam(), x)
    assert found.degrees == {"r": 3}
    assert not found.is_defined
    assert found.margin["r"] == 0.0
    assert "around the point, but not at the point" in found.why[0]


@pytest.mark.thorough
def test_ball_and_beam_relative_degree_elsewhere_and_approximated():
    found = relative_degree(ball_and_beam(), X)
    assert (found.degrees, found.is_defined, found.total, found.why) == ({"r": 3}, True, 3, ())
    np.testing.assert_allclose(found.matrix, [[2 * BALL * X[0] * X[3]]], rtol=1e-14)
    rough = relative_degree(ball_and_beam(whole=False), np.zeros(4))
    assert (rough.degrees, rough.is_defined) == ({"r": 4}, True)
    np.testing.assert_allclose(rough.matrix, [[-BALL * G]], rtol=1e-14)


@pytest.mark.thorough
def test_planar_vtol_relative_degree_and_determinant():
    """Hauser, Sastry, Meyer 1992, section 2: determinant -eps; without the coupling, singular, and (4, 4) extended."""
    x = {"theta": 0.3}
    found = relative_degree(vtol(0.01), x)
    assert (found.degrees, found.is_defined, found.total) == ({"x": 2, "y": 2}, True, 4)
    np.testing.assert_allclose(found.determinant, -0.01, rtol=1e-12)
    s, c = np.sin(0.3), np.cos(0.3)
    np.testing.assert_allclose(found.matrix, [[-s, 0.01 * c], [c, 0.01 * s]], rtol=1e-12)
    assert found.condition < 3  # small only in its units
    flat = relative_degree(vtol(0.0), x)
    assert not flat.is_defined
    assert "singular everywhere near the point" in flat.why[0]
    assert flat.why[0].endswith("extension of u1")
    upright = relative_degree(vtol(0.0)).why
    assert "but not at the point" in upright[0]
    assert "singular everywhere near the point" in upright[1]
    longer = relative_degree(extend_inputs(vtol(0.0), ("u1",), 2), x)
    assert (longer.degrees, longer.is_defined, longer.total) == ({"x": 4, "y": 4}, True, 8)
    np.testing.assert_allclose(longer.determinant, G, rtol=1e-12)


@pytest.mark.thorough
def test_hovercraft_is_flat_at_its_centre_of_oscillation():
    """There the sideways force cancels, two terms of opposite sign: no input, but for rounding."""
    craft = Hovercraft()
    centre = craft.inertia / (craft.mass * craft.arm)
    plain = relative_degree(hovercraft(heading=0.5))
    assert (plain.degrees, plain.is_defined, plain.total) == ({"north": 2, "east": 2}, True, 4)
    np.testing.assert_allclose(plain.determinant, 1 / craft.mass**2, rtol=1e-12)
    at_centre = relative_degree(hovercraft(centre, heading=0.5))
    assert not at_centre.is_defined
    assert (at_centre.matrix[:, 1] == 0).all()
    # with FX + m away r^2 the point moves with FX alone, and twice extended nothing is left over
    model = extend_inputs(
        with_centripetal(hovercraft(centre, heading=0.5), "FX", "yaw_rate", craft.mass * centre), ("FX",), 2
    )
    flat = relative_degree(model, {"FX": 0.3})
    assert (flat.total, flat.is_defined) == (8, True)
    coasting = relative_degree(model)
    assert "at the point only" in coasting.why[0]  # without thrust the rudder turns nothing that moves


@pytest.mark.thorough
def test_relative_degree_of_systems_not_affine_in_input():
    model = model_of_functions(
        lambda x, u: jnp.stack([x[1], x[0] + u[0] + u[0] ** 2]), ("a", "b"), ("u",), h=lambda x, u: x[:1]
    )
    found = relative_degree(model, u=[0.7])
    assert found.degrees == {"y0": 2}
    np.testing.assert_allclose(found.matrix, [[1 + 2 * 0.7]], rtol=1e-14)
    assert not relative_degree(model, u=[-0.5]).is_defined
    assert curved_inputs(model) == {"u": ("b",)}
    longer = extend_inputs(model, ("u",))
    assert (curved_inputs(longer), longer.inputs, longer.states) == ({}, ("u'",), ("a", "b", "u"))
    assert relative_degree(longer, {"u": 0.7}).degrees == {"y0": 3}
    np.testing.assert_allclose(output_derivatives(model, 0, 2)(np.array([1.0, 2]), np.array([0.7])), 1 + 0.7 + 0.49)


def test_affine_fields_are_expanded_about_the_given_input():
    model = model_of_functions(lambda x, u: x * u[0] ** 2, ("a",), ("u",))
    f, (g,) = affine_fields(model, [2.0])
    np.testing.assert_allclose([f(jnp.ones(1))[0] + 2 * g(jnp.ones(1))[0], g(jnp.ones(1))[0]], [4.0, 4.0])


def test_unreachable_feedthrough_and_surplus_outputs_are_reported():
    A = jnp.array([[0, 1.0, 0], [0, 0, 0], [0, 0, -1]])
    model = model_of_functions(
        lambda x, u: A @ x + jnp.array([0.0, 1, 0]) * u,
        ("a", "b", "c"),
        ("u",),
        h=lambda x, u: jnp.append(x, x[0] + u[0]),
    )
    found = relative_degree(model)
    assert list(found.degrees.values()) == [2, 1, None, 0]
    assert any("no input affects the output y2" in w for w in found.why)
    assert any("4 outputs need at least 4 inputs, the model has 1" in w for w in found.why)


def test_units_do_not_change_the_condition_number():
    A = np.array([[1.0, 2], [3, -4]])
    scaled = np.diag([1e6, 1e-3]) @ A @ np.diag([1e-5, 7.0])
    np.testing.assert_allclose(np.abs(equilibrate(scaled)), np.abs(equilibrate(A)), rtol=1e-9)


def test_rejects_invalid_arguments():
    with pytest.raises(InputError, match=r"radius: "):
        relative_degree(ball_and_beam(), radius=-1.0)
    with pytest.raises(InputError, match="unknown name 'phi'"):
        relative_degree(ball_and_beam(), radius={"phi": 1.0})
    with pytest.raises(InputError, match=r"extend\.order"):
        extend_inputs(ball_and_beam(), ("u",), 0)
    with pytest.raises(InputError, match="unknown name 'FZ'"):
        extend_inputs(hovercraft(), ("FZ",))
    root = model_of_functions(lambda x, u: jnp.sqrt(x) * u, ("a",), ("u",))
    with pytest.raises(InputError, match="a derivative is not finite"):
        relative_degree(root, [-1.0])
