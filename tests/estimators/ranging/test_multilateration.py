import jax
import numpy as np
import pytest
from scipy.optimize import least_squares as scipy_least_squares

from trimtab.compiler.function import lower_function
from trimtab.estimators.ranging.multilateration import (
    assisted_heading,
    intersect_circles,
    solve_bancroft,
    solve_least_squares,
    solve_leaving_one_out,
    two_unit_heading,
)

H = 2.7048
SQUARE = np.array([[1.5, 1.5], [1.5, -1.5], [-1.5, -1.5], [-1.5, 1.5]])
UNEVEN = np.array([[0.0, 0.0], [3.1, 0.4], [2.6, 3.3], [-0.5, 2.2], [1.2, 4.4]])
CLOSED = jax.jit(jax.vmap(solve_bancroft, in_axes=(None, None, 0, 0)))
intersect = jax.jit(intersect_circles)
FITTED = jax.jit(
    jax.vmap(lambda p, h, r, u: solve_least_squares(p, h, r, u, solve_bancroft(p, h, r, u).place), (None, None, 0, 0))
)


def exact(plan, height, places, bias=0.0):
    return np.sqrt(((plan - places[:, None]) ** 2).sum(2) + height**2) + bias


def places(n, seed=0, size=1.4):
    return np.random.default_rng(seed).uniform(-size, size, (n, 2))


@pytest.mark.thorough("0.0-square", "0.05-square", "-0.2-square")
@pytest.mark.parametrize("plan", [SQUARE, UNEVEN], ids=["square", "uneven"])
@pytest.mark.parametrize("bias", [0.0, 0.05, -0.2])
def test_bancroft_is_exact_without_noise(plan, bias):
    """Without noise within 1e-9 m, whatever the common range error, from all beacons."""
    true = plan.mean(0) + places(500)
    height = H + 0.1 * np.arange(len(plan))
    found = CLOSED(plan, height, exact(plan, height, true, bias), np.ones((500, len(plan)), bool))
    assert abs(np.asarray(found.place) - true).max() < 1e-9
    assert abs(np.asarray(found.bias) - bias).max() < 1e-9
    assert np.asarray(found.residual).max() < 1e-9


@pytest.mark.thorough
def test_bancroft_is_exact_with_three_beacons():
    """Any three of five; the far ranges are nonsense and must not matter."""
    true = UNEVEN.mean(0) + places(400)
    used = np.zeros((400, 5), bool)
    rng = np.random.default_rng(1)
    for row in used:
        row[rng.permutation(5)[:3]] = True
    ranges = np.where(used, exact(UNEVEN, H, true), 99.0)
    found = CLOSED(UNEVEN, np.full(5, H), ranges, used)
    assert abs(np.asarray(found.place) - true).max() < 1e-9
    assert abs(np.asarray(found.bias)).max() < 1e-9


def test_three_ranges_choose_the_smaller_common_error():
    """Both roots fit three ranges without residual. Beacons 0.5 m above the unit, places up to 4 m away."""
    plan = np.array([[0.0, 0.0], [3.0, 0.0], [1.0, 2.5]])
    true, height = plan.mean(0) + places(500, size=3.0), np.full(3, 0.5)
    found = CLOSED(plan, height, exact(plan, height, true), np.ones((500, 3), bool))
    assert abs(np.asarray(found.place) - true).max() < 1e-6
    assert abs(np.asarray(found.bias)).max() < 1e-6


@pytest.mark.thorough
@pytest.mark.parametrize("solve", [CLOSED, FITTED], ids=["closed form", "least squares"])
def test_circular_error_of_static_fixes_is_about_5_mm(solve):
    """Half of the static fixes lie within 0.47 to 0.57 cm, with 0.4 cm range noise, four beacons 3 m apart.

    [1] figure 5.8: 0.52 cm.
    """
    n = 20000
    true = np.zeros((n, 2))
    ranges = exact(SQUARE, H, true) + np.random.default_rng(2).normal(0, 0.004, (n, 4))
    found = solve(SQUARE, np.full(4, H), ranges, np.ones((n, 4), bool))
    cep = np.median(np.linalg.norm(np.asarray(found.place) - true, axis=1))
    assert 0.0047 <= cep <= 0.0057


