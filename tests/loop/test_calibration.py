"""The calibration file: round trip, hash, merging, comparison and invalid files."""

from pathlib import Path

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.loop.calibration import (
    Calibration,
    Covariance,
    Entry,
    compare_calibrations,
    format_calibration,
    joint_covariance,
    parse_calibration,
    read_calibration,
)

NUMBER = 'version = 1\n["A.b"]\nvalue = 1.0\nunit = "m"\nstandard_error = 1.0\n'
ONE = Calibration(
    {
        "Hovercraft.inertia": Entry(0.0961234567890123, "kg m^2", 0.001, 9, "trials.csv: 10 readings", "inertia"),
        "Thruster.reverse_ratio": Entry([1e-3, -0.03, 0.4, -1.1], "1", [1e-4, 1e-3, 0.01, 0.1], 35, "r.csv", "reverse"),
    },
    (
        Covariance(
            ("Thruster.reverse_ratio[0]", "Thruster.reverse_ratio[1]"), [[1e-8, -9e-8], [-9e-8, 1e-6]], "reverse"
        ),
    ),
)


def test_calibration_file_round_trips_bit_for_bit() -> None:
    again = parse_calibration("file", format_calibration(ONE))
    assert again == ONE
    assert again.content_hash() == ONE.content_hash()


def test_hash_depends_on_values_but_not_on_sources() -> None:
    entry = ONE.entries["Hovercraft.inertia"]
    other = Calibration({**ONE.entries, "Hovercraft.inertia": entry._replace(value=0.097)}, ONE.covariances)
    named = Calibration({**ONE.entries, "Hovercraft.inertia": entry._replace(source="again")}, ONE.covariances)
    assert other.content_hash() != ONE.content_hash() == named.content_hash()


def test_repeated_procedure_replaces_its_earlier_results() -> None:
    new = Calibration({"Thruster.reverse_ratio": Entry([0.0, 0.0, 0.0, 0.5], "1", procedure="reverse")})
    merged = ONE.merge(new)
    assert merged.entries["Thruster.reverse_ratio"].value == [0.0, 0.0, 0.0, 0.5]
    assert "Hovercraft.inertia" in merged.entries
    assert not merged.covariances


def test_joint_covariance_contains_recorded_cross_covariances() -> None:
    P = joint_covariance(ONE, ["Thruster.reverse_ratio[1]", "Hovercraft.inertia", "Thruster.reverse_ratio[0]"])
    np.testing.assert_allclose(P, [[1e-6, 0, -9e-8], [0, 1e-6, 0], [-9e-8, 0, 1e-8]])


def test_comparison_gives_the_difference_in_standard_errors() -> None:
    entry = ONE.entries["Hovercraft.inertia"]
    other = Calibration({"Hovercraft.inertia": entry._replace(value=entry.value + 0.003 * np.sqrt(2))})
    changes = compare_calibrations(ONE, other)
    apart = changes["Hovercraft.inertia"][2]
    assert apart is not None
    assert abs(apart - 3) < 1e-9
    assert changes["Thruster.reverse_ratio[2]"] == (0.4, None, None)


OTHER = '["A.c"]\nvalue = 2.0\nunit = "m"\n'
JOINT = '[[covariance]]\nof = ["A.b", "A.c"]\nmatrix = [[1.0, 0.5], [0.5, 1.0]]\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("value = ", "not valid TOML"),
        ("a = 1", "has version None"),
        ('version = 1\n["A.b"]\nvalue = 1.0', "no value or no unit"),
        ('version = 1\n["A.b"]\nvalue = "x"\nunit = "m"', "not numbers"),
        ('version = 1\n["A.b"]\nvalue = "0.1"\nunit = "m"', "not numbers"),
        ('version = 1\n["A.b"]\nvalue = true\nunit = "m"', "not numbers"),
        (f'version = 1\n["A.b"]\nvalue = 1{"0" * 400}\nunit = "m"', "not numbers"),
        ('version = 1\n["A.b"]\nvalue = []\nunit = "m"', "empty list"),
        ('version = 1\n["A.b"]\nvalue = 1.0\nunit = 5', "unit must be a text, got 5"),
        ('version = 1\n["A.b"]\nvalue = 1.0\nunit = "m"\nfreedom = 0', "freedom must be above 0, got 0"),
        ('version = 1\n["A.b"]\nvalue = 1.0\nunit = "m"\nfreedom = nan', "freedom must be above 0, got nan"),
        ("version = 1\ncovariance = 5", "lacks `of`"),
        ('version = 1\n["A.b"]\nvalue = inf\nunit = "m"', "not finite"),
        ('version = 1\n["A.b"]\nvalue = 1.0\nunit = "m"\nstandard_error = -1.0', "standard_error"),
        ('version = 1\n["A.b"]\nvalue = 1.0\nunit = "m"\nsigma = 1.0', "unknown key 'sigma'"),
        ('version = 1\n[[covariance]]\nof = ["A.b"]\nmatrix = [[1.0]]', "has no number"),
        (f'{NUMBER}[[covariance]]\nof = ["A.b[7]"]\nmatrix = [[1.0]]', "has no number of this name"),
        (f'{NUMBER}[[covariance]]\nof = ["A.b", "A.b"]\nmatrix = [[1, 1], [1, 1]]', "names 'A.b' twice"),
        (f"{NUMBER}[[covariance]]\nof = []\nmatrix = []", "lacks `of`"),
        (f'{NUMBER}{OTHER}[[covariance]]\nof = ["A.c"]\nmatrix = [[1.0]]', "names 'A.c', which has no standard_error"),
        (f"{NUMBER}{OTHER}standard_error = 1.0\n{JOINT}{JOINT}", "two [[covariance]] tables name A.b and A.c"),
        ('version = 1\n["A.c"]\nvalue = 1e200\nunit = "m"\n', "the value is not finite"),
        (f"{NUMBER}{OTHER}standard_error = 1e200\n", "standard_error must have the shape of value, with finite"),
        (f'{NUMBER}[[covariance]]\nof = ["A.b"]\nmatrix = [[4.0]]', "standard error of A.b is 1, but"),
    ],
)
def test_rejects_invalid_calibration_files(text: str, words: str) -> None:
    with pytest.raises(InputError) as refused:
        parse_calibration("calibration 'boat.toml'", text)
    assert words in str(refused.value)
    assert "Fix: " in str(refused.value)


def test_calibration_file_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    (tmp_path / "boat.toml").write_text(format_calibration(ONE), encoding="utf-8-sig")
    assert read_calibration(tmp_path / "boat.toml") == ONE


def test_comparison_rejects_different_units() -> None:
    other = Calibration({"Hovercraft.inertia": Entry(961.0, "kg cm^2")})
    with pytest.raises(InputError, match="'kg m\\^2' in the first calibration, and 'kg cm\\^2' in the second"):
        compare_calibrations(ONE, other)


def test_missing_file_error_names_the_calibrate_command(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="trimtab calibrate thrust"):
        read_calibration(tmp_path / "none.toml")
