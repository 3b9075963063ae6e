"""Regions of attraction: proved, inside the true one, and not much smaller."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from trimtab.core.errors import InputError
from trimtab.design.attraction import find_region
from trimtab.design.polynomial import constant, symbol
from trimtab.design.squares import Region
from trimtab.design.theorem import LawTheorem, prove_theorem
from trimtab.design.theorem_file import design_theorem

pytest.importorskip("clarabel")
x, y = symbol("x"), symbol("y")


def theorem(field, **rest):
    at = {n: constant(rest.get(n, 0)) for n in field}
    return LawTheorem("test", {}, "it rests", Region(tuple(field), (), at), field)


def prove(t, region):
    return prove_theorem(design_theorem(t, region.lyapunov, region.level, **region.proofs), t)


def broken(proof):
    return {c.name: c.why for c in proof.conditions if not c.holds and c.name != "points of rest"}


def numbers(p, **at):
    return sum(float(c) * np.prod([at[n] ** q for n, q in m] or [1.0], axis=0) for m, c in p.terms.items())


def test_scalar_region_matches_known_interval():
    """x' = -x + x^3 rests from |x| < 1, and from nowhere else: the level reaches 1, to the margins."""
    t = theorem({"x": -x + x**3})
    region = find_region(t, tries=10)
    assert broken(prove(t, region)) == {}
    assert 0.98 < region.extents["x"] < 1


@pytest.mark.thorough
def test_reversed_van_der_pol_region_lies_inside_limit_cycle():
    """The limit cycle bounds the true region; Khalil, example 8.9, has a smaller one by hand (V <= 2.25)."""
    t = theorem({"x": -y, "y": x - y + x**2 * y})
    region = find_region(t, tries=60)
    assert broken(prove(t, region)) == {}
    V, level = region.lyapunov, float(region.level)
    cycle = solve_ivp(
        lambda t, z: [z[1], -z[0] + z[1] * (1 - z[0] ** 2)], (0, 60), [2, 0], rtol=1e-9, dense_output=True
    )
    edge = cycle.sol(np.linspace(50, 60, 2000))
    assert numbers(V, x=edge[0], y=edge[1]).min() > level
    at = {
        n: float(V.derivative(a).derivative(b).terms.get((), 0)) / 2
        for n, a, b in (("xx", "x", "x"), ("yy", "y", "y"), ("xy", "x", "y"))
    }
    area = np.pi * level / np.sqrt(at["xx"] * at["yy"] - at["xy"] ** 2)
    true = 0.5 * abs(
        np.sum(edge[0, :1333] * np.roll(edge[1, :1333], -1) - edge[1, :1333] * np.roll(edge[0, :1333], -1))
    )
    assert 0.45 < area / true < 1.0


def test_region_about_a_nonzero_equilibrium():
    e = x - 3
    t = theorem({"x": -e + e**2}, x=3)
    region = find_region(t, tries=10)
    assert broken(prove(t, region)) == {}
    assert 0.98 < region.extents["x"] < 1


def test_too_large_region_is_not_proved():
    t = theorem({"x": -x + x**3})
    region = find_region(t, tries=10)
    assert not prove(t, region._replace(level=region.level * 2)).holds


@pytest.mark.parametrize(
    ("field", "why"),
    [({"x": x}, "not stable"), ({"x": -symbol("k") * x}, "parameters have no value: k"), ({"x": -x + x**5}, "powers")],
)
def test_rejects_system_without_region_of_attraction(field, why):
    with pytest.raises(InputError, match=why):
        find_region(theorem(field))
