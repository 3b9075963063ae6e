"""Bounded solutions against closed forms and boundary value solvers; X S = A X + G against closed forms."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from trimtab.core.errors import InputError
from trimtab.design.stable_inversion import (
    bounded_residual,
    bounded_solution,
    exosystem_matrix,
    find_places,
    solve_steady_response,
)


def test_ramp_driven_unstable_mode_has_exact_bounded_solution():
    """z' = 2 z + t: -t/2 - 1/4 is the only bounded one (up to the ramp), and w is linear: exact."""
    t = np.linspace(0, 4, 81)
    wanted = -t / 2 - 0.25
    found = bounded_solution(
        lambda z: 2 * z + t[:, None], [[2.0]], np.zeros((81, 1)), 0.05, left=[0.0], right=wanted[-1:], scales=[1.0]
    )
    np.testing.assert_allclose(found.zeta[:, 0], wanted, atol=1e-13)
    np.testing.assert_allclose(found.rates[:, 0], -0.5, atol=1e-13)
    assert (found.iterations, found.unstable) == (2, 1)
    assert found.changes[1] < 1e-13
    assert np.abs(bounded_residual(found, 0.05)).max() < 1e-12


@pytest.mark.parametrize("dt", [0.02, 0.01])
def test_bounded_solution_with_complex_and_repeated_poles(dt):
    """z' = A z + b cos 1.3 t with poles -1 (twice, one eigenvector), 1 +- 3i: Re((1.3 i - A)^-1 b e^(1.3 i t))."""
    blocks = np.zeros((4, 4))
    blocks[:2, :2], blocks[2:, 2:] = [[-1, 1], [0, -1]], [[1, 3], [-3, 1]]
    M = np.random.default_rng(1).normal(size=(4, 4))
    A, b = M @ blocks @ np.linalg.inv(M), np.array([1.0, -2.0, 0.5, 3.0])
    t = dt * np.arange(round(10 / dt) + 1)
    wanted = (np.linalg.solve(1.3j * np.eye(4) - A, b)[:, None] * np.exp(1.3j * t)).real.T
    found = bounded_solution(
        lambda z: z @ A.T + np.cos(1.3 * t)[:, None] * b,
        A,
        np.zeros_like(wanted),
        dt,
        left=wanted[0],
        right=wanted[-1],
        scales=np.ones(4),
        tolerance=1e-9,
    )
    assert found.unstable == 2
    np.testing.assert_allclose(np.sort(found.poles.real), [-1, -1, 1, 1], atol=1e-6)
    np.testing.assert_allclose(found.zeta, wanted, atol=1.2 * np.abs(wanted).max() * dt**2)


SMALL = 0.3


def rolling(t):
    """A roll angle of a vertical take-off aircraft (rad), its rate and acceleration: a pulse."""
    s = t - 10
    a = 0.5 * np.exp(-(s**2) / 2)
    return a, -s * a, (s**2 - 1) * a


def aircraft(t):
    """Internal dynamics of the planar aircraft while it moves sideways so that `rolling` is its bounded solution.

    eps theta'' = sin theta + cos theta x'' at constant height (J. Hauser, S. Sastry, G. Meyer, "Nonlinear control
    design for slightly non-minimum phase systems", Automatica 28(4), 1992), solved for x''.
    """
    angle, _, acceleration = rolling(t)
    sideways = (SMALL * acceleration - np.sin(angle)) / np.cos(angle)
    return lambda z: np.stack([z[:, 1], (np.sin(z[:, 0]) + np.cos(z[:, 0]) * sideways) / SMALL], axis=1)


AIRCRAFT = np.array([[0.0, 1.0], [1 / SMALL, 0.0]])


def test_planar_aircraft_matches_its_closed_form():
    """Nonlinear, poles +-1.83, roll of 29 deg: the iteration finds the roll that the motion was made from."""
    for dt, off in ((0.02, 2e-4), (0.005, 1.25e-5)):
        t = dt * np.arange(round(20 / dt) + 1)
        found = bounded_solution(
            aircraft(t), AIRCRAFT, np.zeros((len(t), 2)), dt, left=np.zeros(2), right=np.zeros(2), scales=np.ones(2)
        )
        wanted = np.stack(rolling(t)[:2], axis=1)
        assert np.abs(found.zeta - wanted).max() < off
        assert found.iterations > 3
    np.testing.assert_allclose(bounded_residual(found, 0.005), 0, atol=1e-4)


def test_bounded_solution_does_not_depend_on_the_jacobian():
    """Other poles, the same solution."""
    t = 0.01 * np.arange(2001)
    ends = {"left": np.zeros(2), "right": np.zeros(2), "scales": np.ones(2)}
    one, two = (
        bounded_solution(aircraft(t), A, np.zeros((2001, 2)), 0.01, **ends)
        for A in (AIRCRAFT, [[0.0, 1.0], [0.8 / SMALL, -0.2]])
    )
    np.testing.assert_allclose(one.zeta, two.zeta, atol=2e-4)
    assert one.iterations != two.iterations


def test_forward_integration_of_the_same_problem_diverges():
    """Why stable inversion is needed: an initial error of 1e-9 grows to more than 1 rad before the pulse is over."""

    def forward(t, z):
        return aircraft(np.array([t]))(z[None])[0]

    gone = solve_ivp(forward, (0, 14), [1e-9, 0.0], rtol=1e-11, atol=1e-13, t_eval=[8.0, 14.0])
    assert abs(gone.y[0, -1] - rolling(14.0)[0]) > 1.0


