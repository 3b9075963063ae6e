"""Inversion of any vehicle's outputs: it is a motion of the vehicle, and a pole leans before its cart goes."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_bvp, solve_ivp

from examples.my_cart import Cart, CartState, Push
from trimtab.core.errors import InputError
from trimtab.design.model import model_of_functions, model_of_vehicle
from trimtab.design.output_inversion import internal_modes, invert_output, smooth_course

TIMES = np.linspace(0, 6, 3001)


@pytest.fixture(scope="module")
def model():
    return model_of_vehicle(Cart(), CartState(), Push(), outputs=["position"])


@pytest.fixture(scope="module")
def inversion(model):
    course = smooth_course(TIMES, {"position": (0.0, 0.5)}, 2.0, 4.0, order=2)
    end = np.array([0.5, 0, 0, 0]), np.zeros(1)
    return course, invert_output(model, course, end=end)


@pytest.mark.thorough
def test_inverted_motion_satisfies_the_vehicle_equations(model, inversion):
    course, found = inversion
    np.testing.assert_allclose(found.x[:, 0], course.derivatives["position"][0], atol=1e-9)
    rates = np.array([np.asarray(model.f(x, u)) for x, u in zip(found.x[::50], found.u[::50], strict=True)])
    slopes = np.gradient(found.x, TIMES, axis=0)[::50]
    np.testing.assert_allclose(rates[1:-1], slopes[1:-1], atol=2e-4)
    assert np.abs(found.x[:, 2]).max() > 0.02


@pytest.mark.thorough
def test_pole_leans_before_the_cart_moves(inversion):
    """Zeros at ±sqrt(g/l): before anything is to be seen of the output it grows with that exponent."""
    _, found = inversion
    before = (TIMES > 1.2) & (TIMES < 1.9)
    growth = np.polyfit(TIMES[before], np.log(np.abs(found.x[before, 2])), 1)[0]
    assert growth == pytest.approx(np.sqrt(9.80665 / 0.5), rel=1e-3)
    assert found.x[TIMES == 2.0, 2].item() > 1e-3


@pytest.mark.thorough
def test_open_loop_flight_follows_the_inverse_briefly(model, inversion):
    _, found = inversion
    part = slice(900, 1301)  # 0.8 s of an unstable vehicle

    def f(t, x):
        u = [np.interp(t, TIMES, found.u[:, 0])]
        return np.asarray(model.f(x, np.array(u)))

    end = solve_ivp(f, (TIMES[900], TIMES[1300]), found.x[900], rtol=1e-8, atol=1e-10, max_step=0.05).y[:, -1]
    np.testing.assert_allclose(end, found.x[part][-1], atol=1e-4)


@pytest.mark.thorough
def test_smooth_course_is_smooth_and_rejects_bad_arguments(model):
    course = smooth_course(TIMES, {"position": (1.0, 3.0)}, 1.0, 5.0, order=3)
    y = course.derivatives["position"]
    assert (y[0, 0], y[0, -1]) == (1.0, pytest.approx(3.0))
    for k in range(3):
        np.testing.assert_allclose(np.gradient(y[k], TIMES)[1:-1], y[k + 1][1:-1], atol=2e-3)
        assert abs(y[k + 1][[0, -1]]).max() < 1e-12
    with pytest.raises(InputError, match="position: 2"):
        invert_output(model, smooth_course(TIMES, {"position": (0, 1)}, 1.0, 5.0, order=1))
    with pytest.raises(InputError, match="within the grid"):
        smooth_course(TIMES, {"position": (0, 1)}, 1.0, 9.0, order=2)


@pytest.mark.thorough
def test_inversion_matches_scipy_boundary_value_solution(inversion):
    """Lean of the pole over an acceleration of its cart that is given: scipy's solve_bvp, bounded by its ends.

    Before the course it leaves rest along the unstable direction, after it it comes back along the stable one.
    """
    course, found = inversion
    g, length, w = 9.80665, 0.5, np.sqrt(9.80665 / 0.5)
    acceleration = course.derivatives["position"][2]

    def rates(t, y):
        a = np.interp(t, TIMES, acceleration)
        return np.stack([y[1], (g * np.sin(y[0]) - a * np.cos(y[0])) / length])

    def ends(first, last):
        return np.array([first[1] - w * first[0], last[1] + w * last[0]])

    grid = np.linspace(0, 6, 601)
    oracle = solve_bvp(rates, ends, grid, np.zeros((2, len(grid))), tol=1e-9, max_nodes=20000)
    assert oracle.success
    np.testing.assert_allclose(found.x[:, 2], oracle.sol(TIMES)[0], atol=2e-7)
    assert np.abs(oracle.sol(TIMES)[0]).max() > 0.04


def inside(slow):
    """y'' = u; z runs away, s' = slow s + …, a and b hold places: nothing depends on b, nothing but b' on a."""

    def f(x, u):
        y, v, z, s, a, _ = x
        return jnp.stack([v, u[0], 2 * z - y + 0.2 * jnp.sin(s), v + slow * s, jnp.sin(z) + s, a])

    return f


@pytest.mark.thorough
@pytest.mark.parametrize("slow", [-0.02, 0.02])
def test_internal_integrators_match_scipy_boundary_value_solution(slow):
    """scipy's solve_bvp: what runs away by its end, though it takes 50 s to; all else by its start."""
    states = ("y", "v", "z", "s", "a", "b")
    x0 = np.array([0.0, 0.0, 0.0, 0.0, 1.0, -2.0])
    model = model_of_functions(inside(slow), states, ("u",), h=lambda x, u: x[:1], outputs=("y",), x0=x0)
    times = np.linspace(0, 14, 5601)
    found = invert_output(model, smooth_course(times, {"y": (0.0, 0.5)}, 2.0, 5.0, order=2))
    places, modes = internal_modes(found.form)
    assert places == ("a", "b")
    assert {m.states: round(m.pole.real, 6) for m in modes} == {"z": 2.0, "s": slow}
    rise = np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20]) * 0.5

    def rates(t, q):
        s = np.clip((t - 2) / 3, 0, 1)
        y, v = rise(s), rise.deriv()(s) / 3
        return np.stack([2 * q[0] - y + 0.2 * np.sin(q[1]), v + slow * q[1], np.sin(q[0]) + q[1], q[2]])

    def ends(first, last):
        return np.array([last[0], (first if slow < 0 else last)[1], first[2] - 1, first[3] + 2])

    seen = times < 6  # what is taken of the end has faded by e^-16
    grid = np.linspace(0, 14, 1401)
    oracle = solve_bvp(rates, ends, grid, np.zeros((4, len(grid))), tol=1e-9, max_nodes=100_000)
    assert oracle.success
    np.testing.assert_allclose(found.x[seen, 2:], oracle.sol(times[seen]).T, atol=1e-6)
    assert np.ptp(found.x[seen, 5]) > (5 if slow < 0 else 1)


