"""`trimtab plan`: output, written files, and invalid input with exit code 2."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from trimtab.cli import main

HALL = Path(__file__).parents[2] / "examples" / "hall.toml"


@pytest.mark.thorough
def test_writes_table_and_picture_and_prints_run_command(tmp_path):
    table, picture = tmp_path / "plan.csv", tmp_path / "plan.png"
    done = CliRunner().invoke(main, ["plan", str(HALL), "--out", str(table), "--plot", str(picture)])
    assert done.exit_code == 0, done.output
    assert f"trimtab run hovercraft/track --reference {table} --set law=horizon" in done.output
    assert table.read_text().splitlines()[0] == "time [s],north [m],east [m],heading [deg]"
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.thorough
def test_json_reports_clearance_duration_and_length(tmp_path):
    done = CliRunner().invoke(main, ["plan", str(HALL), "--speed", "0.4", "--json"])
    result = json.loads(done.output)
    assert done.exit_code == 0
    assert result["clearance_m"] >= 0.05
    assert 20 < result["duration_s"] < 120
    assert 9 < result["length_m"] < 18


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("radius = 0.35 ", "radius = 1.2 ", "is 0.80 m from the nearest obstacle"),
        ("north = -3\n", "north = -9\n", "lies in an obstacle or beyond the floor"),
        ("[craft]", "[ship]", "unknown section [ship]"),
    ],
)
def test_invalid_hall_is_rejected_with_reason_and_fix(old, new, says, tmp_path):
    file = tmp_path / "hall.toml"
    text = HALL.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    done = CliRunner().invoke(main, ["plan", str(file)])
    assert done.exit_code == 2
    assert says in done.output
    assert "Fix:" in done.output
