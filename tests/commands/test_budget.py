"""`trimtab budget`: table, JSON output, and invalid options, which are rejected before simulation."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.commands.budget import _format_rms

NAME = "hovercraft/forward"
FEW = ("--only", "navigation-error", "--runs", "3", "--set", "duration=4 s")


def call(*arguments):
    return CliRunner().invoke(main, ["budget", *arguments])


@pytest.mark.thorough
def test_json_reports_costs_and_plot_is_written(tmp_path):
    picture = tmp_path / "made" / "budget.png"
    result = call(NAME, *FEW, "--plot", str(picture), "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["files"] == [str(picture)]
    assert picture.stat().st_size > 5000
    (cost,) = found["costs"]
    assert cost["imperfection"] == "navigation-error"
    for measure in ("surge_velocity", "sway_velocity", "yaw_rate"):
        whole, without = found["all"][measure]["rms"], cost["without"][measure]["rms"]
        assert cost["share"][measure] == pytest.approx(1 - without**2 / whole**2)
    assert found["units"]["yaw_rate"] == "rad/s"
    assert found["runs"] == 3


@pytest.mark.thorough
def test_table_names_imperfections_units_and_standard_error(wide_screen):
    result = call(NAME, *FEW)
    assert result.exit_code == 0, result.output
    for text in ("navigation-error alone", "yaw rate (rad/s)", "Reduction of the mean square error", "standard error"):
        assert text in result.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--only", "wind"), ("no imperfection 'wind'", "uplink-delay", "Fix")),
        (("--only", "wind"), ("--only: ", "Fix: --only navigation-error")),
        (("--navigation", "gps"), ("'gps' is not a choice", "ins-magnetometer", "Fix")),
        (("--plot", "budget.txt"), ("supported picture format", ".png", "Fix")),
        (("--set", "world.vehicle.mass=-1"), ("world.vehicle.mass", "Fix")),
    ],
)
def test_invalid_options_are_rejected_before_simulation(arguments, said):
    result = call(NAME, *arguments)
    assert result.exit_code == 2
    for text in said:
        assert text in result.stderr


def test_small_errors_are_printed_with_significant_digits():
    assert [_format_rms(*row) for row in ((7.314e-5, 1.2e-6), (0.0, 0.0), (0.25, 0.001), (np.inf, 0.0))] == [
        "7.31e-05 ± 1e-06",
        "0.0000 ± 0.0000",
        "0.2500 ± 0.0010",
        "inf ± 0.0000",
    ]