def test_rejects_undamped_internal_mode_by_name():
    def swinging(x, u):
        return jnp.stack([u[0], x[2], x[0] - x[1]])

    model = model_of_functions(swinging, ("y", "swing", "swing_rate"), ("u",), h=lambda x, u: x[:1], outputs=("y",))
    with pytest.raises(InputError, match=r"neither decay nor grow.*swing") as refused:
        invert_output(model, smooth_course(np.linspace(0, 4, 101), {"y": (0.0, 1.0)}, 1.0, 2.0, order=1))
    assert "another output" in refused.value.fix


@pytest.mark.parametrize("output", [0, 1])
def test_inverts_chain_without_internal_modes(output):
    """Three integrators: their first state has no internal coordinate, their second leaves a place."""
    model = model_of_functions(
        lambda x, u: jnp.stack([x[1], x[2], u[0]]), ("x0", "x1", "x2"), ("u",), h=lambda x, u: x[output : output + 1]
    )
    course = smooth_course(TIMES[::10], {"y0": (0.0, 0.5)}, 2.0, 4.0, order=3)
    found = invert_output(model, course)
    np.testing.assert_allclose(found.u[:, 0], course.derivatives["y0"][3 - output], atol=1e-9)
    assert found.x[-1, output] == pytest.approx(0.5, abs=1e-9)
