"""Linearisation against automatic derivatives; curvature against drawn states; information of a place."""

import jax
import numpy as np
import pytest

from trimtab.compiler.function import lower_function
from trimtab.estimators.ranging.position import SQUARE
from trimtab.estimators.ranging.range_errors import RangeErrorModel
from trimtab.estimators.ranging.range_model import (
    Geometry,
    linearise_range,
    place_information,
    predict_range,
    update_with_ranges,
)

G = Geometry(SQUARE, np.array([0.2, 0.1]), 0.05, True)
X = np.array([0.7, 0.1, 0.2, 0.3, -0.2, 0.01, 0.1, -0.1, 0.003, 0.01, -0.02, 0.03, 0.0])
P = np.diag([0.04, 1, 1, 0.01, 0.02, 1, 1, 1, 1e-6, 1e-4, 1e-4, 1e-4, 1e-4])


def value(x, i):
    c, s = jax.numpy.cos(x[0]), jax.numpy.sin(x[0])
    place = x[3:5] + jax.numpy.stack([c * 0.2 - s * 0.1, s * 0.2 + c * 0.1])
    return (1 + x[8]) * predict_range(SQUARE[i], place, 0.05, cone=True).range + x[9 + i]


@pytest.mark.parametrize("i", range(4))
def test_it_is_the_derivative_of_the_range(i):
    at = linearise_range(X, P, i, G)
    assert float(at.range) == pytest.approx(float(value(X, i)), rel=1e-14)
    np.testing.assert_allclose(at.H, jax.grad(value)(X, i), atol=1e-12)


def test_curvature_adds_what_drawn_states_show():
    """Mean and variance beyond first order of 400000 states (Bar-Shalom 10.3.3)."""
    g = np.random.default_rng(0)
    x = X + np.sqrt(np.diag(P)) * g.standard_normal((400_000, 13))
    at = linearise_range(X, P, 0, G)
    z = np.asarray(jax.jit(jax.vmap(lambda x: value(x, 0)))(x))
    rest = z - float(at.range) - (x - X) @ np.asarray(at.H)
    assert rest.mean() == pytest.approx(float(at.mean), rel=0.05)
    assert rest.var() == pytest.approx(float(at.variance), rel=0.1)


def test_a_ping_is_used_range_by_range():
    """The right ones are used, a wrong, a silent and a considered one not or hardly; the state comes nearer."""
    truth = X.copy()
    truth[[3, 4]] += [0.05, -0.1]
    z = np.array([float(value(truth, i)) for i in range(4)])
    z[1] += 2.0
    done = update_with_ranges(
        X, P, z, np.array([True, True, True, False]), G, RangeErrorModel(), np.r_[np.ones(9), np.zeros(4)]
    )
    assert list(np.asarray(done.accepted)) == [True, False, True, False]
    np.testing.assert_array_equal(done.x[9:], X[9:])
    assert done.nis[3] == 0.0
    assert done.nis[1] > 15.1
    assert np.all(np.linalg.eigvalsh(np.asarray(done.P)) > 0)
    assert np.all(np.diag(np.asarray(done.P))[9:] == np.diag(P)[9:])


def test_information_of_a_place_is_that_of_its_slopes():
    place = np.array([0.3, -0.2])
    used = np.array([True, True, False, True])
    slopes = np.array([predict_range(b, place, 0.05, cone=True).slope for b in SQUARE])[used]
    np.testing.assert_allclose(place_information(place, used, G, 0.02), slopes.T @ slopes / 4e-4, rtol=1e-12)


def test_it_exports():
    learns = np.ones(13)

    def f(x, P, z):
        return update_with_ranges(x, P, z, z > 0, G, RangeErrorModel(), learns)

    assert lower_function(f, (X, P, np.ones(4))).text("f")