def oracle(plan, height, ranges, with_bias):
    def f(x):
        return np.sqrt(((plan - x[:2]) ** 2).sum(1) + height**2) + (x[2] if with_bias else 0.0) - ranges

    return scipy_least_squares(f, np.append(plan.mean(0), [0.0] * with_bias), xtol=1e-14, ftol=1e-14, gtol=1e-14)


@pytest.mark.thorough
def test_least_squares_matches_scipy():
    true = UNEVEN.mean(0) + places(30)
    ranges = exact(UNEVEN, H, true) + np.random.default_rng(3).normal(0, 0.02, (30, 5))
    used = np.ones((30, 5), bool)
    used[::2, 1] = False
    found = FITTED(UNEVEN, np.full(5, H), ranges, used)
    for i in range(30):
        u = used[i]
        best = oracle(UNEVEN[u], H, ranges[i, u], False)
        np.testing.assert_allclose(found.place[i], best.x, atol=1e-7)
        assert float(found.residual[i]) == pytest.approx(np.sqrt((best.fun**2).mean()), abs=1e-9)


@pytest.mark.thorough
def test_closed_form_and_least_squares_differ_below_half_millimetre():
    """About 0.03 cm, both with a common range error, at 0.4 cm noise, some 0.2 m from the middle of the square.

    It grows in proportion to that distance: the closed form weighs ranges, not their residuals.
    """
    true = places(60, size=0.3)
    ranges = exact(SQUARE, H, true) + np.random.default_rng(4).normal(0, 0.004, (60, 4))
    found = CLOSED(SQUARE, np.full(4, H), ranges, np.ones((60, 4), bool))
    best = np.array([oracle(SQUARE, H, r, True).x[:2] for r in ranges])
    off = np.sqrt((((np.asarray(found.place) - best) ** 2).sum(1)).mean())
    assert 2e-4 < off < 4.5e-4


@pytest.mark.thorough
def test_leave_one_out_finds_the_wrong_range():
    true = UNEVEN.mean(0) + places(50, size=1.0)
    rng = np.random.default_rng(5)
    ranges = exact(UNEVEN, H, true) + rng.normal(0, 0.004, (50, 5))
    wrong = rng.integers(0, 5, 50)
    ranges[np.arange(50), wrong] += rng.choice([-1, 1], 50) * rng.uniform(0.3, 3.0, 50)
    used = np.ones(5, bool)

    def solve(p, h, r, u):
        return solve_least_squares(p, h, r, u, solve_bancroft(p, h, r, u).place)

    def agrees(one):
        return one.residual < 0.02

    find = jax.jit(jax.vmap(lambda r: solve_leaving_one_out(solve, UNEVEN, np.full(5, H), r, used, agrees)))
    out = find(ranges)
    np.testing.assert_array_equal(np.argmin(np.nan_to_num(out.residual, nan=9.0), axis=1), wrong + 1)
    best = np.asarray(out.place)[np.arange(50), wrong + 1]
    assert abs(best - true).max() < 0.04
    good = find(exact(UNEVEN, H, true))
    assert abs(np.asarray(good.place)[:, 0] - true).max() < 1e-9
    assert not np.asarray(good.place)[:, 1:].any()  # the first will do: the others are not looked for


def test_two_ranges_choose_the_side_of_previous_fix():
    true = np.array([[0.4, 0.9], [0.4, -0.9], [-1.0, 0.3]])
    used = np.array([True, False, True, False])
    ranges = exact(SQUARE, H, true)
    for place, r in zip(true, ranges, strict=True):
        near = place + np.array([0.1, -0.05])
        found = intersect(SQUARE, np.full(4, H), np.where(used, r, 7.0), used, near)
        np.testing.assert_allclose(found.place, place, atol=1e-12)
        assert float(found.residual) < 1e-12
        mirrored = intersect(SQUARE, np.full(4, H), r, used, place[::-1])  # the line runs along the diagonal
        np.testing.assert_allclose(mirrored.place, place[::-1], atol=1e-12)


