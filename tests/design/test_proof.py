"""Conditions of a proof: each is evaluated and reports its number."""

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.design import exact
from trimtab.design.proof import ProofCondition, definite_condition, evaluate_lines, identity_condition

GOOD = ProofCondition("", True, 1.0, "value", "by hand")


def raise_error(error):
    raise error


@pytest.mark.parametrize(
    "error",
    [ZeroDivisionError("no inverse"), np.linalg.LinAlgError("no inverse"), InputError("x", "no inverse", fix="y")],
)
def test_condition_that_raises_fails_without_hiding_others(error):
    proof = evaluate_lines([("a", lambda: raise_error(error)), ("b", lambda: GOOD)])
    assert not proof.holds
    assert [(c.name, c.holds) for c in proof.conditions] == [("a", False), ("b", True)]
    assert proof.conditions[0].why == "no inverse"
    assert evaluate_lines([("b", lambda: GOOD)]).holds


def test_proved_margin_is_below_the_true_margin():
    rng = np.random.default_rng(0)
    M = rng.standard_normal((5, 5))
    M = M @ M.T
    M = (M + M.T) / 2
    for unit in (None, np.diag([1.0, 2.0, 3.0, 4.0, 5.0])):
        line = definite_condition(M, "abcde", None if unit is None else exact.as_fractions(unit))
        b = np.diag(np.diag(M)) if unit is None else unit
        true = np.linalg.eigvals(np.linalg.solve(b, M)).real.min()
        assert line.holds
        assert 0.95 * true < line.number < true


def test_margin_below_float_resolution_is_zero():
    M = exact.as_fractions(np.ones((2, 2)))
    M[1, 1] += exact.as_fractions([2.0**-80])[0]
    line = definite_condition(M, "ab")
    assert (line.holds, line.number) == (True, 0.0)
    M[1, 1] -= 2 * exact.as_fractions([2.0**-80])[0]
    line = definite_condition(M, "ab")
    assert not line.holds
    assert line.why == f"pivot at b is {-(2.0**-80):.6g}"


def test_asymmetric_entry_is_named():
    line = definite_condition(np.array([[2.0, 0.5], [0.25, 2.0]]), "ab")
    assert (line.holds, line.number) == (False, 0.25)
    assert line.why == "not symmetric: a, b is 0.5, b, a is 0.25"


def test_failed_identity_names_its_worst_entry():
    term = np.array([[1.0, 2.0], [3.0, 4.0]])
    assert identity_condition(1e-10 * term, term, ("ab", "cd")).holds
    line = identity_condition(np.array([[0.0, 0.0], [1e-6, 0.0]]), term, ("ab", "cd"))
    assert (line.holds, line.why) == (False, "largest deviation at b, c")
    assert line.number == pytest.approx(2.5e-7)
    assert not identity_condition(np.full((1, 1), np.nan), np.ones((1, 1)), ("a", "b")).holds
