"""Named systems: what counts as the same entry, and settings from a file or from the command line."""

import numpy as np
import pytest
from design.systems import ball_system

from trimtab.core.errors import InputError
from trimtab.design.certificate import design_certificate
from trimtab.design.certified_system import (
    SMALL,
    LimitedNumber,
    compare_with_system,
    number_lines,
    system_settings,
)
from trimtab.design.proof import evaluate_lines


@pytest.fixture(scope="module")
def certificate():
    return design_certificate(ball_system())


def broken(lines):
    return {c.name: c for c in evaluate_lines(lines).conditions if not c.holds}


def test_estimated_state_matrix_is_a_block_of_the_plant():
    system = ball_system()
    assert np.array_equal(system.A_eta, [[0.0, 1.0], [0.0, 0.0]])
    assert np.array_equal(system._replace(estimated=("theta", "r'")).A_eta, [[0.0, 0.0], [system.A[1, 2], 0.0]])


@pytest.mark.parametrize("at", list(np.ndindex(4, 4)))
def test_comparison_detects_relative_change_of_each_entry(certificate, at):
    """A relative error of 1e-8 is detected in every entry, however small the entry is beside the others."""
    system = ball_system()
    A = np.where(system.A == 0, 1e-3, system.A)  # each row's largest is 1 or 7; all matter
    there = certificate._replace(A=A)
    assert not broken(compare_with_system(there, system._replace(A=A))).keys() - {"A_eta is that of ball and beam"}
    A = A.copy()
    A[at] *= 1 + 1e-8
    assert "A is that of ball and beam" in broken(compare_with_system(there, system._replace(A=A)))


def test_comparison_ignores_rounding_of_zero_entries(certificate):
    system = ball_system()
    for size, same in ((0.5e-9 * SMALL, True), (1e-7 * SMALL, False)):
        A = system.A.copy()
        A[0, 2] = size * system.A[0, 1] * system.scale[1] / system.scale[2]
        assert (
            "A is that of ball and beam" not in broken(compare_with_system(certificate._replace(A=A), system))
        ) == same
    A = system.A.copy()
    A[3, 0] = 1e-300  # its row is all zero: nothing there is small
    assert "A is that of ball and beam" in broken(compare_with_system(certificate._replace(A=A), system))


def test_comparison_scales_come_from_the_system(certificate):
    """A different plant whose difference the scale in the file would hide."""
    system, scale = ball_system(), certificate.scale.copy()
    scale[1] = 1e-20
    A = system.A.copy()
    A[1, 2] *= 0.7
    seen = broken(compare_with_system(certificate._replace(A=A, scale=scale), system))
    assert {"A is that of ball and beam", "scale is that of ball and beam"} == set(seen)
    assert seen["A is that of ball and beam"].why.startswith("at r', theta: ")


def test_comparison_fails_for_wrong_shape_and_nan(certificate):
    system = ball_system()
    fewer = certificate._replace(A=certificate.A[:3, :3])
    assert (
        broken(compare_with_system(fewer, system))["A is that of ball and beam"].why
        == "shape (3, 3), must be shape (4, 4)"
    )
    holes = certificate._replace(A=np.full((4, 4), np.nan))
    assert "A is that of ball and beam" in broken(compare_with_system(holes, system))
    narrow = certificate._replace(K=certificate.K[:, :2])
    assert "must have shape (1, 4), got (1, 2)" in broken(number_lines(narrow, system))["numbers of the system"].why


@pytest.mark.parametrize("value", [1.0, -1e-9, float("nan")])
def test_number_outside_its_limits_fails(certificate, value):
    number = LimitedNumber(value, 0.0, 1.0, "by hand", 1e-9)
    assert not number.is_inside
    system = ball_system()._replace(numbers=lambda K: {"kappa": number})
    assert {"kappa", "kappa, as recorded"} <= set(broken(number_lines(certificate, system)))


def a_system(*, kind: str = "short", length: float = 1.0):
    return ball_system()._replace(about={"kind": kind, "length": length})


def test_settings_are_read_from_the_function_signature():
    assert system_settings(a_system, {}, "x") == {"kind": "short", "length": 1.0}
    assert system_settings(a_system, {"length": "2.5", "kind": "long"}, "x") == {"kind": "long", "length": 2.5}
    assert system_settings(a_system, {"length": 3}, "x")["length"] == 3.0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"lenght": 1.0}, "unknown setting 'lenght'.*settings={.length"),
        ({"length": "long"}, "must be a finite number, got 'long'"),
        ({"length": "nan"}, "must be a finite number, got 'nan'"),
        ({"length": float("inf")}, "must be a finite number, got inf"),
        ({"length": True}, "must be a finite number, got True"),
        ({"length": 10**400}, "must be a finite number, got 1000"),
        ({"kind": 1.0}, "must be text, got 1.0"),
    ],
)
def test_rejects_invalid_settings(given, words):
    with pytest.raises(InputError, match=f"(?s){words}"):
        system_settings(a_system, given, "x")
