import numpy as np
import pytest
from scipy.optimize import least_squares

from trimtab.core.errors import InputError
from trimtab.design.dilution import dilution, dilution_map

H = 2.7048
SQUARE = np.array([[1.5, 1.5, -H], [1.5, -1.5, -H], [-1.5, -1.5, -H], [-1.5, 1.5, -H]])


def test_dilution_below_square_centre_matches_analytic_value():
    """Each axis has 1/(2 sin) with the sine of 1.5 m in a range of 3.437 m."""
    found = dilution_map(SQUARE, [0.0], [0.0])
    s = 1.5 / np.sqrt(2 * 1.5**2 + H**2)
    assert float(found.dilution[0, 0]) == pytest.approx(np.sqrt(2) / (2 * s))
    assert found.visible[0, 0] == 4
    with_error = dilution_map(SQUARE, [0.0], [0.0], common_error=True)
    assert float(with_error.dilution[0, 0]) == pytest.approx(float(found.dilution[0, 0]))  # symmetry parts them


@pytest.mark.thorough
@pytest.mark.parametrize("common_error", [False, True])
def test_dilution_matches_spread_of_noisy_fixes(common_error):
    """Fixes from noisy ranges spread by dilution times noise, at a place off the middle."""
    place, noise, n = np.array([0.4, -0.2]), 0.004, 800
    exact = np.linalg.norm(SQUARE - [*place, 0], axis=1)
    rng = np.random.default_rng(0)
    fixes = []
    for _ in range(n):
        ranges = exact + rng.normal(0, noise, 4)

        def f(x, ranges=ranges):
            return np.linalg.norm(SQUARE - [x[0], x[1], 0], axis=1) + (x[2] if common_error else 0) - ranges

        fixes.append(least_squares(f, [*place, 0.0][: 3 if common_error else 2], method="lm").x[:2])
    spread = np.sqrt(np.mean(np.sum((np.array(fixes) - place) ** 2, axis=1)))
    expected = dilution_map(SQUARE, [place[0]], [place[1]], common_error=common_error).dilution[0, 0]
    assert spread == pytest.approx(noise * float(expected), rel=0.06)


def test_dilution_is_infinite_without_a_unique_fix():
    found = dilution_map(SQUARE, [0.0, 1.5, 9.0], [0.0, 1.5])
    np.testing.assert_array_equal(found.visible, [[4, 2], [2, 1], [0, 0]])
    assert np.isfinite(found.dilution[0, 0])
    assert np.isinf(found.dilution[1:, 1]).all()
    shorter = dilution_map(SQUARE, [0.0, 0.5], [0.0], reach=3.4)  # 3.44 m to each from the middle
    np.testing.assert_array_equal(shorter.visible, [[0], [2]])
    assert np.isinf(shorter.dilution[0, 0])
    row = np.array([[0.0, y, -H] for y in (-1, 0, 1)])
    assert np.isinf(dilution_map(row, [0.0], [0.2]).dilution[0, 0])
    assert found.coverage(limit=9.0) == pytest.approx(np.mean(found.dilution <= 9.0))


@pytest.mark.parametrize("common_error", [False, True])
def test_invisible_beacons_are_left_out_of_dilution(common_error):
    """Four of six rates, by textbook: (H'H)^-1 of those there are."""
    directions, visible = np.random.default_rng(2).uniform(-0.7, 0.7, (6, 2)), np.array([1, 0, 1, 1, 0, 1], bool)
    H = np.column_stack([directions[visible], np.ones(4)]) if common_error else directions[visible]
    wanted = np.sqrt(np.trace(np.linalg.inv(H.T @ H)[:2, :2]))
    assert float(dilution(directions, visible, common_error=common_error)) == pytest.approx(wanted, rel=1e-12)


def test_more_beacons_never_increase_dilution():
    rng = np.random.default_rng(1)
    directions = rng.uniform(-0.7, 0.7, (500, 6, 2))
    few = np.arange(6) < 4
    fewer = dilution(directions, np.broadcast_to(few, (500, 6)))
    assert (dilution(directions, np.ones((500, 6), bool)) <= fewer + 1e-12).all()
    with pytest.raises(InputError, match=r"dilution_map\.beacons"):
        dilution_map(np.zeros(3), [0], [0])
