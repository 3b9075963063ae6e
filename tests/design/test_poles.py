"""Poles: against polynomials, eigenvectors, and systems whose uncontrollable part is built in."""

import numpy as np
import pytest

from trimtab.design.poles import balance_matrix, format_pole, participation, sorted_poles, uncontrollable_poles

rng = np.random.default_rng(4)


def test_poles_are_sorted_by_falling_real_part():
    companion = np.array([[-6.0, -13.0, -10.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # (s + 2)(s^2 + 4 s + 5)
    np.testing.assert_allclose(sorted_poles(companion), [-2, -2 + 1j, -2 - 1j], atol=1e-7)
    np.testing.assert_array_equal(sorted_poles(np.diag([-3.0, 2.0, 0.0])), [2, 0, -3])


def test_formats_real_poles_and_complex_pairs():
    assert format_pole(complex(-1.5)) == "-1.5 1/s"
    assert format_pole(0.25 - 3j) == format_pole(0.25 + 3j) == "+0.25 ± 3i 1/s"


def test_balancing_is_a_power_of_two_similarity():
    A = rng.normal(size=(4, 4)) * np.outer([1, 1e4, 1e-3, 50], 1 / np.array([1, 1e4, 1e-3, 50]))
    B = balance_matrix(A)
    scale = np.log2(np.abs(B / A))
    np.testing.assert_array_equal(scale, np.round(scale))
    np.testing.assert_allclose(np.poly(B), np.poly(A), rtol=1e-9)
    assert np.linalg.norm(B) < np.linalg.norm(A) / 100


def test_participation_is_the_product_of_left_and_right_eigenvector():
    A = rng.normal(size=(5, 5))
    poles, right = np.linalg.eig(A)
    left = np.linalg.inv(right)
    for k, pole in enumerate(poles):
        product = np.abs(right[:, k] * left[k])
        np.testing.assert_allclose(participation(A, pole, 1e-9), product / product.sum(), atol=1e-10)


@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e6])
def test_finds_uncontrollable_poles_in_any_coordinates(scale):
    A, B = np.array([[1.0, 2.0, 0.5], [0.0, -1.0, 0.3], [0.0, 0.0, -4.0]]), np.array([[1.0], [1.0], [0.0]])
    T = rng.normal(size=(3, 3)) + 3 * np.eye(3)
    poles = uncontrollable_poles(scale * T @ A @ np.linalg.inv(T), T @ B)
    np.testing.assert_allclose(poles, [-4.0 * scale], rtol=1e-9)
    assert uncontrollable_poles(scale * A, np.array([[0.0], [1.0], [1.0]])) == ()
