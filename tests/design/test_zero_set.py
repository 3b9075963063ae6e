"""Zero sets and LaSalle's invariant sets: against textbook answers, and the undecidable cases."""

import pytest

from trimtab.design.polynomial import constant, symbol
from trimtab.design.zero_set import largest_invariant_set, solve_equations

x, y, z, a, b = (symbol(n) for n in "xyzab")


def solve(*equations, unknowns=("x", "y"), positive=("a", "b")):
    return sorted(str(branch) for branch in solve_equations(equations, unknowns, positive))


def test_solves_polynomial_equations_for_zero_sets():
    assert solve(a * x + b * y, y - 2) == ["x = -2*b/a, y = 2"]
    assert solve(x * y) == ["x = 0", "y = 0"]
    assert solve(x * (y - a), x - y) == ["x = 0, y = 0", "x = a, y = a"]
    assert solve(a * x**2 + b * y**4) == ["x = 0, y = 0"]
    assert solve(x**2 + a, y) == []
    assert solve(constant(0)) == ["everything"]
    assert solve(x - 1, x - 2) == []
    assert [branch.dimension for branch in solve_equations((x - y,), ("x", "y"), ())] == [1]


def test_rejects_zero_set_that_depends_on_parameters():
    with pytest.raises(ArithmeticError, match="parameters"):
        solve(x, x + a - b)
    with pytest.raises(ArithmeticError, match="elimination"):
        solve(x**3 + x * y + y**3 + 1)


def test_pendulum_with_friction_has_only_rest_invariant():
    """Khalil, example 4.9, with a polynomial spring: dV/dt = -b y^2, and only rest stays in y = 0."""
    M = largest_invariant_set({"x": y, "y": -a * x - x**3 - b * y}, (y,), ("a", "b"))
    assert [str(branch) for branch in M] == ["x = 0, y = 0"]
    assert "d(y)/dt is" in " ".join(M[0].steps)


def test_undamped_spring_plane_stays_invariant():
    """Two springs, one with friction, not coupled: the other one swings for ever, all of its plane is invariant."""
    field = {"x": y, "y": -x - y, "z": symbol("w"), "w": -z}
    (M,) = largest_invariant_set(field, (y,), ())
    assert set(M.free) == {"z", "w"}
    assert {n: str(v) for n, v in M.values.items()} == {"x": "0", "y": "0"}


def test_two_well_system_has_three_invariant_points():
    """x'' = a^2 x - x^3 - y: rest at 0, a and -a."""
    M = largest_invariant_set({"x": y, "y": x * (a - x) * (a + x) - y}, (y,), ("a",))
    assert sorted(str(branch) for branch in M) == ["x = -a, y = 0", "x = 0, y = 0", "x = a, y = 0"]


def test_branches_within_others_are_listed_once():
    M = largest_invariant_set({"x": -x, "y": constant(0)}, (x * y,), ())
    assert sorted(str(branch) for branch in M) == ["x = 0", "y = 0"]