def linear(**changes):
    """The arguments of a small stable problem, some changed."""
    given = {
        "psi": lambda z: -z + 1,
        "A": [[-1.0]],
        "start": np.zeros((11, 1)),
        "dt": 0.1,
        "left": [0.0],
        "right": [0.0],
        "scales": [1.0],
    }
    return bounded_solution(**{**given, **changes})


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"A": [[1.0, 0.0]]}, r"A: must have shape \(1, 1\), got \(1, 2\)"),
        ({"A": [[np.nan]]}, "A: must be finite"),
        ({"left": [np.inf]}, "left: must be finite"),
        ({"start": np.zeros(11)}, r"start: must have shape .*, got \(11,\)"),
        ({"dt": 0.0}, "got 11 and 0 s"),
        ({"start": np.zeros((1, 1))}, "got 1 and 0.1 s"),
        ({"scales": [-1.0]}, "scales: must be above 0"),
    ],
)
def test_bounded_solution_rejects_invalid_arguments(changes, text):
    np.testing.assert_allclose(linear().zeta[:, 0], 1 - np.exp(-0.1 * np.arange(11)), atol=1e-12)
    with pytest.raises(InputError, match=text):
        linear(**changes)


def test_pure_integrator_is_integrated_from_the_left():
    """A pole at zero without feedback is an integrator: a rate of 1 + 2 t gives t + t^2 exactly."""
    t = 0.1 * np.arange(11)
    found = linear(A=[[0.0]], psi=lambda z: (1 + 2 * t)[:, None], left=[3.0], right=[np.pi])
    np.testing.assert_allclose(found.zeta[:, 0], 3 + t + t**2, atol=1e-12)
    assert (found.places, len(found.poles), found.unstable) == ((0,), 0, 0)
    assert find_places([[0, 1, 0], [0, 0, 0], [1, 0, -1.0]]) == ()
    assert find_places([[0, 1, 0], [0, 0, 1], [0, 0, -1.0]]) == (0, 1)


def test_rejects_poles_on_the_imaginary_axis():
    with pytest.raises(InputError, match=r"imaginary axis: .*2j"):
        linear(A=[[0.0, 2.0], [-2.0, 0.0]], start=np.zeros((11, 2)), left=[0, 0], right=[0, 0], scales=[1, 1])


@pytest.mark.parametrize("psi", [lambda z: -z - 9 * z + 3, lambda z: z**3 - z + 40])
def test_diverging_iteration_error_lists_successive_changes(psi):
    """psi is much stiffer than A, or grows with its own size."""
    with pytest.raises(
        InputError, match=r"largest change in each iteration, relative to the scales: [\d.e+]+, [\d.e+]+"
    ) as told:
        linear(psi=psi, start=np.zeros((101, 1)))
    assert "slower or smaller" in str(told.value)


def test_sine_driven_unstable_system_matches_closed_form():
    """z' = 2 z + sin t: the bounded solution is -(2 sin t + cos t)/5."""
    X = solve_steady_response([[2.0]], [[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    np.testing.assert_allclose(X, [[-0.4, -0.2]], atol=1e-15)


def test_steady_response_solves_sylvester_and_follows_simulation():
    draws = np.random.default_rng(4)
    A, G = draws.normal(size=(4, 4)), draws.normal(size=(4, 3))
    S = exosystem_matrix(0.7, 3)
    X = solve_steady_response(A, S, G)
    np.testing.assert_allclose(X @ S, A @ X + G, atol=1e-12)
    start = np.array([-1.0, 0.0, 0.0])
    together = solve_ivp(
        lambda t, z: np.concatenate([A @ z[:4] + G @ z[4:], S @ z[4:]]),
        (0, 1.5),
        np.append(X @ start, start),
        rtol=1e-11,
    ).y[:, -1]
    np.testing.assert_allclose(together[:4], X @ together[4:], rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("order", [1, 3, 4])
def test_exosystem_matrix_has_expected_poles_and_step_response(order):
    S = exosystem_matrix(0.06, order)
    np.testing.assert_allclose(np.poly(S), np.poly([-0.06] * order), rtol=1e-12)
    start = -np.eye(order)[0]
    a = 0.06 * 40
    factors = np.cumprod([1, *(a / np.arange(1, order))])
    ended = solve_ivp(lambda t, z: S @ z, (0, 40), start, rtol=1e-11, atol=1e-14).y[0, -1]
    np.testing.assert_allclose(ended, -np.exp(-a) * factors.sum(), rtol=1e-8)


@pytest.mark.parametrize(
    ("A", "S", "G", "text"),
    [
        ([[-1.0]], [[-1.0]], [[1.0]], "pole -1 is also a pole of the exosystem"),
        ([[-1.0]], [[0.0, 1.0]], [[1.0]], r"S: must be finite numbers .*, got shape \(1, 2\)"),
        ([[-1.0]], [[0.0]], [[1.0, 2.0]], r"G: must be finite numbers .*, got shape \(1, 2\)"),
        ([[np.nan]], [[0.0]], [[1.0]], "A: must be finite numbers"),
    ],
)
def test_steady_response_rejects_invalid_arguments(A, S, G, text):
    with pytest.raises(InputError, match=text):
        solve_steady_response(A, S, G)