def test_disjoint_circles_give_the_midpoint():
    used = np.array([True, True, False, False])
    ranges = np.sqrt(np.array([1.4, 1.5, 1, 1]) ** 2 + H**2)
    found = intersect(SQUARE, np.full(4, H), ranges, used, np.zeros(2))
    np.testing.assert_allclose(found.place, [1.5, 0.05], atol=0.01)
    assert 0.01 < float(found.residual) < 0.1
    below = intersect(SQUARE, np.full(4, H), np.full(4, 2.0), used, np.zeros(2))  # shorter than the height
    assert np.isfinite(below.place).all()


@pytest.mark.thorough
def test_solvers_lower_to_generated_c():
    height, ranges, used = np.full(4, H), np.full(4, 3.0), np.ones(4, bool)

    def all_of_it(r, u):
        start = solve_bancroft(SQUARE, height, r, u)
        pair = intersect_circles(SQUARE, height, r, u, start.place)
        return solve_leaving_one_out(
            lambda *a: solve_least_squares(*a, start.place), SQUARE, height, r, u, lambda one: one.residual < 0.02
        ), pair

    assert lower_function(all_of_it, [ranges, used]).outputs


FORE, AFT = np.array([0.2, 0.0]), np.array([-0.2, 0.0])


def on_arc(t, lever, rate=2.0, radius=0.3048, start=0.4):
    """A point of a vehicle that turns on a circle, its heading along it: [1] section 6.2.1's rig."""
    angle = rate * t
    heading = start + angle + np.pi / 2
    R = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    return radius * np.array([np.cos(start + angle), np.sin(start + angle)]) + R @ lever, heading


@pytest.mark.parametrize("heading", [-3.1, -1.0, 0.0, 0.7, 3.1])
@pytest.mark.parametrize(
    "levers", [(FORE, AFT), (np.array([0.1, 0.3]), np.array([-0.2, 0.1]))], ids=["on x", "anywhere"]
)
def test_heading_of_simultaneously_located_units_is_exact(heading, levers):
    R = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    found = two_unit_heading(R @ levers[0] + 5.0, R @ levers[1] + 5.0, *levers)
    assert float(found) == pytest.approx(heading, abs=1e-12)


def test_assisted_heading_is_exact_while_turning():
    """A is located first, B 100 ms later; at 115 deg/s the plain line is 5.75° off, half of what it turned."""
    rate = np.radians(115)
    place_a, _ = on_arc(0.0, FORE, rate)
    later_a, heading = on_arc(0.1, FORE, rate)
    place_b, _ = on_arc(0.1, AFT, rate)
    exact = assisted_heading(place_a, place_b, later_a - place_a, FORE, AFT)
    assert np.exp(1j * float(exact)) == pytest.approx(np.exp(1j * heading), abs=1e-12)
    direct = two_unit_heading(place_a, place_b, FORE, AFT)
    assert np.angle(np.exp(1j * (float(direct) - heading))) == pytest.approx(-rate * 0.1 / 2, abs=1e-9)


def test_assisted_heading_errs_with_displacement_of_another_point():
    """With the displacement of the reference point the error is the turn's part: about half the angle turned."""
    rate = np.radians(115)
    moved = on_arc(0.1, np.zeros(2), rate)[0] - on_arc(0.0, np.zeros(2), rate)[0]
    found = assisted_heading(on_arc(0.0, FORE, rate)[0], on_arc(0.1, AFT, rate)[0], moved, FORE, AFT)
    error = np.angle(np.exp(1j * (float(found) - on_arc(0.1, FORE, rate)[1])))
    assert error == pytest.approx(-rate * 0.1 / 2, rel=0.02)


@pytest.mark.thorough
def test_heading_lowers_to_generated_c():
    assert lower_function(assisted_heading, [np.zeros(2)] * 5).outputs
