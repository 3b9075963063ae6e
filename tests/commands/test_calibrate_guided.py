"""`trimtab calibrate measure`: each entry is checked, saved at once, and continued later."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from trimtab.cli import main


def walk(file: Path, procedure: str, *entries: str) -> str:
    typed = "".join(f"{entry}\n" for entry in entries)
    result = CliRunner().invoke(main, ["calibrate", "measure", procedure, str(file)], input=typed)
    assert result.exit_code == 0, result.output
    return result.output


def test_guided_entry_is_checked_saved_and_continued(tmp_path: Path) -> None:
    file = tmp_path / "reverse.csv"
    shown = walk(file, "reverse", "0,4", "0.4", "400", "0.1", "q")
    assert "'0,4' is not a number: write 0.4" in shown
    assert "400 N is outside 0 to 100 N" in shown
    assert "Rudder straight" in shown
    assert file.read_text().splitlines() == ["speed [rpm],forward [N],reverse [N],trial", "6000,0.4,0.1,1"]
    again = walk(file, "reverse", "0.55", "0.15", "u", "0.5", "0.16", "q")
    assert "1 of 14 measurements; continuing" in again
    assert file.read_text().splitlines()[1:] == ["6000,0.4,0.1,1", "7000,0.5,0.16,1"]


def test_implausible_entry_is_asked_again(tmp_path: Path) -> None:
    file = tmp_path / "reverse.csv"
    shown = walk(file, "reverse", "0.4", "0.30", "0.5", "0.05", "n", "0.5", "0.35", "q")
    assert "far from the readings at neighbouring settings" in shown
    assert file.read_text().splitlines()[-1] == "7000,0.5,0.35,1"


def test_guided_measurements_can_be_calibrated(tmp_path: Path) -> None:
    file = tmp_path / "trials.csv"
    entries = [e for k in range(6) for e in ("1.1", f"{(0.94 + 0.003 * k) * (1 if k % 2 == 0 else -1.2):.4f}")]
    shown = walk(file, "inertia", *entries)
    assert f"now: trimtab calibrate inertia {file} --out boat.toml" in shown
    found = CliRunner().invoke(main, ["calibrate", "inertia", str(file), "--json"])
    assert found.exit_code == 0, found.output


def test_file_of_another_format_is_not_overwritten(tmp_path: Path) -> None:
    file = tmp_path / "other.csv"
    file.write_text("a,b\n1,2\n")
    result = CliRunner().invoke(main, ["calibrate", "measure", "thrust", str(file)])
    assert result.exit_code == 2
    assert file.read_text() == "a,b\n1,2\n"


HEADING = "speed [rpm],forward [N],reverse [N],trial"
WHOLE = [f"{n},{n / 1e4},{n / 4e4},{trial}" for trial in (1, 2) for n in range(6000, 12001, 1000)]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\xf6\n", "cannot be read as text"),
        (HEADING.encode("utf-16"), "cannot be read as text"),
        (f"{HEADING}\n# windy\n6000,0.4,0.1,1\n".encode(), "the comment '# windy', which would be lost"),
        (f"{HEADING}\n6000,0.4,0.1,1\n9000,0.9,0.2,1\n".encode(), "must have speed 7000, as planned, got 9000"),
        (f"{HEADING}\n6000,0.4,0.1,2\n".encode(), "measurement 1 (6000,0.4,0.1,2)"),
        ("\n".join([HEADING, *WHOLE, "13000,1.4,0.5,3"]).encode(), "must have at most 14 measurements, got 15"),
    ],
)
def test_refuses_to_continue_a_file_it_cannot_rewrite(content: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "reverse.csv").write_bytes(content)
    result = CliRunner().invoke(main, ["calibrate", "measure", "reverse", str(tmp_path / "reverse.csv")])
    assert result.exit_code == 2, result.output
    assert said in " ".join(result.output.split())


def test_continues_a_file_with_a_byte_order_mark(tmp_path: Path) -> None:
    (tmp_path / "reverse.csv").write_text(f"{HEADING}\n6000,0.4,0.1,1\n", encoding="utf-8-sig")
    assert "1 of 14 measurements; continuing" in walk(tmp_path / "reverse.csv", "reverse", "q")


def test_continues_a_file_that_a_spreadsheet_has_saved(tmp_path: Path) -> None:
    (tmp_path / "reverse.csv").write_text(f"{HEADING}\n6000.00,0.4,0.1,1.0\n7e3,0.5,0.1,1\n")
    assert "2 of 14 measurements; continuing" in walk(tmp_path / "reverse.csv", "reverse", "q")
