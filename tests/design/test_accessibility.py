"""Accessibility and small-time controllability of systems whose answer is known from the literature."""

import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.design.accessibility import bracket_fields, expand_fields, find_accessibility
from trimtab.design.model import model_of_functions
from trimtab.scenarios.hovercraft._models import model as hovercraft

M, J, ARM = 2.6, 0.096, 0.32


def model(f, states, inputs, **point):
    return model_of_functions(f, tuple(states.split()), tuple(inputs.split()), **point)


def names(brackets):
    return [b.name for b in brackets]


def test_lie_bracket_matches_analytic_value():
    """Isidori 1995, section 1.2: [f, g] = (dg/dx) f - (df/dx) g."""
    whole = model(lambda x, u: jnp.stack([x[1] + u[0] * x[0] ** 2, x[0] * x[1] + u[0] * jnp.sin(x[1])]), "x y", "u")
    x, y = 0.7, -0.4
    f, g = expand_fields(whole, np.array([x, y]), np.array([0.3]), 3)
    by_hand = [2 * x * y - np.sin(y), np.cos(y) * x * y - (y * x**2 + x * np.sin(y))]
    np.testing.assert_allclose(bracket_fields(f, g, 2)[0, 0], by_hand, rtol=1e-12)
    slope_by_x = [2 * y, np.cos(y) * y - (2 * x * y + np.sin(y))]
    np.testing.assert_allclose(bracket_fields(f, g, 2)[1, 0], slope_by_x, rtol=1e-12)


def test_controllable_linear_model_implies_small_time_controllability():
    chain = model(lambda x, u: jnp.stack([x[1], x[2], u[0] + x[0] ** 2]), "x v a", "u")
    found = find_accessibility(chain)
    assert (found.is_linear, found.is_stlc, found.rank) == (True, True, 3)
    assert names(found.basis) == ["u", "[f, u]", "[f, [f, u]]"]
    np.testing.assert_allclose([b.value for b in found.basis], [[0, 0, 1], [0, -1, 0], [1, 0, 0]])


@pytest.mark.thorough
def test_rank_suffices_for_driftless_systems():
    """The nonholonomic integrator and the unicycle: driftless, so that Chow's theorem holds."""
    for system in (
        model(lambda x, u: jnp.stack([u[0], u[1], x[0] * u[1] - x[1] * u[0]]), "x y z", "a b"),
        model(lambda x, u: jnp.stack([u[0] * jnp.cos(x[2]), u[0] * jnp.sin(x[2]), u[1]]), "x y t", "v w"),
    ):
        found = find_accessibility(system)
        assert (found.is_accessible, found.is_stlc, found.is_linear) == (True, True, False)
        assert not found.bad
        assert found.basis[2].degree == 2


def test_square_drift_is_accessible_but_not_stlc():
    """x' = u, y' = x^2: accessible, but y never falls (Sussmann 1987, section 1)."""
    found = find_accessibility(model(lambda x, u: jnp.stack([u[0], x[0] ** 2]), "x y", "u"))
    assert (found.is_accessible, found.is_stlc) == (True, False)
    assert names(found.obstructions) == ["[u, [f, u]]"]


def test_cubic_drift_is_small_time_controllable():
    """x' = u, y' = x^3 is controllable in small time: the bracket that is needed is good (Sussmann 1987)."""
    found = find_accessibility(model(lambda x, u: jnp.stack([u[0], x[0] ** 3]), "x y", "u"))
    assert (found.is_accessible, found.is_stlc) == (True, True)
    assert found.basis[1].degree == 4


@pytest.mark.thorough
def test_uncontrolled_state_makes_system_inaccessible():
    found = find_accessibility(model(lambda x, u: jnp.stack([u[0], -x[1]]), "x y", "u"))
    assert (found.is_accessible, found.rank, found.is_stlc) == (False, 1, False)


@pytest.mark.thorough
def test_hovercraft_needs_brackets_of_degree_four():
    """Lewis and Murray 1997 (planar body): sideways by [FY, [f, FX]] = -d/(m J) e_v; the bad bracket is along surge."""
    found = find_accessibility(hovercraft())
    assert (found.rank, found.is_accessible, found.is_stlc, found.is_linear) == (6, True, True, False)
    at = {b.name: b.value for b in found.basis}
    sway = np.zeros(6)
    sway[1] = -ARM / (J * M)
    np.testing.assert_allclose(at["[FY, [f, FX]]"], sway, rtol=1e-9)
    np.testing.assert_allclose(at["FY"], [0, 1 / M, -ARM / J, 0, 0, 0], rtol=1e-12)
    (bad,) = found.bad
    np.testing.assert_allclose(bad.value, [2 * ARM / (M * J), 0, 0, 0, 0, 0], rtol=1e-9)
    assert max(b.degree for b in found.basis) == 4


@pytest.mark.thorough
def test_hovercraft_without_surge_force_is_not_stlc():
    whole = hovercraft()
    turned = model(lambda x, u: whole.f(x, jnp.stack([0.0, u[0]])), " ".join(whole.states), "FY")
    found = find_accessibility(turned)
    assert not found.is_stlc
    assert "[FY, [f, FY]]" in names(found.obstructions)


def test_reports_input_that_is_not_affine():
    found = find_accessibility(model(lambda x, u: jnp.stack([u[0] + u[0] ** 2, x[0] ** 3]), "x y", "u"))
    assert found.curved == ("u",)


def test_rejects_point_that_is_not_an_equilibrium():
    with pytest.raises(InputError, match="y would change"):
        find_accessibility(model(lambda x, u: jnp.stack([u[0], 1.0 + x[0]]), "x y", "u"))
